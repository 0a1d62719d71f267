// Candidate correspondences of edge points: where their epipolar lines cross the edge graphs of
// other views (paper: PEPC generation).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "edge_field.h"
#include "geometry.h"

namespace colmap_edges {

// A sphere around a scene point that bounds the search, and the views that see the point.
struct SearchSphere {
  Vec3 center;
  double radius;
  const int32_t* views;
  int64_t num_views;
};

// Sorts places along the chains, and so by view, each once.
inline void SortByPlace(std::vector<ChainPosition>* places) {
  std::sort(places->begin(), places->end(), [](const ChainPosition& a, const ChainPosition& b) {
    return a.segment != b.segment ? a.segment < b.segment : a.fraction < b.fraction;
  });
  const auto same = [](const ChainPosition& a, const ChainPosition& b) {
    return a.segment == b.segment && a.fraction == b.fraction;
  };
  places->erase(std::unique(places->begin(), places->end(), same), places->end());
}

// Crossings inside the projected sphere, approximated by a circle of radius * focal / depth.
inline void CandidatesInSphere(const EdgeField& field, ChainPosition start,
                               const SearchSphere& sphere, std::vector<ChainPosition>* candidates) {
  const auto& views = field.views();
  const int32_t from = field.ViewOf(start);
  const Vec2 pixel = field.At(start);
  std::vector<ChainPosition> crossings;
  for (int64_t i = 0; i < sphere.num_views; ++i) {
    const int32_t to = sphere.views[i];
    Line2D line;
    Vec2 middle;
    if (to == from || !views[to].Project(sphere.center, &middle) ||
        !EpipolarLine(views[from], views[to], pixel, &line)) {
      continue;
    }
    const double depth = views[to].FromWorld(sphere.center).z;
    const double radius_px = sphere.radius * views[to].focal_px / depth;
    const Vec2 extent = {radius_px, radius_px};
    field.IntersectLine(to, line, {middle - extent, middle + extent}, &crossings);
    for (const ChainPosition& at : crossings) {
      if (Norm(field.At(at) - middle) <= radius_px) candidates->push_back(at);
    }
  }
  SortByPlace(candidates);
}

// The box in `to` that holds the epipolar segment of depths [near, far] of a pixel in `from`;
// unbounded when an end of it is behind `to`.
inline Box2D EpipolarBox(const PinholeView& from, const PinholeView& to, Vec2 pixel, double near,
                         double far) {
  const Vec3 direction = from.RotateBack({pixel.x / from.focal_px, pixel.y / from.focal_px, 1});
  Vec2 a, b;
  if (!std::isfinite(far) || !to.Project(from.center + near * direction, &a) ||
      !to.Project(from.center + far * direction, &b)) {
    return {{-INFINITY, -INFINITY}, {INFINITY, INFINITY}};
  }
  const Vec2 margin = {1, 1};
  return {Vec2{std::min(a.x, b.x), std::min(a.y, b.y)} - margin,
          Vec2{std::max(a.x, b.x), std::max(a.y, b.y)} + margin};
}

// Crossings with the polylines of a PEC (ascending) in the other views. depth_ranges holds (near,
// far) of each view.
inline void CandidatesInPec(const EdgeField& field, ChainPosition start, const int32_t* polylines,
                            int64_t num_polylines, const double* depth_ranges,
                            std::vector<ChainPosition>* candidates) {
  const auto& views = field.views();
  const int32_t from = field.ViewOf(start);
  const Vec2 pixel = field.At(start);
  int32_t to = -1;
  bool usable = false;
  Line2D line{};
  Box2D box;
  for (int64_t i = 0; i < num_polylines; ++i) {
    const int32_t view = field.ViewOfPolyline(polylines[i]);
    if (view == from) continue;
    if (view != to) {
      to = view;
      usable = EpipolarLine(views[from], views[to], pixel, &line);
      box = EpipolarBox(views[from], views[to], pixel, depth_ranges[2 * from],
                        depth_ranges[2 * from + 1]);
    }
    if (usable) field.IntersectPolyline(polylines[i], line, box, candidates);
  }
}

}  // namespace colmap_edges
