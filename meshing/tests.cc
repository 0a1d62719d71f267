// SPDX-License-Identifier: GPL-3.0-or-later
// Tests of the mesher's parts against those of CGAL and Boost; exits with 1 at the first failure.
#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_segment_traverser_3.h>

#include <algorithm>
#include <array>
#include <boost/graph/adjacency_list.hpp>
#include <boost/graph/boykov_kolmogorov_max_flow.hpp>
#include <cstdio>
#include <cstdlib>
#include <random>
#include <set>

#include "free_space.h"
#include "manifold_sweep.h"
#include "merging.h"
#include "mesher.h"
#include "min_cut.h"
#include "ray_walker.h"
#include "surface.h"
#include "triangulation.h"

namespace mesher {
namespace {

void Check(bool condition, const char* what, int round) {
  if (condition) return;
  std::fprintf(stderr, "FAILED in round %d: %s\n", round, what);
  std::exit(1);
}

using Random = std::mt19937;
using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Delaunay = CGAL::Delaunay_triangulation_3<Kernel>;
using Quad = std::array<Vec3, 4>;

std::vector<Vec3> RandomPoints(int count, Random& random) {
  std::normal_distribution<double> normal;
  std::vector<Vec3> points(count);
  for (Vec3& p : points) p = {normal(random), normal(random), normal(random)};
  return points;
}

std::vector<Vec3> GridPoints(int side) {
  std::vector<Vec3> points;
  for (int i = 0; i < side * side * side; ++i)
    points.push_back({double(i % side), double(i / side % side), double(i / side / side)});
  return points;
}

std::vector<Vec3> Sorted(const std::vector<Vec3>& points) {
  const Rows places = SortDistinctPoints(points);
  std::vector<Vec3> sorted;
  for (std::int64_t i = 0; i < places.size(); ++i) sorted.push_back(points[*places.begin(i)]);
  return sorted;
}

Quad Corners(const Triangulation& triangulation, const Cell& cell) {
  Quad corners;
  for (int i = 0; i < 4; ++i) corners[i] = triangulation.points[cell.vertices[i]];
  std::sort(corners.begin(), corners.end());
  return corners;
}

std::set<Quad> FiniteCellsOfWalk(const Triangulation& triangulation, Index vertex,
                                 const Vec3& target) {
  std::set<Quad> cells;
  const RayWalker walker(triangulation, vertex, target);
  if (walker.front() == kNone) return cells;
  const Index last = walker.Walk(0, [&](const Crossing& crossing) {
    cells.insert(Corners(triangulation, triangulation.cells[crossing.cell]));
    return true;
  });
  if (!triangulation.cells[last].IsInfinite())
    cells.insert(Corners(triangulation, triangulation.cells[last]));
  return cells;
}

Kernel::Point_3 ToPoint(const Vec3& p) { return {p.x, p.y, p.z}; }

// Whether a ray that starts at a corner of a cell enters it: it is then on the inner side of the
// three facets that meet there.
bool IsEntered(const Quad& cell, const Vec3& from, const Vec3& to) {
  for (int i = 0; i < 4; ++i) {
    if (cell[i] == from) continue;  // the facet across
    const Vec3 &a = cell[(i + 1) % 4], &b = cell[(i + 2) % 4], &c = cell[(i + 3) % 4];
    if (Orientation(a, b, c, to) != Orientation(a, b, c, cell[i])) return false;
  }
  return true;
}

// If a ray leaves the hull at its vertex, the traverser still starts in a cell there.
std::set<Quad> FiniteCellsOfTraverser(const Delaunay& delaunay, const Vec3& from, const Vec3& to) {
  std::set<Quad> cells;
  auto it = delaunay.segment_traverser_cells_begin(ToPoint(from), ToPoint(to));
  for (; it != delaunay.segment_traverser_cells_end(); ++it) {
    Delaunay::Cell_handle handle = it;
    if (delaunay.is_infinite(handle)) continue;
    Quad corners;
    for (int i = 0; i < 4; ++i) {
      const auto& p = handle->vertex(i)->point();
      corners[i] = {p.x(), p.y(), p.z()};
    }
    std::sort(corners.begin(), corners.end());
    const bool starts_here = std::find(corners.begin(), corners.end(), from) != corners.end();
    if (!starts_here || IsEntered(corners, from, to)) cells.insert(corners);
  }
  return cells;
}

Delaunay MakeDelaunay(const std::vector<Vec3>& points) {
  std::vector<Kernel::Point_3> positions;
  for (const Vec3& p : points) positions.push_back(ToPoint(p));
  return Delaunay(positions.begin(), positions.end());
}

// In general position both cross the same cells.
void TestWalkerOnRandomPoints() {
  for (int round = 0; round < 20; ++round) {
    Random random(round);
    const auto points = Sorted(RandomPoints(200, random));
    const Triangulation triangulation = DelaunayBuilder(points).Flatten();
    const Delaunay delaunay = MakeDelaunay(points);
    for (const Vec3& direction : RandomPoints(50, random)) {
      const Index vertex = random() % points.size();
      const Vec3 target = (random() % 2 ? 1.0 : 4.0) * direction;
      Check(FiniteCellsOfWalk(triangulation, vertex, target) ==
                FiniteCellsOfTraverser(delaunay, points[vertex], target),
            "walker crosses other cells than CGAL's traverser", round);
    }
  }
}

bool Touches(const Quad& cell, const Vec3& from, const Vec3& to) {
  // Separating planes: a segment misses a tetrahedron if it lies wholly beyond one of its sides.
  for (int i = 0; i < 4; ++i) {
    const Vec3 &a = cell[(i + 1) % 4], &b = cell[(i + 2) % 4], &c = cell[(i + 3) % 4];
    const int inside = Orientation(a, b, c, cell[i]);
    if (Orientation(a, b, c, from) * inside < 0 && Orientation(a, b, c, to) * inside < 0)
      return false;
  }
  return true;
}

// On a grid, rays run along edges and through vertices. The walk must end, be connected, contain
// only cells that the ray touches, and equal CGAL's for a target displaced slightly in the
// direction of the walker's infinitesimal.
void TestWalkerOnGrids() {
  const auto points = Sorted(GridPoints(5));
  const Triangulation triangulation = DelaunayBuilder(points).Flatten();
  const Delaunay delaunay = MakeDelaunay(points);
  for (int round = 0; round < 3000; ++round) {
    Random random(round);
    const Index vertex = random() % points.size();
    const Vec3 target{random() % 17 / 2.0 - 2, random() % 17 / 2.0 - 2, random() % 17 / 2.0 - 2};
    if (target == points[vertex]) continue;
    const auto cells = FiniteCellsOfWalk(triangulation, vertex, target);
    for (const Quad& cell : cells)
      Check(Touches(cell, points[vertex], target), "walker crosses a cell off the ray", round);
    const double e = 1e-3;
    const Vec3 moved = target + Vec3{e, e * e, e * e * e};
    const auto expected = FiniteCellsOfTraverser(delaunay, points[vertex], moved);
    // The last cell may differ: the target itself may lie on its boundary.
    for (const Quad& cell : cells)
      Check(expected.count(cell) || Touches(cell, target, target),
            "walker leaves the perturbed ray", round);
    for (const Quad& cell : expected)
      Check(cells.count(cell) || Touches(cell, target, target),
            "walker misses a cell of the perturbed ray", round);
  }
}

// Every ray is represented exactly once: by itself, or by the first one of an edge point in its
// cube.
void TestFarWeights() {
  for (int round = 0; round < 20; ++round) {
    Random random(round);
    const auto points = Sorted(RandomPoints(200, random));
    Rows rays;
    for (std::size_t v = 0; v < points.size(); ++v) {
      for (Index camera = 0; camera < 5; ++camera)
        if (random() % 2) rays.values.push_back(camera);
      rays.offsets.push_back(static_cast<std::int64_t>(rays.values.size()));
    }
    const double side = round == 0 ? 0 : 0.5;
    std::vector<std::uint8_t> is_edge(points.size());
    for (auto& flag : is_edge) flag = random() % 4 > 0;
    const auto are_near = [&](Index v, Index w) {
      if (!is_edge[v] || !is_edge[w] || side == 0) return false;
      for (int axis = 0; axis < 3; ++axis)
        if (std::floor(points[v][axis] / side) != std::floor(points[w][axis] / side)) return false;
      return true;
    };
    const auto weights = FarWeights(points, is_edge, rays, 5, side);
    for (Index v = 0; v < rays.size(); ++v)
      for (auto ray = rays.offsets[v]; ray < rays.offsets[v + 1]; ++ray) {
        Index expected = 0;
        for (Index w = 0; w < rays.size(); ++w) {
          if (w != v && !are_near(v, w)) continue;
          if (std::count(rays.begin(w), rays.end(w), rays.values[ray]) == 0) continue;
          if (w < v) expected = -1;  // an earlier point represents it
          expected += expected >= 0;
        }
        Check(weights[ray] == std::max(expected, Index(0)), "a ray represents others", round);
      }
  }
}

// The search for the cells of a ray around its vertex does not depend on its start.
void TestWalkerStartsAnywhere() {
  for (int round = 0; round < 10; ++round) {
    Random random(round);
    const auto points = Sorted(round % 2 ? GridPoints(4) : RandomPoints(100, random));
    const Triangulation triangulation = DelaunayBuilder(points).Flatten();
    for (const Vec3& direction : RandomPoints(20, random)) {
      const Index vertex = random() % points.size();
      const Vec3 target = points[vertex] + (round % 4 == 1 ? Vec3{1, 0, 0} : direction);
      const RayWalker walker(triangulation, vertex, target);
      const auto& stars = triangulation.stars;
      for (const Index* c = stars.begin(vertex); c != stars.end(vertex); ++c) {
        if (triangulation.cells[*c].IsInfinite()) continue;
        const RayWalker other(triangulation, vertex, target, {*c, *c});
        Check(other.front() == walker.front() && other.behind() == walker.behind(),
              "another start finds another cell", round);
      }
    }
  }
}

CutProblem RandomProblem(const Triangulation& triangulation, Random& random) {
  CutProblem problem(triangulation.cells.size());
  for (auto& capacity : problem.source) capacity = random() % 4 ? 0 : random() % 100;
  for (auto& capacity : problem.sink) capacity = random() % 4 ? 0 : random() % 100;
  for (auto& capacity : problem.arcs) capacity = random() % 3 ? random() % 60 : 0;
  return problem;
}

std::int64_t BoostFlow(const Triangulation& triangulation, const CutProblem& problem) {
  using Traits = boost::adjacency_list_traits<boost::vecS, boost::vecS, boost::directedS>;
  using Vertex = boost::property<
      boost::vertex_index_t, long,
      boost::property<
          boost::vertex_color_t, boost::default_color_type,
          boost::property<boost::vertex_distance_t, long,
                          boost::property<boost::vertex_predecessor_t, Traits::edge_descriptor>>>>;
  using Edge = boost::property<
      boost::edge_capacity_t, std::int64_t,
      boost::property<boost::edge_residual_capacity_t, std::int64_t,
                      boost::property<boost::edge_reverse_t, Traits::edge_descriptor>>>;
  using Graph = boost::adjacency_list<boost::vecS, boost::vecS, boost::directedS, Vertex, Edge>;
  const Index count = triangulation.num_cells();
  Graph graph(count + 2);
  auto add = [&](Index from, Index to, std::int64_t there, std::int64_t back) {
    const auto forward = boost::add_edge(from, to, graph).first;
    const auto reverse = boost::add_edge(to, from, graph).first;
    boost::put(boost::edge_capacity, graph, forward, there);
    boost::put(boost::edge_capacity, graph, reverse, back);
    boost::put(boost::edge_reverse, graph, forward, reverse);
    boost::put(boost::edge_reverse, graph, reverse, forward);
  };
  for (Index c = 0; c < count; ++c) {
    add(count, c, problem.source[c], 0);
    add(c, count + 1, problem.sink[c], 0);
    for (int i = 0; i < 4; ++i) {
      const Index other = triangulation.cells[c].neighbors[i];
      if (other < c) continue;
      add(c, other, problem.arcs[4 * c + i],
          problem.arcs[4 * other + triangulation.MirrorIndex(c, other)]);
    }
  }
  return boost::boykov_kolmogorov_max_flow(graph, count, count + 1);
}

std::int64_t CutValue(const Triangulation& triangulation, const CutProblem& problem,
                      const std::vector<std::uint8_t>& is_source) {
  std::int64_t value = 0;
  for (Index c = 0; c < triangulation.num_cells(); ++c) {
    value += is_source[c] ? problem.sink[c] : problem.source[c];
    for (int i = 0; i < 4; ++i)
      if (is_source[c] && !is_source[triangulation.cells[c].neighbors[i]])
        value += problem.arcs[4 * c + i];
  }
  return value;
}

// The problem with flow pushed through all facets, whether or not as much comes from the source.
CutProblem Pushed(const Triangulation& triangulation, CutProblem problem, Random& random) {
  for (Index c = 0; c < triangulation.num_cells(); ++c)
    for (int i = 0; i < 4; ++i) {
      const Index next = triangulation.cells[c].neighbors[i];
      const std::int64_t amount = random() % (problem.arcs[4 * c + i] + 1);
      problem.arcs[4 * c + i] -= amount;
      problem.arcs[4 * next + triangulation.MirrorIndex(c, next)] += amount;
      problem.source[c] -= amount;
      problem.source[next] += amount;
    }
  return problem;
}

void TestCutEqualsBoost() {
  for (int round = 0; round < 60; ++round) {
    Random random(round);
    const auto points = Sorted(RandomPoints(4 + random() % 150, random));
    const Triangulation triangulation = DelaunayBuilder(points).Flatten();
    const CutProblem problem = RandomProblem(triangulation, random);
    const Cut cut = MinimumCut(triangulation.cells, problem);
    Check(cut.flow == BoostFlow(triangulation, problem), "flow differs from Boost's", round);
    Check(cut.flow == CutValue(triangulation, problem, cut.is_source),
          "the cut does not cost what flows", round);
    const Cut same = MinimumCut(triangulation.cells, Pushed(triangulation, problem, random));
    Check(same.flow == cut.flow && same.is_source == cut.is_source,
          "flow that was pushed changes the cut", round);
  }
}

// Every edge of the surface has at most two faces, with opposite directions.
void CheckEdges(const Surface& surface, int round) {
  std::set<std::pair<Index, Index>> sides;
  for (const auto& face : surface.faces)
    for (int k = 0; k < 3; ++k)
      Check(sides.emplace(face[k], face[(k + 1) % 3]).second, "a directed edge occurs twice",
            round);
}

void TestSurfaceOfRandomLabels() {
  for (int round = 0; round < 100; ++round) {
    Random random(round);
    const auto points = Sorted(round % 2 ? GridPoints(3) : RandomPoints(60, random));
    const Triangulation triangulation = DelaunayBuilder(points).Flatten();
    std::vector<std::uint8_t> is_free(triangulation.cells.size());
    for (auto& label : is_free) label = random() % 2;
    SurfaceOptions options;
    options.long_facet_factor = round % 3 ? 0.8 : 0;
    const std::vector<double> ranges(points.size(), 1.5);
    const std::vector<Vec3> cameras{{0.5, 0.5, 9}};
    Rows rays;
    for (std::size_t v = 0; v < points.size(); ++v) {
      if (random() % 2) rays.values.push_back(0);
      rays.offsets.push_back(static_cast<std::int64_t>(rays.values.size()));
    }
    CheckEdges(ExtractSurface(triangulation, is_free, {rays, cameras, ranges}, options), round);
  }
}

// Whether each label has at most one component, by union of all pairs that share a facet.
bool IsDisk(const Triangulation& triangulation, const std::vector<std::uint8_t>& region, Index v) {
  const std::vector<Index> star(triangulation.stars.begin(v), triangulation.stars.end(v));
  int parts[2] = {0, 0};
  std::set<Index> seen;
  for (const Index seed : star) {
    if (seen.count(seed)) continue;
    ++parts[region[seed]];
    std::vector<Index> reached{seed};
    for (std::size_t i = 0; i < reached.size(); ++i) {
      if (!seen.insert(reached[i]).second) continue;
      for (const Index other : star) {
        const auto &a = triangulation.cells[other].vertices,
                   &b = triangulation.cells[reached[i]].vertices;
        const auto shared = std::count_if(
            a.begin(), a.end(), [&](Index w) { return std::count(b.begin(), b.end(), w); });
        if (shared == 3 && region[other] == region[seed]) reached.push_back(other);
      }
    }
  }
  return parts[0] <= 1 && parts[1] <= 1;
}

bool MayFlip(const Triangulation& triangulation, std::vector<std::uint8_t> region, Index cell) {
  region[cell] ^= 1;
  const auto& vertices = triangulation.cells[cell].vertices;
  return std::all_of(vertices.begin(), vertices.end(), [&](Index v) {
    return v == kInfinite || IsRegular(triangulation, region, v);
  });
}

// Random votes with ties are far from a manifold: the sweep must end with a manifold that no change
// of a single cell brings nearer to the votes.
void TestSweepEndsWithTheNearestManifold() {
  for (int round = 0; round < 60; ++round) {
    Random random(round);
    const auto points = Sorted(round % 2 ? GridPoints(5) : RandomPoints(150, random));
    const Triangulation triangulation = DelaunayBuilder(points).Flatten();
    std::vector<double> votes(triangulation.cells.size());
    for (double& vote : votes) vote = round % 3 ? int(random() % 20) - 10 : int(random() % 2) - 1;
    const ManifoldRegion region = SweepManifold(triangulation, votes);
    Index closed = 0, opened = 0;
    for (Index c = 0; c < triangulation.num_cells(); ++c) {
      const bool is_voted = votes[c] >= 0;
      closed += is_voted && !region.is_free[c];
      opened += !is_voted && region.is_free[c];
      if (bool(region.is_free[c]) != is_voted)
        Check(!MayFlip(triangulation, region.is_free, c), "the sweep stopped early", round);
    }
    Check(closed == region.cells_closed && opened == region.cells_opened, "miscounted", round);
    for (Index v = 0; v < triangulation.num_vertices(); ++v)
      Check(IsDisk(triangulation, region.is_free, v), "a vertex is no disk", round);
  }
}

// A manifold of any genus is not changed; here a ring of cubes' cells.
void TestSweepKeepsManifolds() {
  const auto points = Sorted(GridPoints(6));
  const Triangulation triangulation = DelaunayBuilder(points).Flatten();
  std::vector<double> votes(triangulation.cells.size(), 5);
  for (Index c = 0; c < triangulation.num_cells(); ++c) {
    const Cell& cell = triangulation.cells[c];
    if (cell.IsInfinite()) continue;
    Vec3 middle;
    for (Index v : cell.vertices) middle = middle + 0.25 * triangulation.points[v];
    const auto is_middle = [](double x) { return x > 2 && x < 3; };
    const auto is_inside = [](double x) { return x > 1 && x < 4; };
    if (is_inside(middle.x) && is_inside(middle.y) && is_middle(middle.z) &&
        !(is_middle(middle.x) && is_middle(middle.y)))
      votes[c] = -5;
  }
  const ManifoldRegion region = SweepManifold(triangulation, votes);
  Check(region.cells_closed == 0 && region.cells_opened == 0, "the sweep changed a ring", 0);
  Check(std::count(region.is_free.begin(), region.is_free.end(), 0) > 0, "no ring", 0);
}

void TestRepresentativesEqualBruteForce() {
  for (int round = 0; round < 60; ++round) {
    Random random(round);
    std::uniform_real_distribution<double> factor(0, 3);
    std::vector<Vec3> points = round % 2 ? GridPoints(6) : RandomPoints(300, random);
    for (Vec3& p : points) p = 0.2 * p;
    std::vector<double> radii(points.size());
    for (double& radius : radii) radius = random() % 5 ? 0.1 * factor(random) : 0;
    const auto representatives = Representatives(points, radii);
    for (Index v = 0; v < Index(points.size()); ++v) {
      Index expected = v;
      for (Index other = 0; other < v && radii[v] > 0; ++other) {
        const double low = std::min(radii[v], radii[other]),
                     high = std::max(radii[v], radii[other]);
        if (representatives[other] == other && high <= 2 * low &&
            Norm(points[v] - points[other]) <= low) {
          expected = other;
          break;
        }
      }
      Check(representatives[v] == expected, "a point has the wrong representative", round);
    }
  }
}

void CheckNoFaceTouchesCameras(const MesherInput& input, const MesherResult& result, int round) {
  for (const Vec3& vertex : result.vertices)
    for (const Index camera : input.background_cameras)
      Check(Norm(vertex - input.cameras[camera]) > 1e-12, "a face touches a camera", round);
}

void TestAllMethodsOnHardInput() {
  for (int round = 0; round < 60; ++round) {
    Random random(round);
    MesherInput input;
    input.points = round % 2 ? GridPoints(4) : RandomPoints(100, random);
    input.cameras = round % 3 ? RandomPoints(5, random) : GridPoints(2);
    for (std::size_t i = 0; i < input.points.size(); ++i) {
      for (unsigned n = random() % 4; n > 0; --n)
        input.visibility.values.push_back(random() % input.cameras.size());
      input.visibility.offsets.push_back(input.visibility.values.size());
    }
    for (int n = 0; n < 40; ++n) input.polylines.values.push_back(random() % input.points.size());
    input.polylines.offsets = {0, 15, 40};
    for (unsigned n = round % 4 ? random() % 50 : 0; n > 0; --n) {
      input.background_cameras.push_back(random() % input.cameras.size());
      input.background_directions.push_back(round % 2 ? Vec3{1, double(n % 2), 0}
                                                      : RandomPoints(1, random)[0]);
    }
    MesherOptions options;
    options.visibility.num_threads = options.votes.num_threads = 1 + round % 3;
    for (const char* method : {"graphcut", "carve", "manifold"}) {
      options.method = method;
      const MesherResult result = MeshPoints(input, options);
      if (options.method != "manifold") CheckNoFaceTouchesCameras(input, result, round);
      for (const auto& face : result.faces)
        for (Index v : face)
          Check(v >= 0 && v < Index(result.vertices.size()), "a face has no vertex", round);
    }
  }
}

}  // namespace
}  // namespace mesher

int main() {
  mesher::TestWalkerOnRandomPoints();
  mesher::TestWalkerOnGrids();
  mesher::TestWalkerStartsAnywhere();
  mesher::TestFarWeights();
  mesher::TestCutEqualsBoost();
  mesher::TestSurfaceOfRandomLabels();
  mesher::TestSweepEndsWithTheNearestManifold();
  mesher::TestSweepKeepsManifolds();
  mesher::TestRepresentativesEqualBruteForce();
  mesher::TestAllMethodsOnHardInput();
  std::puts("all passed");
  return 0;
}
