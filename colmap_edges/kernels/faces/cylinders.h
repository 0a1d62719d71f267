// Pairs of outlines in two views that may be those of one cylinder.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

// Pairs of lines of a view that may be both outlines of a cylinder.
struct OutlinePairs {
  Vec3 center;            // of the view
  double focal_px;        // of the view
  const double* normals;  // (count, 2, 3) unit normals of the lines' planes
  const double* middles;  // (count, 3) unit normals of the planes in the middle
  const double* turns;    // (count, 2) maximum sines of the angles between planes and axis
  const double* rays;     // (count, 2, 2, 3) unit viewing rays of both ends of both lines
  int64_t count;

  Vec3 middle(int64_t i) const { return At(middles + 3 * i); }
  Vec3 ray(int64_t i, int end) const { return At(rays + 12 * i + 3 * end); }
  // Whether both planes of a pair contain a direction of length `size`.
  bool Contain(int64_t i, const Vec3& direction, double size) const {
    for (int64_t side = 2 * i; side < 2 * i + 2; ++side)
      if (!(std::abs(Dot(At(normals + 3 * side), direction)) < turns[side] * size)) return false;
    return true;
  }

 private:
  static Vec3 At(const double* row) { return {row[0], row[1], row[2]}; }
};

// Radii with which a cylinder is touched by a ray, within a slack.
struct Radii {
  double least = 0, most = std::numeric_limits<double>::infinity();

  // Keeps those of a unit ray. `away`: from its start to a point of the axis of unit direction
  // `axis`; `slack`: over the depth of the ray. Returns whether any is left.
  bool Touch(const Vec3& ray, const Vec3& axis, const Vec3& away, double slack) {
    const Vec3 aside = Cross(axis, ray);
    const double square = Dot(aside, aside) + 1e-300;
    const double depth = Dot(ray, away - Dot(away, axis) * axis) / square;
    const double distance = std::abs(Dot(aside, away)) / std::sqrt(square);
    least = std::max(least, distance - slack * depth);
    most = std::min(most, distance + slack * depth);
    return depth > 0 && least <= most;
  }
};

// The pairs of one view and of another in whose middle planes an axis lies that all four planes
// contain, about which a cylinder touches the rays of all lines' ends within `slack_px`.
inline std::vector<int64_t> PairsOfOneRadius(const OutlinePairs& one, const OutlinePairs& other,
                                             double min_sine, double slack_px) {
  std::vector<int64_t> found;
  for (int64_t a = 0; a < one.count; ++a) {
    const Vec3 own = one.middle(a);
    for (int64_t b = 0; b < other.count; ++b) {
      const Vec3 cross = Cross(own, other.middle(b));
      const double sine = Norm(cross);
      if (!(sine > min_sine) || !one.Contain(a, cross, sine) || !other.Contain(b, cross, sine))
        continue;
      // The point of the axis nearest to the first view's centre, from there.
      const Vec3 axis = (1 / sine) * cross, apart = other.center - one.center;
      const Vec3 away = (Dot(other.middle(b), apart) / sine) * Cross(axis, own);
      Radii radii;
      bool touches = true;
      for (int end = 0; end < 4 && touches; ++end) {
        touches = radii.Touch(one.ray(a, end), axis, away, slack_px / one.focal_px) &&
                  radii.Touch(other.ray(b, end), axis, away - apart, slack_px / other.focal_px);
      }
      if (touches) found.insert(found.end(), {a, b});
    }
  }
  return found;
}

}  // namespace colmap_edges
