// T junctions of chains of pixels: ends that touch the inside of another chain.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <new>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

// A label for every pixel of an image and of a border of one pixel around it; initially 0. Memory
// allocated as zeros costs nothing where no label is written.
class PixelLabels {
 public:
  PixelLabels(int64_t width, int64_t height)
      : stride_(width + 2),
        rows_(height + 2),
        labels_(static_cast<int32_t*>(std::calloc(stride_ * rows_, sizeof(int32_t))), &std::free) {
    if (!labels_) throw std::bad_alloc();
  }

  // Label of the pixel at a point, or the nearest pixel, offset by (dx, dy) pixels.
  int32_t& At(const Vec2& point, int64_t dx = 0, int64_t dy = 0) {
    const int64_t x = std::clamp(std::floor(point.x) + 1, 0.0, double(stride_ - 1));
    const int64_t y = std::clamp(std::floor(point.y) + 1, 0.0, double(rows_ - 1));
    return labels_.get()[std::clamp<int64_t>(y + dy, 0, rows_ - 1) * stride_ +
                         std::clamp<int64_t>(x + dx, 0, stride_ - 1)];
  }

 private:
  int64_t stride_, rows_;
  std::unique_ptr<int32_t, decltype(&std::free)> labels_;
};

// For both ends of every chain: another chain with an inner point within the 3x3 pixels around the
// end; the last one of several, also of those that share a pixel; -1 for none. `point(i)` is a
// Vec2.
template <typename Point>
std::vector<int32_t> TouchedChains(const Point& point, const std::vector<int64_t>& offsets,
                                   int64_t width, int64_t height) {
  PixelLabels labels(width, height);
  const int64_t count = int64_t(offsets.size()) - 1;
  for (int64_t c = 0; c < count; ++c) {
    for (int64_t i = offsets[c] + 1; i < offsets[c + 1] - 1; ++i) {
      labels.At(point(i)) = int32_t(c + 1);
    }
  }
  std::vector<int32_t> touched(2 * count, -1);
  for (int64_t end = 0; end < 2 * count; ++end) {
    const int64_t own = end / 2;
    if (offsets[own] == offsets[own + 1]) continue;
    const Vec2 tip = point(end % 2 == 0 ? offsets[own] : offsets[own + 1] - 1);
    for (int64_t dy = -1; dy <= 1; ++dy) {
      for (int64_t dx = -1; dx <= 1; ++dx) {
        const int32_t found = labels.At(tip, dx, dy) - 1;
        if (found != own) touched[end] = std::max(touched[end], found);
      }
    }
  }
  return touched;
}

}  // namespace colmap_edges
