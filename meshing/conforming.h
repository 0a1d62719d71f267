// SPDX-License-Identifier: GPL-3.0-or-later
// Makes polylines edges of the triangulation by adding points.
#pragma once

#include <vector>

#include "triangulation.h"

namespace mesher {

// A piece of a polyline between two vertices.
struct Piece {
  Index a, b;  // a < b
  Index row;   // the first polyline that it belongs to
};

struct Conforming {
  std::vector<Piece> pieces;   // all pieces of all polylines, each once
  Index segments = 0;          // pieces of the given polylines
  Index segments_missing = 0;  // pieces that are not edges and too short to be split
  Index points_added = 0;
};

// Recursively splits segments of `polylines` (rows of vertices) that are not edges of the
// triangulation at their midpoints, until all pieces are edges or shorter than `min_length`. A new
// point is appended to `rays` with the cameras that see both ends of its piece. If a vertex of a
// polyline is nearer to the midpoint than the radii of both ends, it is used instead.
Conforming Conform(const Rows& polylines, double min_length, std::vector<double> radii,
                   DelaunayBuilder& builder, Rows& rays);

// The distinct pieces of `polylines`, unsplit.
std::vector<Piece> PiecesOf(const Rows& polylines);

// Median length of the segments of `polylines`; 0 without segments.
double TypicalSegmentLength(const Rows& polylines, const std::vector<Vec3>& points);

}  // namespace mesher
