// SPDX-License-Identifier: GPL-3.0-or-later
// A 3D Delaunay triangulation, flattened to arrays that threads can walk without CGAL's handles.
#pragma once

#include <array>
#include <memory>
#include <vector>

#include "types.h"

namespace mesher {

// Vertices are positively oriented, neighbors[i] shares the facet opposite vertices[i]. A cell with
// the vertex kInfinite lies outside the convex hull.
struct Cell {
  std::array<Index, 4> vertices;
  std::array<Index, 4> neighbors;

  bool IsInfinite() const {
    return vertices[0] < 0 || vertices[1] < 0 || vertices[2] < 0 || vertices[3] < 0;
  }
  // Which of the four vertices this one of them is.
  int SlotOf(Index vertex) const {
    return vertices[0] == vertex ? 0 : vertices[1] == vertex ? 1 : vertices[2] == vertex ? 2 : 3;
  }
};

// Facet i of a cell, ordered such that (vertex i, facet) is positively oriented: seen from vertex i
// the three turn clockwise, seen from outside the cell counter-clockwise.
constexpr int kFacet[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

// Position of a value that is one of four, without branches, which would be unpredictable.
inline int PositionIn(const std::array<Index, 4>& values, Index value) {
  const int is_last = values[3] == value;
  return ((values[1] == value) | is_last) | ((values[2] == value) | is_last) << 1;
}

struct Triangulation {
  std::vector<Vec3> points;
  std::vector<Cell> cells;
  Rows stars;  // vertex -> incident cells, infinite ones too

  Index num_vertices() const { return static_cast<Index>(points.size()); }
  Index num_cells() const { return static_cast<Index>(cells.size()); }

  // Position of `cell` among the neighbors of `neighbor`.
  int MirrorIndex(Index cell, Index neighbor) const {
    return PositionIn(cells[neighbor].neighbors, cell);
  }
};

// A background ray from a vertex at a camera's centre to a target outside the convex hull.
struct BackgroundRay {
  Index vertex;
  Vec3 target;
};

// Builds a triangulation incrementally and flattens it. Points must be distinct and finite.
class DelaunayBuilder {
 public:
  // `points` are inserted in an order that depends only on the points.
  explicit DelaunayBuilder(const std::vector<Vec3>& points);
  ~DelaunayBuilder();

  int dimension() const;
  Index num_vertices() const;
  const std::vector<Vec3>& points() const { return points_; }
  bool IsEdge(Index a, Index b) const;

  // The neighbors of vertex `v` along edges, without the vertex at infinity.
  std::vector<Index> Neighbors(Index v) const;

  // The vertex nearest to `point`, starting the search at vertex `near`.
  Index Nearest(const Vec3& point, Index near) const;

  // Inserts `point`, starting the search at vertex `near`; returns its index, or that of the vertex
  // that exists already.
  Index Insert(const Vec3& point, Index near);

  Triangulation Flatten() const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
  std::vector<Vec3> points_;
};

// Order of the distinct points along a space-filling curve, the same for any order of the input:
// returns for each place the indices of the (coinciding) input points.
Rows SortDistinctPoints(const std::vector<Vec3>& points);

}  // namespace mesher
