// SPDX-License-Identifier: GPL-3.0-or-later
// Merges nearly coinciding points of polylines. Otherwise many copies of one curve would have
// needle-shaped cells between them, and every ray would cross all of these.
#pragma once

#include <vector>

#include "types.h"

namespace mesher {

// Radius of each vertex below which another one is the same: `factor` of the typical segment of
// `polylines`, as long as the nearest camera that sees the vertex would see it; 0 for vertices on
// no polyline or without cameras. Row v of `rays` holds the cameras that see vertex v.
std::vector<double> MergeRadii(const std::vector<Vec3>& points, const Rows& rays,
                               const std::vector<Vec3>& cameras, const Rows& polylines,
                               double factor);

// Points lie in the unit cube, or near it. For each point the first one in order that stands for
// it: itself, or one that stands for itself and is no farther away than both radii, of which none
// is more than twice the other.
std::vector<Index> Representatives(const std::vector<Vec3>& points,
                                   const std::vector<double>& radii);

}  // namespace mesher
