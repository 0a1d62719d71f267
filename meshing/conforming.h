// SPDX-License-Identifier: GPL-3.0-or-later
// Makes the triangulation follow polylines: adds points until their segments are edges.
#pragma once

#include <vector>

#include "triangulation.h"

namespace mesher {

struct ConformingStats {
  Index segments = 0;
  Index segments_missing = 0;  // pieces that are not edges and too short to be split
  Index points_added = 0;
};

// Splits segments of `polylines` (rows of vertices) that are not edges of the triangulation at
// their middle, and again, until all pieces are edges or shorter than `min_length`. A new point is
// appended to `rays` with the cameras that see both ends of the piece it splits. Where a vertex of
// a polyline is nearer to the middle than the radii of both ends, it takes the middle's place.
ConformingStats Conform(const Rows& polylines, double min_length, std::vector<double> radii,
                        DelaunayBuilder& builder, Rows& rays);

// Median length of the segments of `polylines`; 0 without any.
double TypicalSegmentLength(const Rows& polylines, const std::vector<Vec3>& points);

}  // namespace mesher
