// Points of one image that lie behind others around them.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "parallel.h"
#include "vectors.h"

namespace colmap_edges {

// A point where an image shows it: its pixel, its depth and by how much that may be wrong.
struct SeenPoint {
  Vec2 pixel;
  double depth, margin;
  int64_t curve;  // points of one curve say nothing of each other
};

struct Crowd {
  std::vector<int32_t> nearer, agreeing;  // of the points around each
};

// The points of an image by square cells, those of a row of cells side by side.
class PointCells {
 public:
  struct Range {
    int64_t begin, end;  // of the points in order
  };

  // No pixel may be farther than 1e9 cells away.
  PointCells(const std::vector<SeenPoint>& points, double size) : order_(points.size()) {
    std::vector<std::pair<int64_t, int64_t>> sorted(points.size());
    for (size_t i = 0; i < points.size(); ++i) {
      const double row = std::floor(points[i].pixel.y / size);
      sorted[i] = {int64_t(row) * kRow + int64_t(std::floor(points[i].pixel.x / size)), int64_t(i)};
    }
    std::sort(sorted.begin(), sorted.end());
    points_.reserve(points.size());
    for (size_t k = 0; k < sorted.size(); ++k) {
      order_[k] = sorted[k].second;
      points_.push_back(points[order_[k]]);
      if (cells_.empty() || cells_.back() != sorted[k].first) {
        cells_.push_back(sorted[k].first), starts_.push_back(int64_t(k));
      }
    }
    starts_.push_back(int64_t(points.size()));
  }

  int64_t num_cells() const { return int64_t(cells_.size()); }
  Range InCell(int64_t cell) const { return {starts_[cell], starts_[cell + 1]}; }

  // The points in a cell and the eight around it, a row each.
  std::array<Range, 3> Around(int64_t cell) const {
    std::array<Range, 3> ranges;
    for (int64_t k = 0; k < 3; ++k) {
      const int64_t beside = cells_[cell] + (k - 1) * kRow;
      ranges[k] = {Start(beside - 1), Start(beside + 2)};
    }
    return ranges;
  }

  const SeenPoint& point(int64_t k) const { return points_[k]; }  // in order
  int64_t index(int64_t k) const { return order_[k]; }            // as they were given

 private:
  static constexpr int64_t kRow = int64_t(1) << 32;  // cells by row, in a row by column

  // The first point of this cell or those after it.
  int64_t Start(int64_t cell) const {
    return starts_[std::lower_bound(cells_.begin(), cells_.end(), cell) - cells_.begin()];
  }

  std::vector<SeenPoint> points_;
  std::vector<int64_t> order_;
  std::vector<int64_t> cells_, starts_;  // cells that hold any points, ascending, and their first
};

// How many points of other curves within `radius_px` of each are nearer to the camera than one
// surface allows, and how many are as far. On one surface depth changes by at most `slope` times
// itself a pixel.
inline Crowd CountAround(const std::vector<SeenPoint>& points, double radius_px, double slope,
                         int num_threads) {
  const PointCells cells(points, radius_px);
  Crowd crowd{std::vector<int32_t>(points.size()), std::vector<int32_t>(points.size())};
  ParallelBlocks(cells.num_cells(), num_threads, 64, [&](int64_t cell) {
    const auto around = cells.Around(cell);
    for (int64_t k = cells.InCell(cell).begin; k < cells.InCell(cell).end; ++k) {
      const SeenPoint& own = cells.point(k);
      int32_t nearer = 0, agreeing = 0;
      for (const PointCells::Range& range : around) {
        for (int64_t j = range.begin; j < range.end; ++j) {
          const SeenPoint& other = cells.point(j);
          const double distance = Norm(other.pixel - own.pixel);
          const double gap = own.depth - other.depth;
          const double limit = slope * (distance + 1) * own.depth + own.margin + other.margin;
          // No branch could be guessed.
          const bool counted = (other.curve != own.curve) & (distance <= radius_px);
          nearer += counted & (gap > limit);
          agreeing += counted & (std::abs(gap) <= limit);
        }
      }
      crowd.nearer[cells.index(k)] = nearer, crowd.agreeing[cells.index(k)] = agreeing;
    }
  });
  return crowd;
}

}  // namespace colmap_edges
