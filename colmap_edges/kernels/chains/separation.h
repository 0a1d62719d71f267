// Observed and projected distance of two parallel edges in a view.
#pragma once

#include <cmath>
#include <cstdint>

#include "chains/association.h"
#include "common/edge_index.h"

namespace colmap_edges {

// Neighbouring points of two edges, (n, 3) each: the first, the vector to the second, and the
// vector to the next point of the first edge.
struct SidePlaces {
  const Vec3 *points, *offsets, *steps;
};

struct Separation {
  double projected, seen;  // pixels across the edge; NaN if unknown
};

// `known` are the positions at which the view observes both points; where negative, the nearest one
// within the parameters' distance is searched.
inline Separation Separate(const EdgeIndex& view, const SidePlaces& places, int64_t i,
                           const double* known, const AssociationParameters& parameters) {
  const auto project = [&](const Vec3& point) {
    Vec2 pixel{NAN, NAN};
    view.pose().Project(point, &pixel);
    return pixel;
  };
  const Vec3 &start = places.points[i], &step = places.steps[i], end = start + places.offsets[i];
  const Vec2 chord = project(start + 0.5 * step) - project(start - 0.5 * step);
  const Vec2 normal = 1 / (Norm(chord) + 1e-300) * Vec2{-chord.y, chord.x};
  const auto position = [&](double observed, const Vec3& point) {
    return observed >= 0 ? observed : Associate(view, point, step, 0, parameters);
  };
  const double first = position(known[0], start), second = position(known[1], end);
  const bool both = first >= 0 && second >= 0;
  return {Dot(project(end) - project(start), normal),
          both ? Dot(view.At(second) - view.At(first), normal) : NAN};
}

}  // namespace colmap_edges
