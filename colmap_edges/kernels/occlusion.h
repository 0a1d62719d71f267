// Points of one image that lie behind others around them.
#pragma once

#include <algorithm>
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
  PointCells(const std::vector<SeenPoint>& points, double size) : size_(size) {
    for (size_t i = 0; i < points.size(); ++i) {
      cells_.push_back({{Cell(points[i].pixel.y), Cell(points[i].pixel.x)}, int64_t(i)});
    }
    std::sort(cells_.begin(), cells_.end());
  }

  // Calls visit(j) for the points in the cell of x and the eight around it.
  template <typename Visit>
  void VisitNear(const Vec2& x, const Visit& visit) const {
    for (int64_t row = Cell(x.y) - 1; row <= Cell(x.y) + 1; ++row) {
      const Entry first = {{row, Cell(x.x) - 1}, -1};
      auto it = std::lower_bound(cells_.begin(), cells_.end(), first);
      for (; it != cells_.end() && it->first.first == row; ++it) {
        if (it->first.second > Cell(x.x) + 1) break;
        visit(it->second);
      }
    }
  }

 private:
  using Entry = std::pair<std::pair<int64_t, int64_t>, int64_t>;

  int64_t Cell(double coordinate) const { return int64_t(std::floor(coordinate / size_)); }

  double size_;
  std::vector<Entry> cells_;
};

// How many points of other curves within `radius_px` of each are nearer to the camera than one
// surface allows, and how many are as far. On one surface depth changes by at most `slope` times
// itself a pixel.
inline Crowd CountAround(const std::vector<SeenPoint>& points, double radius_px, double slope,
                         int num_threads) {
  const int64_t count = int64_t(points.size());
  const PointCells cells(points, radius_px);
  Crowd crowd{std::vector<int32_t>(count), std::vector<int32_t>(count)};
  ParallelBlocks(count, num_threads, 1024, [&](int64_t i) {
    const SeenPoint& own = points[i];
    cells.VisitNear(own.pixel, [&](int64_t j) {
      const SeenPoint& other = points[j];
      const double distance = Norm(other.pixel - own.pixel);
      if (distance > radius_px || other.curve == own.curve) return;
      const double gap = own.depth - other.depth;
      const double limit = slope * (distance + 1) * own.depth + own.margin + other.margin;
      crowd.nearer[i] += gap > limit;
      crowd.agreeing[i] += std::abs(gap) <= limit;
    });
  });
  return crowd;
}

}  // namespace colmap_edges
