// Candidate correspondences of edge points: intersections of their epipolar lines with the edge
// graphs of other views (paper: PEPC generation).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/geometry.h"
#include "paper/places.h"

namespace colmap_edges {

// A sphere around an SfM point that bounds the search, and the views that observe the point.
struct SearchSphere {
  Vec3 center;
  double radius;
  const int32_t* views;
  int64_t num_views;
};

// Sorts places by view and along the chains, without duplicates.
inline void SortPlaces(std::vector<Place>* places) {
  std::sort(places->begin(), places->end(), [](const Place& a, const Place& b) {
    return a.view != b.view ? a.view < b.view : a.position < b.position;
  });
  const auto same = [](const Place& a, const Place& b) {
    return a.view == b.view && a.position == b.position;
  };
  places->erase(std::unique(places->begin(), places->end(), same), places->end());
}

// Intersections inside the projected sphere, approximated by a circle of radius * focal / depth.
inline void CandidatesInSphere(const Views& views, const Place& start, const SearchSphere& sphere,
                               std::vector<Place>* candidates) {
  const PinholeView& from = views[start.view]->pose();
  const Vec2 pixel = views[start.view]->At(start.position);
  for (int64_t k = 0; k < sphere.num_views; ++k) {
    const int32_t to = sphere.views[k];
    const EdgeIndex& chains = *views[to];
    Line2D line;
    Vec2 middle;
    if (to == start.view || !chains.pose().Project(sphere.center, &middle) ||
        !EpipolarLine(from, chains.pose(), pixel, &line)) {
      continue;
    }
    const double depth = chains.pose().FromWorld(sphere.center).z;
    const double radius = sphere.radius * chains.focal() / depth;
    const double away = line.SignedDistance(middle), longest = chains.longest_segment();
    if (std::abs(away) > radius) continue;
    chains.VisitAlong(
        line, longest + 1e-6, middle, radius + longest, [&](int64_t i, double dx, double dy) {
          if (std::abs(line.a * dx + line.b * dy + away) > longest + 1e-6) return;
          const int64_t next = chains.Next(i);
          double t;
          if (next < 0 || !line.Crosses(chains.point(i), chains.point(next), &t)) return;
          const Vec2 at = chains.point(i) + t * (chains.point(next) - chains.point(i));
          if (Norm(at - middle) <= radius) candidates->push_back({to, chains.Position(i, t)});
        });
  }
  SortPlaces(candidates);
}

// Bounding box in `to` of the epipolar segment of depths [near, far] of a pixel in `from`;
// unbounded if an end is behind `to`.
inline Box2D EpipolarBox(const PinholeView& from, const PinholeView& to, Vec2 pixel, double near,
                         double far) {
  const Vec3 direction = from.RotateBack({pixel.x / from.focal_px, pixel.y / from.focal_px, 1});
  Vec2 a, b;
  if (!std::isfinite(far) || !to.Project(from.center + near * direction, &a) ||
      !to.Project(from.center + far * direction, &b)) {
    return {{-INFINITY, -INFINITY}, {INFINITY, INFINITY}};
  }
  const Vec2 margin = {1, 1};
  Box2D box = {a, a};
  box.Include(b);
  return {box.min - margin, box.max + margin};
}

// A run of segments of a polyline of a PEC, and their bounding box.
struct PecRun {
  int32_t view;
  int32_t first, count;  // segments
  Box2D box;
};

// Appends the runs of one polyline. Contiguous, since a search tests all runs of a PEC.
inline void AddRuns(const Views& views, int32_t view, int32_t polyline, std::vector<PecRun>* runs) {
  constexpr int64_t kRun = 16;  // segments; only speed depends on it
  const EdgeIndex& chains = *views[view];
  const int64_t last = chains.last(polyline), end = chains.closed(polyline) ? last + 1 : last;
  for (int64_t first = chains.first(polyline); first < end; first += kRun) {
    const int64_t count = std::min(kRun, end - first);
    Box2D box = {chains.point(first), chains.point(first)};
    for (int64_t i = first; i < first + count; ++i) box.Include(chains.point(chains.Next(i)));
    runs->push_back({view, int32_t(first), int32_t(count), box});
  }
}

// Intersections with the polylines of a PEC in other views, by view and ascending. depth_ranges:
// (near, far) of each view.
inline void CandidatesInPec(const Views& views, const Place& start, const PecRun* runs,
                            int64_t num_runs, const double* depth_ranges,
                            std::vector<Place>* candidates) {
  const PinholeView& from = views[start.view]->pose();
  const Vec2 pixel = views[start.view]->At(start.position);
  const double* depths = depth_ranges + 2 * start.view;
  int32_t to = -1;
  bool usable = false;
  Line2D line{};
  Box2D box;
  for (const PecRun* run = runs; run < runs + num_runs; ++run) {
    if (run->view != to) {
      to = run->view;
      const PinholeView& other = views[to]->pose();
      usable = to != start.view && EpipolarLine(from, other, pixel, &line);
      if (usable) box = EpipolarBox(from, other, pixel, depths[0], depths[1]);
    }
    if (!usable || !run->box.Meets(box) || !run->box.Meets(line)) continue;
    const EdgeIndex& chains = *views[to];
    for (int64_t i = run->first; i < run->first + run->count; ++i) {
      const Vec2 a = chains.point(i), b = chains.point(chains.Next(i));
      double t;
      if (line.Crosses(a, b, &t) && box.Contains(a + t * (b - a))) {
        candidates->push_back({to, chains.Position(i, t)});
      }
    }
  }
}

}  // namespace colmap_edges
