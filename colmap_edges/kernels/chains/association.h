// Observations of 3D edge points in a view: the nearest point of a chain parallel to the edge.
#pragma once

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

// The position on a chain of `view` that observes the 3D point with the given tangent, or -1.
// `side` is +1 where the bright side lies to the left of the tangent, seen in an image with y
// down as the sign of cross(tangent, normal), -1 where it lies to the right, 0 where unknown.
inline double Associate(const EdgeIndex& view, const Vec3& world, const Vec3& tangent, int8_t side,
                        const AssociationParameters& parameters) {
  const Vec3 local = view.pose().FromWorld(world);
  if (!(local[2] > 0)) return -1;
  const double scale = view.focal() / local[2];
  const Vec2 x = {scale * local[0], scale * local[1]};
  const Vec3 turned = Multiply(view.rotation(), tangent);
  const double tx = turned[0] * local[2] - local[0] * turned[2];
  const double ty = turned[1] * local[2] - local[1] * turned[2];
  const double norm = std::sqrt(tx * tx + ty * ty);
  if (!(norm > 0)) return -1;
  const double min_along = parameters.min_cosine * norm;
  const int64_t nearest = view.Nearest(x, parameters.max_distance_px, [&](int64_t i) {
    const Vec2& t = view.tangent(i);
    if (std::abs(t[0] * tx + t[1] * ty) < min_along) return false;
    const Vec2& n = view.normal(i);
    return side == 0 || (tx * n[1] - ty * n[0]) * side >= 0;
  });
  return nearest < 0 ? -1 : NearestPosition(view, nearest, x);
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
    const int64_t k = task / num_blocks, first = task % num_blocks * kBlock;
    for (int64_t i = first; i < std::min(first + kBlock, count); ++i) {
      const double *p = points + 3 * i, *t = tangents + 3 * i;
      positions[i * num_views + k] =
          Associate(*views[k], {p[0], p[1], p[2]}, {t[0], t[1], t[2]}, sides[i], parameters);
    }
  });
  return positions;
}

}  // namespace colmap_edges
