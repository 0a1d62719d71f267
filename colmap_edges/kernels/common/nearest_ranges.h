// Ranges of values of the points nearest to given places in an image.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

struct ValueRange {
  double low, high;
};

// Points in the square cells of a grid, each cell's side by side.
class PointGrid {
 public:
  // There must be a point; `cell` is the side of the cells, of which a row or column must have few.
  PointGrid(const Vec2* points, const double* values, int64_t count, double cell) : cell_(cell) {
    Vec2 high = corner_ = points[0];
    for (int64_t i = 1; i < count; ++i) {
      corner_ = {std::min(corner_.x, points[i].x), std::min(corner_.y, points[i].y)};
      high = {std::max(high.x, points[i].x), std::max(high.y, points[i].y)};
    }
    columns_ = int64_t((high.x - corner_.x) / cell) + 1;
    rows_ = int64_t((high.y - corner_.y) / cell) + 1;
    std::vector<int64_t> cells(count);
    starts_.resize(columns_ * rows_ + 1);
    for (int64_t i = 0; i < count; ++i) {
      cells[i] = Place(points[i].y - corner_.y, rows_) * columns_ +
                 Place(points[i].x - corner_.x, columns_);
      ++starts_[cells[i] + 1];
    }
    for (size_t k = 1; k < starts_.size(); ++k) starts_[k] += starts_[k - 1];
    std::vector<int64_t> fill(starts_.begin(), starts_.end() - 1);
    points_.resize(count);
    for (int64_t i = 0; i < count; ++i) points_[fill[cells[i]]++] = {points[i], values[i]};
  }

  // The range of the values of the `num_nearest` points nearest to a place, of all if these are
  // fewer. Cells are searched in square rings around that of the place.
  ValueRange Nearest(const Vec2& place, size_t num_nearest) const {
    const int64_t column = Place(place.x - corner_.x, columns_);
    const int64_t row = Place(place.y - corner_.y, rows_);
    std::vector<std::pair<double, double>> nearest;  // squared distances and values, ascending
    nearest.reserve(num_nearest + 1);
    for (int64_t ring = 0;; ++ring) {
      const int64_t left = column - ring, right = column + ring;
      for (int64_t y = std::max<int64_t>(row - ring, 0); y <= std::min(row + ring, rows_ - 1);
           ++y) {
        const bool whole = y == row - ring || y == row + ring;
        const int64_t step = whole || ring == 0 ? 1 : 2 * ring;
        for (int64_t x = left; x <= right; x += step) {
          if (x >= 0 && x < columns_) Take(y * columns_ + x, place, num_nearest, &nearest);
        }
      }
      const double infinity = std::numeric_limits<double>::infinity();
      const Vec2 from = place - corner_;
      const double searched =
          std::min(std::min(left > 0 ? from.x - left * cell_ : infinity,
                            right < columns_ - 1 ? (right + 1) * cell_ - from.x : infinity),
                   std::min(row - ring > 0 ? from.y - (row - ring) * cell_ : infinity,
                            row + ring < rows_ - 1 ? (row + ring + 1) * cell_ - from.y : infinity));
      if (searched == infinity) break;
      if (nearest.size() == num_nearest && searched > 0 &&
          nearest.back().first <= searched * searched)
        break;
    }
    ValueRange range{nearest[0].second, nearest[0].second};
    for (const auto& [distance, value] : nearest) {
      range = {std::min(range.low, value), std::max(range.high, value)};
    }
    return range;
  }

 private:
  struct Valued {
    Vec2 point;
    double value;
  };

  int64_t Place(double offset, int64_t count) const {
    return int64_t(std::clamp(std::floor(offset / cell_), 0.0, double(count - 1)));
  }

  // Inserts the points of a cell that are among the nearest.
  void Take(int64_t cell, const Vec2& place, size_t num_nearest,
            std::vector<std::pair<double, double>>* nearest) const {
    for (int64_t i = starts_[cell]; i < starts_[cell + 1]; ++i) {
      const Vec2 away = points_[i].point - place;
      const double distance = Dot(away, away);
      if (nearest->size() == num_nearest && distance >= nearest->back().first) continue;
      if (nearest->size() == num_nearest) nearest->pop_back();
      auto at = nearest->end();
      while (at != nearest->begin() && std::prev(at)->first > distance) --at;
      nearest->insert(at, {distance, points_[i].value});
    }
  }

  double cell_;
  Vec2 corner_;
  int64_t columns_, rows_;
  std::vector<int64_t> starts_;
  std::vector<Valued> points_;
};

}  // namespace colmap_edges
