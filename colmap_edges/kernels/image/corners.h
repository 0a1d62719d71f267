// Corners of chains of pixels: intersections of the lines along a chain before and after a bend.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

// Conditions for a corner. An arm consists of `arm` points on one side of it, beyond the `rounded`
// ones that blur may displace. Lengths are in pixels.
struct CornerLimits {
  int64_t rounded, arm;
  double bent_cosine;                 // maximum cosine of the angle between the arms' chords
  double max_cosine;                  // maximum cosine of the angle between the arms' lines
  double max_scatter;                 // maximum root mean square distance of an arm to its line
  double slack, max_radius, max_cut;  // limits of the distance from the chain, see MaxDistance
};

// A line through points.
struct Line {
  Vec2 center, direction;  // the direction is forward along the chain
  double scatter;
};

// A corner of a chain: the index of the point, and the intersection of the lines with its distance.
struct Corner {
  int64_t point;
  Vec2 crossing;
  double distance;
};

// One chain; indices of closed ones wrap around.
struct Chain {
  const double* points;
  int64_t first, length;
  bool wraps;

  int64_t Index(int64_t k) const {
    if (k >= 0 && k < length) return first + k;
    return first + (k % length + length) % length;
  }
  Vec2 At(int64_t k) const {
    const double* p = points + 2 * Index(k);
    return {p[0], p[1]};
  }
};

// The line through the points [begin, end) of a chain.
inline Line FitLine(const Chain& chain, int64_t begin, int64_t end) {
  const double count = double(end - begin);
  Vec2 center;
  for (int64_t k = begin; k < end; ++k) center = center + chain.At(k);
  center = (1 / count) * center;
  double xx = 0, xy = 0, yy = 0;
  for (int64_t k = begin; k < end; ++k) {
    const Vec2 d = chain.At(k) - center;
    xx += d.x * d.x, xy += d.x * d.y, yy += d.y * d.y;
  }
  xx /= count, xy /= count, yy /= count;
  // Half the angle of (xx - yy, 2 xy), from its cosine: x >= 0.
  const double half = (xx - yy) / 2, radius = std::sqrt(half * half + xy * xy);
  const double cosine = radius > 0 ? half / radius : 1;
  Vec2 direction = {std::sqrt(std::max((1 + cosine) / 2, 0.0)),
                    std::copysign(std::sqrt(std::max((1 - cosine) / 2, 0.0)), xy)};
  if (Dot(direction, chain.At(end - 1) - chain.At(begin)) < 0) direction = -1.0 * direction;
  return {center, direction, std::sqrt(std::max((xx + yy) / 2 - radius, 0.0))};
}

// Maximum distance of a corner from the chain: blur rounds it to an arc of at most `max_radius`.
inline double MaxDistance(double cosine, const CornerLimits& limits) {
  const double half = std::sqrt(std::clamp((1 + cosine) / 2, 1e-6, 1.0));
  return std::min(limits.slack + limits.max_radius * (1 / half - 1), limits.max_cut);
}

// Whether the k-th point of a chain is at a corner; writes the corner.
inline bool FindCorner(const Chain& chain, int64_t k, const CornerLimits& limits, Corner* corner) {
  const int64_t near = limits.rounded, far = near + limits.arm - 1;
  const Vec2 into = chain.At(k - near) - chain.At(k - far);
  const Vec2 out = chain.At(k + far) - chain.At(k + near);
  if (Dot(into, out) > limits.bent_cosine * std::sqrt(Dot(into, into) * Dot(out, out))) {
    return false;
  }
  const Line before = FitLine(chain, k - far, k - near + 1);
  const Line after = FitLine(chain, k + near, k + far + 1);
  const double cosine = Dot(before.direction, after.direction);
  if (cosine > limits.max_cosine) return false;
  if (std::max(before.scatter, after.scatter) > limits.max_scatter) return false;
  const double sine = Cross(before.direction, after.direction);
  const double along =
      Cross(after.center - before.center, after.direction) / (std::abs(sine) < 1e-9 ? 1e-9 : sine);
  const Vec2 crossing = before.center + along * before.direction;
  const double distance = Norm(crossing - chain.At(k));
  if (distance > MaxDistance(cosine, limits)) return false;
  // The intersection must lie beyond the points of both arms.
  if (Dot(crossing - chain.At(k - near), before.direction) <= 0) return false;
  if (Dot(chain.At(k + near) - crossing, after.direction) <= 0) return false;
  *corner = {chain.Index(k), crossing, distance};
  return true;
}

// Appends the corners of a chain, ascending. Of corners within 2 `rounded` points of each other,
// the one nearest to the chain is kept.
inline void FindCorners(const Chain& chain, const CornerLimits& limits,
                        std::vector<Corner>* corners) {
  const int64_t reach = limits.rounded + limits.arm - 1;
  if (chain.length <= 2 * reach) return;
  const int64_t begin = chain.wraps ? 0 : reach;
  std::vector<Corner> found;
  for (int64_t k = begin; k < chain.length - begin; ++k) {
    Corner corner;
    if (FindCorner(chain, k, limits, &corner)) found.push_back(corner);
  }
  std::stable_sort(found.begin(), found.end(),
                   [](const Corner& a, const Corner& b) { return a.distance < b.distance; });
  std::vector<bool> taken(chain.length);
  std::vector<Corner> kept;
  for (const Corner& corner : found) {
    const int64_t k = corner.point - chain.first;
    if (taken[k]) continue;
    kept.push_back(corner);
    for (int64_t near = k - 2 * limits.rounded; near <= k + 2 * limits.rounded; ++near) {
      taken[chain.Index(near) - chain.first] = true;
    }
  }
  std::sort(kept.begin(), kept.end(),
            [](const Corner& a, const Corner& b) { return a.point < b.point; });
  corners->insert(corners->end(), kept.begin(), kept.end());
}

}  // namespace colmap_edges
