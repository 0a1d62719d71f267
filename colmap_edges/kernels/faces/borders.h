// What a border between two cells of a view costs, by the picture between them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "faces/grids.h"
#include "faces/max_flow.h"

namespace colmap_edges {

// Pairs of cells side by side: (c, c + 1) and (c, c + columns), row by row.
inline std::vector<NodePair> CellPairs(int32_t columns, int32_t rows) {
  std::vector<NodePair> pairs;
  for (int32_t y = 0; y < rows; ++y) {
    for (int32_t x = 0; x < columns; ++x) {
      const int32_t cell = y * columns + x;
      if (x + 1 < columns) pairs.push_back({cell, cell + 1});
      if (y + 1 < rows) pairs.push_back({cell, cell + columns});
    }
  }
  return pairs;
}

// Largest change of gray per pixel on the way between the centres of two cells.
class Slopes {
 public:
  explicit Slopes(const FaceView& view)
      : view_(view), slopes_(size_t(view.width()) * view.height()) {
    const int64_t width = view.width(), height = view.height();
    for (int64_t y = 1; y + 1 < height; ++y) {
      for (int64_t x = 1; x + 1 < width; ++x) {
        const uint8_t* p = view.gray + y * width + x;
        const double gx = (p[1] - p[-1]) / 4.0 + (p[1 - width] - p[-1 - width]) / 8.0 +
                          (p[1 + width] - p[-1 + width]) / 8.0;
        const double gy = (p[width] - p[-width]) / 4.0 + (p[width - 1] - p[-width - 1]) / 8.0 +
                          (p[width + 1] - p[-width + 1]) / 8.0;
        slopes_[y * width + x] = float(std::sqrt(gx * gx + gy * gy));
      }
    }
  }

  double Between(const NodePair& cells) const {
    const Vec2 a = view_.CellCenter(cells[0]), b = view_.CellCenter(cells[1]);
    double largest = 0;
    for (int step = 0; step <= FaceView::kCellPx; ++step) {
      const double t = double(step) / FaceView::kCellPx;
      const int64_t x = int64_t(a.x + t * (b.x - a.x)), y = int64_t(a.y + t * (b.y - a.y));
      largest = std::max(largest, double(slopes_[y * view_.width() + x]));
    }
    return largest;
  }

 private:
  const FaceView& view_;
  std::vector<float> slopes_;
};

}  // namespace colmap_edges
