// SPDX-License-Identifier: GPL-3.0-or-later
#include "visibility.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include "parallel.h"
#include "ray_walker.h"

namespace mesher {
namespace {

std::int64_t Scaled(double factor, std::int64_t weight) { return std::llround(factor * weight); }

// Weight 1 - exp(-d^2 / 2 sigma^2) of a crossing at distance d from a point. The exponential is one
// of a table times a short series; its error is far below the unit of the weights.
class SoftWeight {
 public:
  explicit SoftWeight(double sigma) : factor_(0.5 * kSteps / (sigma * sigma)), far_(6 * sigma) {
    for (int i = 0; i < kSize; ++i) table_[i] = kRayWeight * std::exp(-double(i) / kSteps);
  }

  double far() const { return far_; }
  // A distance may be negative where a facet contains the ray, which crosses it at no one place.
  std::int64_t operator()(double distance) const {
    if (distance >= far_) return kRayWeight;
    if (distance <= 0) return 0;
    const double at = factor_ * distance * distance;
    const int nearest = static_cast<int>(at + 0.5);
    const double x = (nearest - at) / kSteps;
    const double series =
        1 + x * (1 + x * (1. / 2 + x * (1. / 6 + x * (1. / 24 + x * (1. / 120)))));
    return static_cast<std::int64_t>(kRayWeight - table_[nearest] * series + 0.5);
  }

 private:
  static constexpr int kSteps = 64, kSize = 18 * kSteps + 2;  // up to 6^2 / 2, rounded up
  double factor_, far_;
  double table_[kSize];
};

// Sums of a problem, to which several threads may add. One alone need not lock the memory, which
// takes a fifth of its time.
struct Sums {
  CutProblem& problem;
  bool are_shared;

