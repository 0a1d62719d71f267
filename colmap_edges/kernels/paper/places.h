// Places on the chains of all views: search near a pixel, and walks along chains.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/edge_index.h"
#include "common/geometry.h"
#include "common/polyline.h"

namespace colmap_edges {

using Views = std::vector<const EdgeIndex*>;

// A place on a chain of a view.
struct Place {
  int32_t view;
  double position;
};

// The place of a polyline nearest to a pixel.
struct NearPolyline {
  int32_t polyline;
  double position, distance;
};

// The nearest place of each polyline of a view within `radius` px of a pixel, by ascending
// polyline.
inline void FindNear(const EdgeIndex& chains, const Vec2& pixel, double radius,
                     std::vector<NearPolyline>* found) {
  found->clear();
  if (!(std::isfinite(pixel.x) && std::isfinite(pixel.y))) return;
  const double reach = radius + chains.longest_segment();
  chains.VisitNear(pixel, reach, [&](int64_t i, double dx, double dy) {
    const int64_t next = chains.Next(i);
    if (next < 0 || dx * dx + dy * dy > reach * reach) return;
    const Vec2 a = chains.point(i), b = chains.point(next);
    if (std::min(a.x, b.x) > pixel.x + radius || std::max(a.x, b.x) < pixel.x - radius ||
        std::min(a.y, b.y) > pixel.y + radius || std::max(a.y, b.y) < pixel.y - radius) {
      return;
    }
    const double t = NearestFraction(pixel, a, b);
    const double distance = Norm(a + t * (b - a) - pixel);
    if (distance > radius) return;
    const NearPolyline here = {chains.polyline(i), chains.Position(i, t), distance};
    for (NearPolyline& near : *found) {
      if (near.polyline != here.polyline) continue;
      const bool first = distance == near.distance && here.position < near.position;
      if (distance < near.distance || first) near = here;
      return;
    }
    found->push_back(here);
  });
  std::sort(found->begin(), found->end(),
            [](const NearPolyline& a, const NearPolyline& b) { return a.polyline < b.polyline; });
}

// Walks along a chain from a position in ascending (sign +1) or descending (-1) order of points.
// Calls visit(i, next, begin) for each segment i -> next, from the fraction `begin` on. Ends if
// visit returns true, at an open end, or after one round. Returns whether visit returned true.
template <typename Visit>
bool WalkSegments(const EdgeIndex& chains, double position, int sign, const Visit& visit) {
  int64_t i = int64_t(position);
  double begin = position - double(i);
  const int32_t p = chains.polyline(i);
  for (int64_t step = chains.first(p); step <= chains.last(p) + 1; ++step) {
    const int64_t next = chains.Next(i);
    if (next >= 0 && visit(i, next, begin)) return true;
    const int64_t after = sign > 0 ? next : chains.Advance(i, -1);
    if (after < 0 || after == i) return false;
    i = after, begin = sign > 0 ? 0 : 1;
  }
  return false;
}

// Walks `length` px along the chain. False at the end.
inline bool Walk(const EdgeIndex& chains, double from, int sign, double length, double* to) {
  return WalkSegments(chains, from, sign, [&](int64_t i, int64_t next, double begin) {
    const double whole = Norm(chains.point(next) - chains.point(i));
    const double left = (sign > 0 ? 1 - begin : begin) * whole;
    if (length > left || !(whole > 0)) {
      length -= left;
      return false;
    }
    *to = chains.Position(i, std::clamp(begin + sign * length / whole, 0.0, 1.0));
    return true;
  });
}

// First intersection of the chain with the line on a walk from `from` of at most `reach` px.
inline bool FirstCrossing(const EdgeIndex& chains, double from, int sign, const Line2D& line,
                          double reach, double* to) {
  double walked = 0;
  bool crosses = false;
  WalkSegments(chains, from, sign, [&](int64_t i, int64_t next, double begin) {
    const Vec2 a = chains.point(i), b = chains.point(next);
    double t;
    if (line.Crosses(a, b, &t) && (walked > 0 || (sign > 0 ? t > begin : t < begin))) {
      crosses = walked + std::abs(t - begin) * Norm(b - a) <= reach;
      *to = chains.Position(i, t);
      return true;
    }
    walked += (sign > 0 ? 1 - begin : begin) * Norm(b - a);
    return walked > reach;
  });
  return crosses;
}

}  // namespace colmap_edges
