// Polylines of pixels: Douglas-Peucker smoothing and directions along a chain.
#pragma once

#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

namespace colmap_edges {

// Squared distance of p to the segment a-b.
inline double SquaredDistanceToSegment(const double* p, const double* a, const double* b) {
  const double dx = b[0] - a[0], dy = b[1] - a[1];
  const double length2 = dx * dx + dy * dy;
  double t = length2 > 0 ? ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / length2 : 0;
  t = t < 0 ? 0 : (t > 1 ? 1 : t);
  const double ex = a[0] + t * dx - p[0], ey = a[1] + t * dy - p[1];
  return ex * ex + ey * ey;
}

// Indices in [first, last] that Douglas-Peucker keeps so that no point is farther than `distance`
// from the kept polyline; both ends are kept. Appended to `kept` in ascending order. `point(i)` is
// a pointer to the two coordinates of point i.
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