  void Add(std::int64_t& sum, std::int64_t value) const {
    if (are_shared)
      AtomicAdd(sum, value);
    else
      sum += value;
  }
};

// A ray on its way from a point to a camera. The flow that all its facets can carry from the camera
// is pushed to its cells at once, which changes neither the minimum cut nor its value: facets get
// the residual in the opposite direction, cells what flows in and not out.
struct RayToCamera {
  RayWalker walker;
  RayWalker::Position at;
  std::int64_t far_weight;  // weight of the part that is far from the point
  std::int64_t pushed = 0;  // through the last facet
  bool is_far = false;
};

// Returns whether the ray goes on. Without a part that is far from the point nothing flows in.
bool StepRay(const SoftWeight& soft_weight, RayToCamera& ray, const Sums& sums) {
  const bool goes_on = ray.walker.Step(soft_weight.far(), ray.at, [&](const Crossing& crossing) {
    ray.is_far |= crossing.distance >= soft_weight.far();
    if (ray.is_far && ray.far_weight == 0) return false;
    const std::int64_t amount = soft_weight(crossing.distance) * (ray.is_far ? ray.far_weight : 1);
    const std::size_t forward = 4 * std::size_t(crossing.next) + crossing.entry;
    const std::size_t backward = 4 * std::size_t(crossing.cell) + crossing.facet;
    sums.Add(sums.problem.arcs[ray.far_weight == 0 ? forward : backward], amount);
    if (ray.far_weight != 0 && amount != ray.pushed) {
      sums.Add(sums.problem.source[crossing.cell], amount - ray.pushed);
      ray.pushed = amount;
    }
    return true;
  });
  if (!goes_on && ray.at.cell != kNone && !ray.is_far)
    sums.Add(sums.problem.source[ray.at.cell], kRayWeight - ray.pushed);
  return goes_on;
}

// Adds all but the crossings between the point and the camera.
void AddEnds(const RayWalker& walker, const SoftWeight& weight, double solid, const Sums& sums) {
  if (walker.front() == kNone)
    walker.VisitOutside(true, [&](Index cell) { sums.Add(sums.problem.source[cell], kRayWeight); });
  const std::int64_t solid_weight = Scaled(solid, kRayWeight);
  if (walker.behind() == kNone) {
    walker.VisitOutside(false,
                        [&](Index cell) { sums.Add(sums.problem.sink[cell], solid_weight); });
  } else {
    const Crossing exit = walker.BehindExit();
    sums.Add(sums.problem.arcs[4 * std::size_t(exit.cell) + exit.facet],
             Scaled(solid, weight(exit.distance)));
    sums.Add(sums.problem.sink[exit.next], solid_weight);
  }
}

// Adds the rays of the vertices [begin, end).
void AddRays(const Triangulation& triangulation, const Rows& rays, const std::vector<Index>& far,
             const std::vector<Vec3>& cameras, const std::vector<std::uint8_t>& is_edge,
             Index begin, Index end, double edge_solid, const SoftWeight& weight,
             const Sums& sums) {
  Index vertex = begin;
  std::int64_t ray = rays.offsets[begin];
  StartCells near;
  auto start = [&]() -> std::optional<RayToCamera> {
    for (; ray < rays.offsets[end]; ++ray) {
      for (; ray == rays.offsets[vertex + 1]; near = {}) ++vertex;
      const RayWalker walker(triangulation, vertex, cameras[rays.values[ray]], near);
      near = walker.near();
      AddEnds(walker, weight, is_edge[vertex] ? edge_solid : 1, sums);
      if (walker.front() != kNone) return RayToCamera{walker, walker.Start(), far[ray++]};
    }
    return std::nullopt;
  };
  TakeTurns(start, [&](RayToCamera& ray) { return StepRay(weight, ray, sums); });
}

// Adds background rays, from the convex hull's inside only.
void AddBackgroundRays(const Triangulation& triangulation, const BackgroundRay* begin,
                       const BackgroundRay* end, std::int64_t weight, const Sums& sums) {
  using Walk = std::pair<RayWalker, RayWalker::Position>;
  StartCells near;
  auto start = [&, ray = begin]() mutable -> std::optional<Walk> {
    while (ray != end) {
      if (ray == begin || ray->vertex != ray[-1].vertex) near = {};
      const RayWalker walker(triangulation, ray->vertex, ray->target, near);
      near = walker.near();
      ++ray;
      if (walker.front() != kNone) return Walk{walker, walker.Start()};
    }
    return std::nullopt;
  };
  TakeTurns(start, [&](Walk& walk) {
    return walk.first.Step(0, walk.second, [&](const Crossing& crossing) {
      sums.Add(sums.problem.arcs[4 * std::size_t(crossing.cell) + crossing.facet], weight);
      return true;
    });
  });
}

struct Sphere {
  Vec3 center;
  bool is_flat;
};

Sphere Circumsphere(const Triangulation& triangulation, const Cell& cell) {
  const auto& points = triangulation.points;
  const Vec3& origin = points[cell.vertices[0]];
  const Vec3 a = points[cell.vertices[1]] - origin;
  const Vec3 b = points[cell.vertices[2]] - origin;
  const Vec3 c = points[cell.vertices[3]] - origin;
  const double volume = 2 * Dot(a, Cross(b, c));
  const Vec3 sum = Dot(a, a) * Cross(b, c) + Dot(b, b) * Cross(c, a) + Dot(c, c) * Cross(a, b);
  const Vec3 center = origin + (1 / volume) * sum;
  return {center, volume == 0 || !IsFinite(center)};
}

// Cosine of the angle between a facet (normal pointing out of the cell) and the cell's sphere; 1
// for half spaces, which infinite and flat cells have in place of a sphere.
double SphereCosine(const Sphere& sphere, const Vec3& corner, const Vec3& outward) {
  if (sphere.is_flat) return 1;
  const Vec3 radius = sphere.center - corner;
  const double norm = Norm(radius) * Norm(outward);
  return norm > 0 ? -Dot(radius, outward) / norm : 1;
}

// Penalty between 0 and 2 for facets with large empty spheres on either side.
void AddQuality(const Triangulation& triangulation, const VisibilityOptions& options,
                CutProblem& problem) {
  std::vector<Sphere> spheres(triangulation.cells.size());
  ParallelChunks(triangulation.num_cells(), options.num_threads, [&](auto begin, auto end) {
    for (auto c = begin; c < end; ++c) {
      const Cell& cell = triangulation.cells[c];
      spheres[c] = cell.IsInfinite() ? Sphere{{}, true} : Circumsphere(triangulation, cell);
    }
  });
  const double unit = options.quality_weight * kRayWeight;
  const auto& points = triangulation.points;
  ParallelChunks(triangulation.num_cells(), options.num_threads, [&](auto begin, auto end) {
    for (auto c = begin; c < end; ++c) {
      const Cell& cell = triangulation.cells[c];
      for (int i = 0; i < 4; ++i) {
        const Index a = cell.vertices[kFacet[i][0]], b = cell.vertices[kFacet[i][1]],
                    d = cell.vertices[kFacet[i][2]];
        const Index other = cell.neighbors[i];
        if (other < c) continue;
        if (a == kInfinite || b == kInfinite || d == kInfinite) continue;
        const Vec3 outward = Cross(points[b] - points[a], points[d] - points[a]);
        const double cosine = std::min(SphereCosine(spheres[c], points[a], outward),
                                       SphereCosine(spheres[other], points[a], -1.0 * outward));
        const std::int64_t penalty = std::llround(unit * (1 - cosine));
        problem.arcs[4 * c + i] += penalty;
        problem.arcs[4 * std::size_t(other) + triangulation.MirrorIndex(c, other)] += penalty;
      }
    }
  });
}

using Cube = std::array<double, 3>;

// The cube of a grid that holds a point; without a side, the point itself.
Cube CubeOf(const Vec3& point, double side) {
  Cube cube;
  for (int axis = 0; axis < 3; ++axis)
    cube[axis] = side > 0 ? std::floor(point[axis] / side) : point[axis];
  return cube;
}

}  // namespace

double TypicalSpacing(const Triangulation& triangulation) {
  std::vector<Index> seen_from(triangulation.points.size(), kNone);
  std::vector<double> lengths;
  lengths.reserve(8 * triangulation.points.size());
  for (Index v = 0; v < triangulation.num_vertices(); ++v) {
    for (const Index* c = triangulation.stars.begin(v); c != triangulation.stars.end(v); ++c) {
      for (Index other : triangulation.cells[*c].vertices) {
        if (other <= v || seen_from[other] == v) continue;
        seen_from[other] = v;
        lengths.push_back(Norm(triangulation.points[other] - triangulation.points[v]));
      }
    }
  }
  auto quartile = lengths.begin() + lengths.size() / 4;
  std::nth_element(lengths.begin(), quartile, lengths.end());
  return *quartile;
}

std::vector<Index> FarWeights(const std::vector<Vec3>& points,
                              const std::vector<std::uint8_t>& is_edge, const Rows& rays,
                              std::size_t num_cameras, double side) {
  std::vector<std::pair<Cube, Index>> vertices;
  for (Index v = 0; v < rays.size(); ++v)
    if (is_edge[v]) vertices.emplace_back(CubeOf(points[v], side), v);
  std::sort(vertices.begin(), vertices.end());
  std::vector<Index> weights(rays.values.size(), 0);
  for (Index v = 0; v < rays.size(); ++v)
    if (!is_edge[v])
      std::fill(weights.begin() + rays.offsets[v], weights.begin() + rays.offsets[v + 1], 1);
  struct Walked {
    const Cube* cube = nullptr;
    std::int64_t ray = 0;
  };
  std::vector<Walked> walked(num_cameras);  // by camera: in the last cube that it saw
  for (const auto& [cube, v] : vertices)
    for (auto ray = rays.offsets[v]; ray < rays.offsets[v + 1]; ++ray) {
      Walked& last = walked[rays.values[ray]];
      if (!last.cube || *last.cube != cube) last = {&cube, ray};
      ++weights[last.ray];
    }
  return weights;
}

CutProblem VisibilityProblem(const Triangulation& triangulation, const Rows& rays,
                             const std::vector<Vec3>& cameras,
                             const std::vector<std::uint8_t>& is_edge,
                             const std::vector<BackgroundRay>& background,
                             const VisibilityOptions& options) {
  CutProblem problem(triangulation.cells.size());
  const Sums sums{problem, options.num_threads > 1};
  const double sigma = options.sigma_factor * TypicalSpacing(triangulation);
  const SoftWeight weight(sigma);
  const auto far_weights = FarWeights(triangulation.points, is_edge, rays, cameras.size(), sigma);
  ParallelChunks(triangulation.num_vertices(), options.num_threads, [&](auto begin, auto end) {
    AddRays(triangulation, rays, far_weights, cameras, is_edge, begin, end,
            options.edge_solid_weight, weight, sums);
  });
  const std::int64_t background_weight = Scaled(options.background_weight, kRayWeight);
  VisitAroundCameras(triangulation, background, [&](Index cell, std::int64_t num_rays) {
    problem.source[cell] += num_rays * background_weight;
  });
  ParallelChunks(background.size(), options.num_threads, [&](auto begin, auto end) {
    AddBackgroundRays(triangulation, background.data() + begin, background.data() + end,
                      background_weight, sums);
  });
  AddQuality(triangulation, options, problem);
  return problem;
}

}  // namespace mesher
