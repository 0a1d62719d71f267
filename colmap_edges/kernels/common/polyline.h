// Polylines of pixels: Douglas-Peucker smoothing.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

// Fraction in [0, 1] along the segment a-b of its point nearest to p.
inline double NearestFraction(const Vec2& p, const Vec2& a, const Vec2& b) {
  const Vec2 d = b - a;
  const double length2 = Dot(d, d);
  const double t = length2 > 0 ? Dot(p - a, d) / length2 : 0;
  return t < 0 ? 0 : (t > 1 ? 1 : t);
}

// Squared distance of p to the segment a-b.
inline double SquaredDistanceToSegment(const Vec2& p, const Vec2& a, const Vec2& b) {
  const Vec2 e = a + NearestFraction(p, a, b) * (b - a) - p;
  return Dot(e, e);
}

// Appends to `kept` the indices in [first, last], ascending and with both ends, that
// Douglas-Peucker keeps so that no point is farther than `distance` from the polyline. `point(i)`
// is a Vec2.
template <typename Point>
void DouglasPeucker(const Point& point, int64_t first, int64_t last, double distance,
                    std::vector<int64_t>* kept) {
  kept->push_back(first);
  if (last <= first) return;
  std::vector<std::pair<int64_t, int64_t>> stack = {{first, last}};
  while (!stack.empty()) {
    const auto [a, b] = stack.back();
    stack.pop_back();
    double worst = distance * distance;
    int64_t split = -1;
    for (int64_t i = a + 1; i < b; ++i) {
      const double d = SquaredDistanceToSegment(point(i), point(a), point(b));
      if (d > worst) worst = d, split = i;
    }
    if (split < 0) {
      kept->push_back(b);
    } else {
      stack.push_back({split, b});
      stack.push_back({a, split});
    }
  }
}

}  // namespace colmap_edges
