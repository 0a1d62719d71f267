// Views as gray pictures without distortion, and windows of one compared with another.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/geometry.h"
#include "common/vectors.h"

namespace colmap_edges {

struct PatchView {
  PinholeView pose;  // focal length in pixels of the picture
  Vec2 principal;    // the corner of the picture is (0, 0)
  int32_t width = 0, height = 0;
  const uint8_t* gray = nullptr;

  // Direction through the middle of a pixel, in the coordinates of the view, of depth 1.
  Vec3 LocalRay(double x, double y) const {
    return {(x + 0.5 - principal.x) / pose.focal_px, (y + 0.5 - principal.y) / pose.focal_px, 1};
  }
  // Pixel (its middle is a whole number) and depth of a world point; false behind the view.
  bool Project(const Vec3& point, Vec2* pixel, double* depth) const {
    const Vec3 p = pose.FromWorld(point);
    if (!(p.z > 0)) return false;
    *depth = p.z;
    *pixel = {pose.focal_px * p.x / p.z + principal.x - 0.5,
              pose.focal_px * p.y / p.z + principal.y - 0.5};
    return true;
  }
};

// A plane through the place that a pixel sees: inverse depth is linear in pixels.
struct PatchPlane {
  double inverse = 0;               // inverse depth at the pixel
  double slope_x = 0, slope_y = 0;  // its change per pixel

  double At(double dx, double dy) const { return inverse + slope_x * dx + slope_y * dy; }
  PatchPlane Moved(double dx, double dy) const { return {At(dx, dy), slope_x, slope_y}; }
};

// The normal of a patch at pixel (x, y), in the coordinates of the view; its product with places on
// the plane is 1.
inline Vec3 LocalNormal(const PatchView& view, double x, double y, const PatchPlane& plane) {
  const double f = view.pose.focal_px;
  const Vec3 ray = view.LocalRay(x, y);
  return {f * plane.slope_x, f * plane.slope_y,
          plane.inverse - f * (plane.slope_x * ray.x + plane.slope_y * ray.y)};
}

// Cosine of the angle between the normal of a patch and the ray to it.
inline double CosineOf(const PatchView& view, double x, double y, const PatchPlane& plane) {
  return plane.inverse / (Norm(LocalNormal(view, x, y, plane)) * Norm(view.LocalRay(x, y)));
}

// From pixels of a view to those of another: p = turn (x, y, 1) + shift * inverse depth, the pixel
// is (p.x, p.y) / p.z.
struct RelativeView {
  Mat3 turn;
  Vec3 shift;

  RelativeView(const PatchView& view, const PatchView& other) {
    const Mat3 rotation = MultiplyByTransposed(other.pose.R, view.pose.R);
    const Vec3 moved = other.pose.FromWorld(view.pose.center);
    const double f = view.pose.focal_px;
    const auto pixels = [&](const Vec3& v) {
      return Vec3{other.pose.focal_px * v.x + (other.principal.x - 0.5) * v.z,
                  other.pose.focal_px * v.y + (other.principal.y - 0.5) * v.z, v.z};
    };
    const Vec3 right = pixels({rotation[0] / f, rotation[3] / f, rotation[6] / f});
    const Vec3 down = pixels({rotation[1] / f, rotation[4] / f, rotation[7] / f});
    const Vec3 corner = pixels(Multiply(rotation, view.LocalRay(0, 0)));
    turn = {right.x, down.x, corner.x, right.y, down.y, corner.y, right.z, down.z, corner.z};
    shift = pixels(moved);
  }
  Vec3 At(double x, double y, double inverse) const {
    return Multiply(turn, {x, y, 1}) + inverse * shift;
  }
  // Movement in the other view per unit of inverse depth.
  Vec2 Parallax(double x, double y, double inverse) const {
    const Vec3 p = At(x, y, inverse);
    return {(shift.x - p.x / p.z * shift.z) / p.z, (shift.y - p.y / p.z * shift.z) / p.z};
  }
};

constexpr int kWindowRadius = 3;  // pixels
constexpr int kWindowSide = 2 * kWindowRadius + 1, kWindowCount = kWindowSide * kWindowSide;
// Those of a chessboard's fields of one colour come first, which suffice to compare planes.
constexpr int kHalfCount = (kWindowCount + 1) / 2;

// Pixels of a window, from its middle.
struct WindowPixels {
  std::array<float, kWindowCount> dx, dy;

  constexpr WindowPixels() : dx(), dy() {
    int at = 0;
    for (int half = 0; half < 2; ++half)
      for (int y = -kWindowRadius; y <= kWindowRadius; ++y)
        for (int x = -kWindowRadius; x <= kWindowRadius; ++x)
          if ((x + y + 2 * kWindowRadius) % 2 == half) dx[at] = float(x), dy[at++] = float(y);
  }
};
inline constexpr WindowPixels kPixels;

// The places in another view of the first pixels of a window.
template <int kCount>
struct WindowPlaces {
  std::array<float, kCount> x, y, scale;

