// SPDX-License-Identifier: GPL-3.0-or-later
// Merges nearly coinciding points of polylines. Otherwise, between duplicates of a curve there
// would be needle-shaped cells, which every ray would cross.
#pragma once

#include <vector>

#include "types.h"

namespace mesher {

// Merging radius of each vertex: `factor` times the typical segment of `polylines`, at
// the distance of the nearest camera that sees the vertex; 0 for vertices on no polyline or without
// cameras. Row v of `rays` holds the cameras that see vertex v.
std::vector<double> MergeRadii(const std::vector<Vec3>& points, const Rows& rays,
                               const std::vector<Vec3>& cameras, const Rows& polylines,
                               double factor);

// Points lie in the unit cube, or near it. Returns the representative of each point: the first
// representative that is within both radii, which differ by at most a factor of two, or itself.
std::vector<Index> Representatives(const std::vector<Vec3>& points,
                                   const std::vector<double>& radii);

}  // namespace mesher
