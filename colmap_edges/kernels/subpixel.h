// Sub-pixel positions of edge pixels: the gradient maximum along the gradient direction.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "vectors.h"

namespace colmap_edges {

// Where a position lies among pixels, the first centred at (0, 0): those around it by their place
// in a row-major image, and how far it is from the first. Outside it is on the border.
struct PixelCell {
  int64_t top_left, top_right, bottom_left, bottom_right;
  double fx, fy;

  PixelCell(int64_t width, int64_t height, double x, double y) {
    x = std::clamp(x, 0.0, double(width - 1));
    y = std::clamp(y, 0.0, double(height - 1));
    const int64_t x0 = std::min<int64_t>(int64_t(x), std::max<int64_t>(width - 2, 0));
    const int64_t y0 = std::min<int64_t>(int64_t(y), std::max<int64_t>(height - 2, 0));
    const int64_t right = x0 + 1 < width, below = y0 + 1 < height ? width : 0;
    top_left = y0 * width + x0, top_right = top_left + right;
    bottom_left = top_left + below, bottom_right = bottom_left + right;
    fx = x - x0, fy = y - y0;
  }

  // Bilinear value of one of an image's channels.
  template <typename Value>
  double In(const Value* data, int channels = 1) const {
    const double top = data[top_left * channels] * (1 - fx) + data[top_right * channels] * fx;
    const double bottom =
        data[bottom_left * channels] * (1 - fx) + data[bottom_right * channels] * fx;
    return top * (1 - fy) + bottom * fy;
  }
};

// The two gradients of an image, row major.
struct Gradients {
  const float *x, *y;
  int64_t width, height;

  Vec2 At(double column, double row) const {
    const PixelCell cell(width, height, column, row);
    return {cell.In(x), cell.In(y)};
  }
};

// Moves each pixel to the maximum of a parabola through the logarithm of the gradient along its
// direction at -1, 0 and 1 px, as across a blurred step the gradient is a Gaussian; at most 1 px.
// Writes the points and the unit gradient directions.
inline void RefineSubpixel(const Gradients& gradients, const double* pixels, int64_t num_pixels,
                           double* points, double* normals) {
  for (int64_t i = 0; i < num_pixels; ++i) {
    const Vec2 pixel = {pixels[2 * i], pixels[2 * i + 1]};
    Vec2 n = gradients.At(pixel.x, pixel.y);
    const auto magnitude = [&](const Vec2& at) {
      return std::abs(Dot(gradients.At(at.x, at.y), n));
    };
    const double norm = std::hypot(n.x, n.y);
    double shift = 0;
    if (norm > 0) {
      n = {n.x / norm, n.y / norm};
      constexpr double kLeast = 1e-3;  // of the gradient; of nothing there is no logarithm
      const double before = std::log(std::max(magnitude(pixel - n) / norm, kLeast));
      const double after = std::log(std::max(magnitude(pixel + n) / norm, kLeast));
      const double curvature = before + after;
      if (curvature < 0) shift = std::clamp(0.5 * (before - after) / curvature, -1.0, 1.0);
    }
    points[2 * i] = pixel.x + shift * n.x, points[2 * i + 1] = pixel.y + shift * n.y;
    normals[2 * i] = n.x, normals[2 * i + 1] = n.y;
  }
}

}  // namespace colmap_edges