  // False if the other view does not see all of them.
  bool Set(const RelativeView& relative, int px, int py, const PatchPlane& plane,
           const PatchView& other) {
    const Vec3 middle = relative.At(px, py, plane.inverse);
    const Mat3& turn = relative.turn;
    const Vec3 right = Vec3{turn[0], turn[3], turn[6]} + plane.slope_x * relative.shift;
    const Vec3 down = Vec3{turn[1], turn[4], turn[7]} + plane.slope_y * relative.shift;
    const float m[3] = {float(middle.x), float(middle.y), float(middle.z)};
    const float r[3] = {float(right.x), float(right.y), float(right.z)};
    const float d[3] = {float(down.x), float(down.y), float(down.z)};
    for (int i = 0; i < kCount; ++i) {
      scale[i] = 1 / (m[2] + kPixels.dx[i] * r[2] + kPixels.dy[i] * d[2]);
      x[i] = (m[0] + kPixels.dx[i] * r[0] + kPixels.dy[i] * d[0]) * scale[i];
      y[i] = (m[1] + kPixels.dx[i] * r[1] + kPixels.dy[i] * d[1]) * scale[i];
    }
    const float last_x = float(other.width - 1), last_y = float(other.height - 1);
    int outside = 0;
    for (int i = 0; i < kCount; ++i)
      outside |=
          !(scale[i] > 0) | !(x[i] >= 0) | !(y[i] >= 0) | !(x[i] < last_x) | !(y[i] < last_y);
    return outside == 0;
  }
};

// The sum of the values of a window or of its half, in lanes: one after the other they would wait
// for each other.
template <size_t kCount, typename Value>
float SumOver(const Value& value) {
  static_assert(kCount == kHalfCount || kCount == kWindowCount);
  std::array<float, 12> lanes;
  if constexpr (kCount == kHalfCount)
    for (int i = 0; i < 12; ++i) lanes[i] = value(i) + value(i + 12);
  else
    for (int i = 0; i < 12; ++i)
      lanes[i] = (value(i) + value(i + 12)) + (value(i + 24) + value(i + 36));
  for (int i = 0; i < 4; ++i) lanes[i] += lanes[i + 4] + lanes[i + 8];
  return (lanes[0] + lanes[1]) + (lanes[2] + lanes[3]) + value(kCount - 1);
}
template <size_t kCount>
float SumOf(const std::array<float, kCount>& values) {
  return SumOver<kCount>([&](int i) { return values[i]; });
}
template <size_t kCount>
float ProductOf(const std::array<float, kCount>& a, const std::array<float, kCount>& b) {
  return SumOver<kCount>([&](int i) { return a[i] * b[i]; });
}

// Gray between the middles of four pixels of a picture, and its change to the right and downwards,
// at the places of a window. One thing after the other for all places, which compilers turn into
// vectors.
template <int kCount>
struct WindowGray {
  std::array<float, kCount> gray, right, down;

  WindowGray(const PatchView& view, const WindowPlaces<kCount>& at) {
    std::array<int32_t, kCount> places, corners;
    for (int i = 0; i < kCount; ++i) places[i] = int32_t(at.y[i]) * view.width + int32_t(at.x[i]);
    for (int i = 0; i < kCount; ++i) {
      const uint8_t* above = view.gray + places[i];
      const uint8_t* below = above + view.width;
      corners[i] = int32_t(above[0] | above[1] << 8 | uint32_t(below[0] | below[1] << 8) << 16);
    }
    for (int i = 0; i < kCount; ++i) {
      const float s = at.x[i] - float(int32_t(at.x[i])), t = at.y[i] - float(int32_t(at.y[i]));
      const float a = float(corners[i] & 255), b = float(corners[i] >> 8 & 255),
                  c = float(corners[i] >> 16 & 255), d = float(corners[i] >> 24 & 255);
      const float upper = a + s * (b - a), lower = c + s * (d - c);
      gray[i] = upper + t * (lower - upper);
      right[i] = (1 - t) * (b - a) + t * (d - c);
      down[i] = lower - upper;
    }
  }
};

// The gray of a window of a view, less the means of the first pixels and of all.
struct Window {
  std::array<float, kHalfCount> half;
  std::array<float, kWindowCount> gray;
  float half_squares = 0, squares = 0;  // sums of squares

  Window(const PatchView& view, int px, int py) {
    const uint8_t* middle = view.gray + int64_t(py) * view.width + px;
    for (int i = 0; i < kWindowCount; ++i)
      gray[i] = middle[int64_t(kPixels.dy[i]) * view.width + int64_t(kPixels.dx[i])];
    std::copy(gray.begin(), gray.begin() + kHalfCount, half.begin());
    half_squares = Center(half), squares = Center(gray);
  }

  // Correlation with what another view shows at these places, from -1 to 1; `flat`: variance of
  // gray that does not vary.
  template <int kCount>
  float Correlation(const WindowPlaces<kCount>& at, const PatchView& other, float flat) const {
    const float own_squares = kCount == kHalfCount ? half_squares : squares;
    const std::array<float, kCount>& own = Own<kCount>();
    const std::array<float, kCount> theirs = WindowGray<kCount>(other, at).gray;
    const float sum = SumOf(theirs), sum_squares = ProductOf(theirs, theirs);
    const float products = ProductOf(own, theirs);
    const float their_squares = sum_squares - sum * sum / kCount;
    if (!(their_squares > flat * kCount) || !(own_squares > flat * kCount)) return -1;
    return products / std::sqrt(own_squares * their_squares);
  }

 private:
  template <int kCount>
  const std::array<float, kCount>& Own() const {
    if constexpr (kCount == kHalfCount)
      return half;
    else
      return gray;
  }
  // Takes the mean from values; returns the sum of the squares of what is left.
  template <size_t kCount>
  static float Center(std::array<float, kCount>& values) {
    const float mean = SumOf(values) / kCount;
    for (float& value : values) value -= mean;
    return ProductOf(values, values);
  }
};

}  // namespace colmap_edges
