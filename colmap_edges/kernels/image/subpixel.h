// Sub-pixel positions of edge pixels: maxima of the derivative along the gradient.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

#include "common/vectors.h"

namespace colmap_edges {

// Bilinear interpolation at a position, the first pixel being centred at (0, 0): indices of the
// surrounding pixels in a row-major image, and fractions. Positions outside are clamped.
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

  // Interpolated value of one channel of an image.
  template <typename Value>
  double In(const Value* data, int channels = 1) const {
    const double top = data[top_left * channels] * (1 - fx) + data[top_right * channels] * fx;
    const double bottom =
        data[bottom_left * channels] * (1 - fx) + data[bottom_right * channels] * fx;
    return top * (1 - fy) + bottom * fy;
  }
};

// A row-major image; coordinates outside are clamped.
struct Image {
  const float* data;
  int64_t width, height;

  // Sobel's gradient at the pixel nearest to a point.
  Vec2 Gradient(const Vec2& point) const {
    const int64_t x = std::clamp<int64_t>(std::llround(point.x), 0, width - 1);
    const int64_t y = std::clamp<int64_t>(std::llround(point.y), 0, height - 1);
    const int64_t left = std::max<int64_t>(x - 1, 0), right = std::min(x + 1, width - 1);
    const float* above = data + std::max<int64_t>(y - 1, 0) * width;
    const float* row = data + y * width;
    const float* below = data + std::min(y + 1, height - 1) * width;
    const double falling = below[right] - above[left], rising = above[right] - below[left];
    return {2 * (row[right] - row[left]) + rising + falling,
            2 * (below[x] - above[x]) + falling - rising};
  }

  double At(const Vec2& point) const { return PixelCell(width, height, point.x, point.y).In(data); }
};

// Moves each pixel along its gradient, by at most 1 px, to the maximum of the parabola through the
// differences over 2 px at -1, 0 and 1 px. Writes the points and the unit gradient directions.
inline void RefineSubpixel(const Image& image, const double* pixels, int64_t num_pixels,
                           double* points, double* normals) {
  for (int64_t i = 0; i < num_pixels; ++i) {
    const Vec2 pixel = {pixels[2 * i], pixels[2 * i + 1]};
    Vec2 n = image.Gradient(pixel);
    const double norm = Norm(n);
    double shift = 0;
    if (norm > 0) {
      n = {n.x / norm, n.y / norm};
      double across[5];
      for (int k = 0; k < 5; ++k) across[k] = image.At(pixel + double(k - 2) * n);
      const double before = across[2] - across[0], after = across[4] - across[2];
      const double curvature = before - 2 * (across[3] - across[1]) + after;
      if (curvature < 0) shift = std::clamp(0.5 * (before - after) / curvature, -1.0, 1.0);
    }
    points[2 * i] = pixel.x + shift * n.x, points[2 * i + 1] = pixel.y + shift * n.y;
    normals[2 * i] = n.x, normals[2 * i + 1] = n.y;
  }
}

}  // namespace colmap_edges
