// Sub-pixel positions of edge pixels: the gradient maximum along the gradient direction.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace colmap_edges {

// An image, row major, channels of a pixel side by side, first pixel centred at (0, 0).
template <typename Value, int kChannels = 1>
struct ImageView {
  const Value* data;
  int64_t height, width;

  // Bilinear value; positions outside are clamped to the border.
  double At(double x, double y, int channel = 0) const {
    x = std::clamp(x, 0.0, double(width - 1));
    y = std::clamp(y, 0.0, double(height - 1));
    const int64_t x0 = std::min<int64_t>(int64_t(x), std::max<int64_t>(width - 2, 0));
    const int64_t y0 = std::min<int64_t>(int64_t(y), std::max<int64_t>(height - 2, 0));
    const int64_t x1 = std::min(x0 + 1, width - 1), y1 = std::min(y0 + 1, height - 1);
    const double fx = x - x0, fy = y - y0;
    const auto value = [&](int64_t column, int64_t row) {
      return data[(row * width + column) * kChannels + channel];
    };
    const double top = value(x0, y0) * (1 - fx) + value(x1, y0) * fx;
    const double bottom = value(x0, y1) * (1 - fx) + value(x1, y1) * fx;
    return top * (1 - fy) + bottom * fy;
  }
};

// Moves each pixel to the maximum of a parabola through the gradient along its direction at -1, 0
// and 1 px; at most 1 px. Writes the points and the unit gradient directions.
template <typename Value>
void RefineSubpixel(const ImageView<Value>& gradient_x, const ImageView<Value>& gradient_y,
                    const double* pixels, int64_t num_pixels, double* points, double* normals) {
  const auto magnitude = [&](double x, double y, double nx, double ny) {
    return std::abs(gradient_x.At(x, y) * nx + gradient_y.At(x, y) * ny);
  };
  for (int64_t i = 0; i < num_pixels; ++i) {
    const double x = pixels[2 * i], y = pixels[2 * i + 1];
    double nx = gradient_x.At(x, y), ny = gradient_y.At(x, y);
    const double norm = std::hypot(nx, ny);
    double shift = 0;
    if (norm > 0) {
      nx /= norm, ny /= norm;
      const double before = magnitude(x - nx, y - ny, nx, ny);
      const double after = magnitude(x + nx, y + ny, nx, ny);
      const double curvature = before - 2 * norm + after;
      if (curvature < 0) shift = std::clamp(0.5 * (before - after) / curvature, -1.0, 1.0);
    }
    points[2 * i] = x + shift * nx, points[2 * i + 1] = y + shift * ny;
    normals[2 * i] = nx, normals[2 * i + 1] = ny;
  }
}

}  // namespace colmap_edges
