// The gray around a pixel, compared with that in another view by way of a plane.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "faces/grids.h"

namespace colmap_edges {

// The homography from pixels of a view to those of another by way of a plane.
inline Mat3 PlaneHomography(const FaceView& view, const Plane& plane, const FaceView& other) {
  const double f = view.pose.focal_px, g = other.pose.focal_px;
  const Vec3 shift = other.pose.FromWorld(view.pose.center);
  const double distance = plane.Distance(view.pose.center);
  const Mat3 turn = MultiplyByTransposed(other.pose.R, view.pose.R);
  const Vec3 normal = view.pose.Rotate(plane.normal);
  Mat3 h;
  for (int i = 0; i < 3; ++i) {
    double row[3];
    for (int j = 0; j < 3; ++j) row[j] = shift[i] * normal[j] - distance * turn[3 * i + j];
    row[2] -= (row[0] * view.principal.x + row[1] * view.principal.y) / f;
    h[3 * i] = row[0] / f, h[3 * i + 1] = row[1] / f, h[3 * i + 2] = row[2];
  }
  for (int j = 0; j < 3; ++j) {
    h[j] = g * h[j] + other.principal.x * h[6 + j];
    h[3 + j] = g * h[3 + j] + other.principal.y * h[6 + j];
  }
  return h;
}

// Variance of gray, in levels squared, that is no texture.
constexpr double kGrayNoise = 4;
constexpr int kPatchRadius = 4, kPatchStep = 2;  // pixels of the small pictures

// The gray around a pixel, and how much it varies there.
struct Patch {
  static constexpr int kSide = 2 * (kPatchRadius / kPatchStep) + 1;

  std::array<float, kSide * kSide> xs, ys, grays;
  int count = 0;
  float sum = 0, squares = 0;

  Patch(const FaceView& view, Vec2 middle) {
    for (int dy = -kPatchRadius; dy <= kPatchRadius; dy += kPatchStep) {
      for (int dx = -kPatchRadius; dx <= kPatchRadius; dx += kPatchStep) {
        const int64_t x = int64_t(middle.x) + dx, y = int64_t(middle.y) + dy;
        if (x < 0 || y < 0 || x >= view.width() || y >= view.height()) continue;
        const float gray = view.gray[y * view.width() + x];
        xs[count] = float(x) + 0.5f, ys[count] = float(y) + 0.5f, grays[count++] = gray;
        sum += gray, squares += gray * gray;
      }
    }
  }
  float variance() const { return squares / count - sum * sum / count / count; }

  // Share of the variance of both that they have not in common, from 0 to 1, each brightness apart;
  // NaN where the other view does not see all of it.
  float Difference(const Mat3& homography, const FaceView& other, float noise) const {
    std::array<float, 9> h;
    std::copy(homography.begin(), homography.end(), h.begin());
    std::array<float, kSide * kSide> at_x, at_y;
    bool inside = true;
    for (int i = 0; i < count; ++i) {
      const float scale = 1 / (h[6] * xs[i] + h[7] * ys[i] + h[8]);
      at_x[i] = (h[0] * xs[i] + h[1] * ys[i] + h[2]) * scale - 0.5f;
      at_y[i] = (h[3] * xs[i] + h[4] * ys[i] + h[5]) * scale - 0.5f;
    }
    const float right = float(other.width() - 1), bottom = float(other.height() - 1);
    for (int i = 0; i < count; ++i)
      inside &= at_x[i] >= 0 && at_y[i] >= 0 && at_x[i] < right && at_y[i] < bottom;
    if (!inside) return NAN;
    float sum_b = 0, squares_b = 0, products = 0;
    for (int i = 0; i < count; ++i) {
      const int32_t column = int32_t(at_x[i]), row = int32_t(at_y[i]);
      const float s = at_x[i] - column, t = at_y[i] - row;
      const uint8_t* at = other.gray + size_t(row) * other.width() + column;
      const uint8_t* below = at + other.width();
      const float b =
          (1 - t) * ((1 - s) * at[0] + s * at[1]) + t * ((1 - s) * below[0] + s * below[1]);
      sum_b += b, squares_b += b * b, products += grays[i] * b;
    }
    const float aa = variance(), bb = squares_b / count - sum_b * sum_b / count / count;
    const float ab = products / count - sum * sum_b / count / count;
    return std::min(1.f, (aa + bb - 2 * ab) / (aa + bb + 2 * noise));
  }
};

// Mean square of the slope of gray around a pixel in the direction in which it is least, in levels
// per step of the patch: that of an edge is small along the edge.
inline double TextureAround(const FaceView& view, Vec2 middle) {
  const auto gray = [&](int64_t x, int64_t y) { return double(view.gray[y * view.width() + x]); };
  double xx = 0, yy = 0, xy = 0;
  int64_t count = 0;
  for (int dy = -kPatchRadius; dy < kPatchRadius; dy += kPatchStep) {
    for (int dx = -kPatchRadius; dx < kPatchRadius; dx += kPatchStep) {
      const int64_t x = int64_t(middle.x) + dx, y = int64_t(middle.y) + dy;
      const int64_t right = x + kPatchStep, below = y + kPatchStep;
      if (x < 0 || y < 0 || right >= view.width() || below >= view.height()) continue;
      const double across = gray(right, y) - gray(x, y), down = gray(x, below) - gray(x, y);
      xx += across * across, yy += down * down, xy += across * down, ++count;
    }
  }
  const double half = (xx + yy) / 2;
  return (half - std::sqrt(std::max(half * half - xx * yy + xy * xy, 0.0))) / count;
}

}  // namespace colmap_edges
