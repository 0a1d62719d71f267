// Depths along the ray of an edge point at which candidates in other views agree (paper:
// PEPC-selection).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/geometry.h"

namespace colmap_edges {

// The interval of inverse distances along a ray that is consistent with one candidate of a view.
struct DepthInterval {
  double low, high;
  int32_t view;  // from 0
};

// A local maximum of the number of consistent views.
struct AgreedDepth {
  double inverse_distance;
  int32_t num_views;
};

// Finds inverse distances at local maxima of the number of consistent views, of at least
// `min_views`, in descending order of this number; of equal ones, far points first.
inline void FindAgreement(const std::vector<DepthInterval>& intervals, int min_views,
                          std::vector<AgreedDepth>* agreed) {
  struct Event {
    double at;
    bool ends;
    int32_t view;
  };
  thread_local std::vector<Event> events;
  thread_local std::vector<int32_t> open;
  events.clear(), agreed->clear();
  int32_t num_views = 0;
  for (const DepthInterval& interval : intervals) {
    events.push_back({interval.low, false, interval.view});
    events.push_back({interval.high, true, interval.view});
    num_views = std::max(num_views, interval.view + 1);
  }
  std::sort(events.begin(), events.end(), [](const Event& a, const Event& b) {
    return a.at != b.at ? a.at < b.at : a.ends < b.ends;
  });
  open.assign(num_views, 0);
  int32_t count = 0;
  double last_rise = 0;
  bool rising = false;
  for (const Event& event : events) {
    if (!event.ends) {
      if (open[event.view]++ == 0) ++count, rising = true, last_rise = event.at;
    } else if (--open[event.view] == 0) {
      if (rising && count >= min_views) agreed->push_back({(last_rise + event.at) / 2, count});
      --count, rising = false;
    }
  }
  std::stable_sort(agreed->begin(), agreed->end(),
                   [](const auto& a, const auto& b) { return a.num_views > b.num_views; });
}

// The inverse distance at which a ray of direction `ray` (length 1) from `origin` projects nearest
// to a pixel of a view, and the displacement in pixels per unit of inverse distance. False behind
// the view or the origin.
inline bool MeetRay(const Vec3& origin, const Vec3& ray, const PinholeView& view, Vec2 pixel,
                    double* inverse_distance, double* px_per_inverse) {
  const Vec3 a = view.FromWorld(origin), b = view.Rotate(ray);
  const double f = view.focal_px;
  const double ax = f * a.x - pixel.x * a.z, bx = pixel.x * b.z - f * b.x;
  const double ay = f * a.y - pixel.y * a.z, by = pixel.y * b.z - f * b.y;
  const double norm = ax * ax + ay * ay;
  if (!(norm > 0)) return false;
  *inverse_distance = (ax * bx + ay * by) / norm;
  const double z = a.z * *inverse_distance + b.z;
  if (!(*inverse_distance > 0) || !(z > 0)) return false;
  *px_per_inverse = f * std::hypot(a.x * b.z - b.x * a.z, a.y * b.z - b.y * a.z) / (z * z);
  return true;
}

}  // namespace colmap_edges
