// Blur displaces the two edges of a thin bar outwards if they are within a few standard deviations
// of each other. Their true positions follow from the observed distance and the ratio of slopes.
// (Neighbouring edges of equal polarity also displace each other, but cannot be distinguished from
// shading.)
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "image/subpixel.h"

namespace colmap_edges {

// Displacement of a rising edge by a falling one. The derivative of the image across both is the
// difference of two Gaussians at the edges, scaled by their contrasts. Lengths are in standard
// deviations of the blur.
class DisplacementTable {
 public:
  static constexpr double kMost =
      0.6;  // maximum; the width of bars thinner than the blur is unknown

  DisplacementTable() {
    for (int i = 0; i < kSeparations; ++i) {
      for (int j = 0; j < kShares; ++j) at_[i][j] = Solve(kFirst + i * kStep, j * kShareStep);
    }
  }

  // Displacement of an edge away from another one observed at a distance > 0, whose slope is
  // `ratio` > 0 times as large.
  double operator()(double separation, double ratio) const {
    const double x = std::clamp((separation - kFirst) / kStep, 0.0, kSeparations - 1.0);
    const double y = std::clamp(ratio / (1 + ratio) / kShareStep, 0.0, kShares - 1.0);
    const int i = std::min(int(x), kSeparations - 2), j = std::min(int(y), kShares - 2);
    const double u = x - i, v = y - j;
    return (1 - u) * ((1 - v) * at_[i][j] + v * at_[i][j + 1]) +
           u * ((1 - v) * at_[i + 1][j] + v * at_[i + 1][j + 1]);
  }

 private:
  static constexpr int kSeparations = 51, kShares = 20, kSolverSteps = 100;
  static constexpr double kFirst = 1, kStep = 0.1, kShareStep = 0.05, kDamping = 0.3;

  // For two edges observed at 0 and `separation`, `share` being the second one's part of the sum of
  // slopes: alternates between contrasts given the positions and positions given the contrasts.
  static double Solve(double separation, double share) {
    const auto gaussian = [](double x) { return std::exp(-0.5 * x * x); };
    const double rise = 1 - share, fall = share;
    double moved = 0, moved2 = 0;  // displacements away from each other
    for (int step = 0; step < kSolverSteps; ++step) {
      const double own = gaussian(moved), own2 = gaussian(moved2);
      // Contribution of each Gaussian at the other edge.
      const double at_second = separation - moved, at_first = separation - moved2;
      const double of_first = gaussian(at_second), of_second = gaussian(at_first);
      const double determinant = std::max(own * own2 - of_first * of_second, 1e-6);
      const double strength = (rise * own2 + fall * of_second) / determinant;
      const double strength2 = (fall * own + rise * of_first) / determinant;
      // At the observed maximum, the derivatives of both Gaussians cancel.
      const double target = strength2 * at_first * of_second / (strength * own);
      const double target2 = strength * at_second * of_first / (strength2 * own2 + 1e-300);
      moved += kDamping * (std::min(target, kMost) - moved);
      moved2 += kDamping * (std::min(target2, kMost) - moved2);
    }
    return moved;
  }

  std::array<std::array<double, kShares>, kSeparations> at_;
};

// Moves edge points along their normals from the observed to the true positions where falling edges
// are near. `blur` is the total standard deviation of the blur in pixels.
inline void UndoDisplacement(const Image& image, double blur, const double* points,
                             const double* normals, int64_t num_points, double* moved) {
  constexpr int kReach = 6;            // search range in pixels on both sides
  constexpr double kLeastRatio = 0.2;  // weaker edges are noise or have little effect
  // Interpolation adds blur, as do differences over two pixels.
  const double variance = blur * blur + 1.0 / 6 + 4.0 / 12, sigma = std::sqrt(variance);
  static const DisplacementTable table;
  std::array<double, kReach> nearness;
  for (int k = 0; k < kReach; ++k) nearness[k] = std::exp(-0.25 * k * k / variance);
  for (int64_t i = 0; i < num_points; ++i) {
    const Vec2 point = {points[2 * i], points[2 * i + 1]};
    const Vec2 normal = {normals[2 * i], normals[2 * i + 1]};
    std::array<double, 2 * kReach + 3> values;
    for (int k = 0; k < int(values.size()); ++k) {
      values[k] = image.At(point + double(k - kReach - 1) * normal);
    }
    std::array<double, 2 * kReach + 1> slopes;
    for (int k = 0; k < int(slopes.size()); ++k) slopes[k] = values[k + 2] - values[k];
    const double own = slopes[kReach];
    double shift = 0;
    for (const int side : {-1, 1}) {
      const auto fall = [&](int k) { return -slopes[kReach + side * k]; };
      int nearest = 0;
      double best = 0;
      for (int k = 2; k < kReach; ++k) {
        if (fall(k) < kLeastRatio * own || fall(k) < fall(k - 1) || fall(k) <= fall(k + 1))
          continue;
        if (fall(k) * nearness[k] > best) best = fall(k) * nearness[k], nearest = k;
      }
      if (nearest == 0 || !(own > 0)) continue;
      const double before = fall(nearest - 1), after = fall(nearest + 1);
      const double beyond = 0.5 * (before - after) / (before - 2 * fall(nearest) + after);
      shift += side * table((nearest + beyond) / sigma, fall(nearest) / own);
    }
    moved[2 * i] = point.x + sigma * shift * normal.x;
    moved[2 * i + 1] = point.y + sigma * shift * normal.y;
  }
}

}  // namespace colmap_edges
