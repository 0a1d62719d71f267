// SPDX-License-Identifier: GPL-3.0-or-later
#include "triangulation.h"

#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Spatial_sort_traits_adapter_3.h>
#include <CGAL/Triangulation_cell_base_with_info_3.h>
#include <CGAL/Triangulation_vertex_base_with_info_3.h>
#include <CGAL/hilbert_sort.h>
#include <CGAL/property_map.h>

#include <algorithm>
#include <boost/iterator/zip_iterator.hpp>
#include <numeric>
#include <stdexcept>

namespace mesher {
namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using VertexBase = CGAL::Triangulation_vertex_base_with_info_3<Index, Kernel>;
using CellBase =
    CGAL::Triangulation_cell_base_with_info_3<Index, Kernel,
                                              CGAL::Delaunay_triangulation_cell_base_3<Kernel>>;
using Delaunay =
    CGAL::Delaunay_triangulation_3<Kernel,
                                   CGAL::Triangulation_data_structure_3<VertexBase, CellBase>>;

Kernel::Point_3 ToPoint(const Vec3& p) { return {p.x, p.y, p.z}; }

}  // namespace

struct DelaunayBuilder::Impl {
  Delaunay delaunay;
  std::vector<Delaunay::Vertex_handle> handles;
};

DelaunayBuilder::DelaunayBuilder(const std::vector<Vec3>& points)
    : impl_(std::make_unique<Impl>()), points_(points) {
  std::vector<Kernel::Point_3> positions(points.size());
  std::transform(points.begin(), points.end(), positions.begin(), ToPoint);
  std::vector<Index> indices(points.size());
  std::iota(indices.begin(), indices.end(), 0);
  auto& delaunay = impl_->delaunay;
  delaunay.insert(boost::make_zip_iterator(boost::make_tuple(positions.begin(), indices.begin())),
                  boost::make_zip_iterator(boost::make_tuple(positions.end(), indices.end())));
  if (delaunay.number_of_vertices() != points.size())
    throw std::invalid_argument("points of a triangulation must be distinct");
  impl_->handles.resize(points.size());
  for (auto vertex : delaunay.finite_vertex_handles()) impl_->handles[vertex->info()] = vertex;
}

DelaunayBuilder::~DelaunayBuilder() = default;

int DelaunayBuilder::dimension() const { return impl_->delaunay.dimension(); }

Index DelaunayBuilder::num_vertices() const { return static_cast<Index>(points_.size()); }

bool DelaunayBuilder::IsEdge(Index a, Index b) const {
  Delaunay::Cell_handle cell;
  int i, j;
  return impl_->delaunay.is_edge(impl_->handles[a], impl_->handles[b], cell, i, j);
}

std::vector<Index> DelaunayBuilder::Neighbors(Index v) const {
  std::vector<Delaunay::Vertex_handle> around;
  impl_->delaunay.finite_adjacent_vertices(impl_->handles[v], std::back_inserter(around));
  std::vector<Index> neighbors;
  for (const auto vertex : around) neighbors.push_back(vertex->info());
  return neighbors;
}

Index DelaunayBuilder::Nearest(const Vec3& point, Index near) const {
  return impl_->delaunay.nearest_vertex(ToPoint(point), impl_->handles[near]->cell())->info();
}

Index DelaunayBuilder::Insert(const Vec3& point, Index near) {
  const std::size_t before = impl_->delaunay.number_of_vertices();
  auto vertex = impl_->delaunay.insert(ToPoint(point), impl_->handles[near]);
  if (impl_->delaunay.number_of_vertices() == before) return vertex->info();
  vertex->info() = num_vertices();
  points_.push_back(point);
  impl_->handles.push_back(vertex);
  return vertex->info();
}

// Cells are numbered by their lowest vertex, so that neighbors in space are neighbors in memory.
Triangulation DelaunayBuilder::Flatten() const {
  const auto& delaunay = impl_->delaunay;
  if (delaunay.dimension() != 3) throw std::invalid_argument("points span no volume");
  const auto infinite = delaunay.infinite_vertex();
  auto index_of = [&](Delaunay::Vertex_handle v) { return v == infinite ? kInfinite : v->info(); };
  auto lowest = [&](Delaunay::Cell_handle cell) {
    Index low = num_vertices();
    for (int i = 0; i < 4; ++i)
      if (cell->vertex(i) != infinite) low = std::min(low, cell->vertex(i)->info());
    return low;
  };

  std::vector<Index> next(points_.size() + 1, 0);
  for (auto cell : delaunay.all_cell_handles()) ++next[lowest(cell) + 1];
  std::partial_sum(next.begin(), next.end(), next.begin());
  const Index num_cells = next.back();
  for (auto cell : delaunay.all_cell_handles()) cell->info() = next[lowest(cell)]++;

  Triangulation result;
  result.points = points_;
  result.cells.resize(num_cells);
  for (auto handle : delaunay.all_cell_handles()) {
    Cell& cell = result.cells[handle->info()];
    for (int i = 0; i < 4; ++i) {
      cell.vertices[i] = index_of(handle->vertex(i));
      cell.neighbors[i] = handle->neighbor(i)->info();
    }
  }

  Rows& stars = result.stars;
  stars.offsets.assign(points_.size() + 1, 0);
  for (const Cell& cell : result.cells)
    for (Index v : cell.vertices)
      if (v != kInfinite) ++stars.offsets[v + 1];
  std::partial_sum(stars.offsets.begin(), stars.offsets.end(), stars.offsets.begin());
  stars.values.resize(stars.offsets.back());
  std::vector<std::int64_t> free(stars.offsets.begin(), stars.offsets.end() - 1);
  for (Index c = 0; c < num_cells; ++c)
    for (Index v : result.cells[c].vertices)
      if (v != kInfinite) stars.values[free[v]++] = c;
  return result;
}

Rows SortDistinctPoints(const std::vector<Vec3>& points) {
  std::vector<Index> order(points.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](Index a, Index b) {
    return points[a] == points[b] ? a < b : points[a] < points[b];
  });

  // Runs of coinciding points, represented by their first, in lexicographic order.
  std::vector<Kernel::Point_3> positions;
  std::vector<std::size_t> run_begins;
  for (std::size_t i = 0; i < order.size(); ++i) {
    if (i > 0 && points[order[i]] == points[order[i - 1]]) continue;
    run_begins.push_back(i);
    positions.push_back(ToPoint(points[order[i]]));
  }
  run_begins.push_back(order.size());

  if (positions.empty()) return {};
  std::vector<std::size_t> places(positions.size());
  std::iota(places.begin(), places.end(), 0);
  auto map = CGAL::make_property_map(positions);
  CGAL::hilbert_sort(places.begin(), places.end(),
                     CGAL::Spatial_sort_traits_adapter_3<Kernel, decltype(map)>(map),
                     CGAL::Hilbert_sort_middle_policy());
  Rows result;
  for (std::size_t place : places) {
    for (std::size_t i = run_begins[place]; i < run_begins[place + 1]; ++i)
      result.values.push_back(order[i]);
    result.offsets.push_back(static_cast<std::int64_t>(result.values.size()));
  }
  return result;
}

}  // namespace mesher
