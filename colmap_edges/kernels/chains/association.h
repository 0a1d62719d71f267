// Observations of 3D edge points in a view: the nearest point of a chain parallel to the edge.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/edge_index.h"
#include "common/parallel.h"

namespace colmap_edges {

struct AssociationParameters {
  double max_distance_px;
  double min_cosine;  // minimum cosine of the angle between projected tangent and chain
};

// Fractional position nearest to x on the chain around point i.
inline double NearestPosition(const EdgeIndex& view, int64_t i, const Vec2& x) {
  const Vec2& p = view.point(i);
  const Vec2& t = view.tangent(i);
  const bool ahead = (x[0] - p[0]) * t[0] + (x[1] - p[1]) * t[1] > 0;
  const int64_t from = ahead ? i : view.Advance(i, -1);
  const int64_t to = ahead ? view.Next(i) : i;
  if (to < 0 || from == to) return double(i);
  // Slightly before the next point, whose index is not i + 1 at the end of a closed chain.
  return double(from) + std::min(NearestFraction(x, view.point(from), view.point(to)), 0.999999);
}

// A 3D edge point and its direction in a view.
struct ProjectedPoint {
  Vec2 pixel{NAN, NAN};  // NaN if it cannot be observed
  Vec2 tangent;          // of any length
  double norm;           // of the tangent
};

inline ProjectedPoint ProjectTo(const EdgeIndex& view, const Vec3& world, const Vec3& tangent) {
  ProjectedPoint projected;
  const Vec3 local = view.pose().FromWorld(world);
  if (!(local[2] > 0)) return projected;
  const Vec3 turned = Multiply(view.rotation(), tangent);
  const double tx = turned[0] * local[2] - local[0] * turned[2];
  const double ty = turned[1] * local[2] - local[1] * turned[2];
  const double norm = std::sqrt(tx * tx + ty * ty);
  if (!(norm > 0)) return projected;
  const double scale = view.focal() / local[2];
  return {{scale * local[0], scale * local[1]}, {tx, ty}, norm};
}

// The point of a chain of `view` that is nearest to a projected point and parallel, or -1.
// `side` is +1 where the bright side lies to the left of the tangent, seen in an image with y
// down as the sign of cross(tangent, normal), -1 where it lies to the right, 0 where unknown.
inline int64_t NearestParallel(const EdgeIndex& view, const ProjectedPoint& at, int8_t side,
                               const AssociationParameters& parameters) {
  using Directions = EdgeIndex::Directions;
  const double tx = at.tangent.x, ty = at.tangent.y;
  const double min_along = parameters.min_cosine * at.norm;
  const double error = 1.01 * Directions::kError * (std::abs(tx) + std::abs(ty));
  return view.Nearest(at.pixel, parameters.max_distance_px, [&](int64_t i, const Directions& d) {
    // The rounded directions decide unless they are within their error of the limit.
    constexpr double kUnit = 1 / Directions::kScale;
    const double along = kUnit * std::abs(d.tangent[0] * tx + d.tangent[1] * ty);
    const double aside = kUnit * (tx * d.normal[1] - ty * d.normal[0]) * side;
    if (along < min_along - error || aside < -error) return false;
    if (along > min_along + error && (side == 0 || aside > error)) return true;
    const Vec2& t = view.tangent(i);
    if (std::abs(t[0] * tx + t[1] * ty) < min_along) return false;
    const Vec2& n = view.normal(i);
    return side == 0 || (tx * n[1] - ty * n[0]) * side >= 0;
  });
}

// The position on a chain of `view` that observes the 3D point with the given tangent, or -1.
inline double Associate(const EdgeIndex& view, const Vec3& world, const Vec3& tangent, int8_t side,
                        const AssociationParameters& parameters) {
  const ProjectedPoint at = ProjectTo(view, world, tangent);
  const int64_t nearest = NearestParallel(view, at, side, parameters);
  return nearest < 0 ? -1 : NearestPosition(view, nearest, at.pixel);
}

// (count, K) positions of points in K views, -1 where none.
inline std::vector<double> AssociateAll(const std::vector<const EdgeIndex*>& views,
                                        const double* points, const double* tangents,
                                        const int8_t* sides, int64_t count,
                                        const AssociationParameters& parameters, int num_threads) {
  constexpr int64_t kBlock = 8192;  // points; a view's chains stay in the cache meanwhile
  const int64_t num_views = int64_t(views.size()), num_blocks = (count + kBlock - 1) / kBlock;
  std::vector<double> positions(count * num_views);
  ParallelFor(num_views * num_blocks, num_threads, [&](int64_t task, int) {
    constexpr int64_t kFetched = 16;  // points of which the data are fetched at once
    const int64_t k = task / num_blocks, begin = task % num_blocks * kBlock;
    const EdgeIndex& view = *views[k];
    const double radius = parameters.max_distance_px;
    ProjectedPoint projected[kFetched];
    int64_t nearest[kFetched];
    for (int64_t first = begin; first < std::min(begin + kBlock, count); first += kFetched) {
      const int64_t size = std::min(kFetched, count - first);
      for (int64_t i = 0; i < size; ++i) {
        const double *p = points + 3 * (first + i), *t = tangents + 3 * (first + i);
        projected[i] = ProjectTo(view, {p[0], p[1], p[2]}, {t[0], t[1], t[2]});
        if (view.Reaches(projected[i].pixel, radius))
          view.PrefetchCells(projected[i].pixel, radius);
      }
      for (int64_t i = 0; i < size; ++i) {
        const Vec2& pixel = projected[i].pixel;
        if (view.Reaches(pixel, radius)) view.PrefetchCellPoints(pixel, radius);
      }
      for (int64_t i = 0; i < size; ++i) {
        nearest[i] = NearestParallel(view, projected[i], sides[first + i], parameters);
        if (nearest[i] >= 0) view.Prefetch(nearest[i]);
      }
      for (int64_t i = 0; i < size; ++i) {
        positions[(first + i) * num_views + k] =
            nearest[i] < 0 ? -1 : NearestPosition(view, nearest[i], projected[i].pixel);
      }
    }
  });
  return positions;
}

// (N, K) positions without those of points whose neighbours on the curve are observed elsewhere: a
// neighbour must be at most four times the median step away. NaN where none; offsets: CSR of the N
// points by curve.
inline std::vector<double> DropLone(const double* positions, const std::vector<int64_t>& offsets,
                                    int64_t num_views) {
  std::vector<double> steps;
  const auto for_steps = [&](const auto& use) {
    for (size_t c = 0; c + 1 < offsets.size(); ++c) {
      for (int64_t i = offsets[c] * num_views; i < (offsets[c + 1] - 1) * num_views; ++i) {
        const double step = std::abs(positions[i + num_views] - positions[i]);
        if (!std::isnan(step)) use(i, step);
      }
    }
  };
  for_steps([&](int64_t, double step) { steps.push_back(step); });
  std::vector<double> kept(offsets.back() * num_views, NAN);
  if (steps.empty()) return kept;
  const auto middle = steps.begin() + steps.size() / 2;
  std::nth_element(steps.begin(), middle, steps.end());
  double median = *middle;
  if (steps.size() % 2 == 0) median = (median + *std::max_element(steps.begin(), middle)) / 2;
  for_steps([&](int64_t i, double step) {
    if (step > 4 * median) return;
    kept[i] = positions[i], kept[i + num_views] = positions[i + num_views];
  });
  return kept;
}

}  // namespace colmap_edges
