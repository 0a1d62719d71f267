// Points of one image that lie behind others near them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "common/parallel.h"
#include "common/vectors.h"

namespace colmap_edges {

// A point in an image: its pixel, its depth and the tolerance of the depth.
struct SeenPoint {
  Vec2 pixel;
  double depth, margin;
  // Points of one curve do not occlude each other; points of no curve (< 0) are not tested.
  int64_t curve;
};

struct Crowd {
  std::vector<int32_t> nearer, agreeing;  // numbers of neighbours of each point
};

// The points of an image in rows of the height of a radius, sorted by steps of a fraction of it
// within a row. Points very far from the first pixel are in the last row or step.
class PointRows {
 public:
  PointRows(const std::vector<SeenPoint>& points, double radius) : order_(points.size()) {
    std::vector<uint16_t> rows(points.size()), steps(points.size());
    for (size_t i = 0; i < points.size(); ++i) {
      rows[i] = Place(points[i].pixel.y / radius);
      steps[i] = Place(points[i].pixel.x / radius * kParts);
      order_[i] = int32_t(i);
    }
    SortBy(steps);
    starts_ = SortBy(rows);
    points_.reserve(points.size()), steps_.reserve(points.size());
    for (const int32_t i : order_) points_.push_back(points[i]), steps_.push_back(steps[i]);
  }

  static constexpr int64_t kNumRows = 1 << 16;

  // Calls use(k, j, end) for each point k of a curve in a row and ranges [j, end) of sorted points
  // that contain all its neighbours within the radius.
  template <typename Use>
  void ForNeighbors(int64_t row, const Use& use) const {
    const int32_t first = starts_[row], last = starts_[row + 1];
    if (first == last) return;
    for (int64_t beside = std::max<int64_t>(row - 1, 0);
         beside <= std::min<int64_t>(row + 1, kNumRows - 1); ++beside) {
      int32_t from = starts_[beside], to = from;
      const int32_t stop = starts_[beside + 1];
      for (int32_t k = first; k < last; ++k) {
        if (points_[k].curve < 0) continue;  // has no counts
        while (from < stop && steps_[from] < steps_[k] - kParts - 1) ++from;
        while (to < stop && steps_[to] <= steps_[k] + kParts + 1) ++to;
        use(k, from, to);
      }
    }
  }

  const SeenPoint& point(int32_t k) const { return points_[k]; }  // in sorted order
  int32_t index(int32_t k) const { return order_[k]; }            // in the given order

 private:
  static constexpr int kParts = 8;  // steps per radius

  static uint16_t Place(double coordinate) {
    return uint16_t(std::clamp(std::floor(coordinate) + kNumRows / 2, 0.0, kNumRows - 1.0));
  }

  // Sorts the points by a key (stable); returns the start of each key.
  std::vector<int32_t> SortBy(const std::vector<uint16_t>& keys) {
    std::vector<int32_t> starts(kNumRows + 1), sorted(order_.size());
    for (const uint16_t key : keys) ++starts[key + 1];
    for (int64_t k = 0; k < kNumRows; ++k) starts[k + 1] += starts[k];
    std::vector<int32_t> fill(starts.begin(), starts.end() - 1);
    for (const int32_t i : order_) sorted[fill[keys[i]]++] = i;
    order_ = std::move(sorted);
    return starts;
  }

  std::vector<SeenPoint> points_;
  std::vector<int32_t> order_, starts_, steps_;  // starts of the rows
};

// For each point, the numbers of points of other curves within `radius_px` that are nearer to the
// camera than possible on one surface, and of those that are equally far; 0 for points of no curve.
// On one surface, depth changes by at most `slope` times itself per pixel.
inline Crowd CountAround(const std::vector<SeenPoint>& points, double radius_px, double slope,
                         int num_threads) {
  const PointRows rows(points, radius_px);
  Crowd crowd{std::vector<int32_t>(points.size()), std::vector<int32_t>(points.size())};
  ParallelBlocks(PointRows::kNumRows, num_threads, 16, [&](int64_t row) {
    rows.ForNeighbors(row, [&](int32_t k, int32_t from, int32_t to) {
      const SeenPoint& own = rows.point(k);
      int32_t nearer = 0, agreeing = 0;
      for (int32_t j = from; j < to; ++j) {
        const SeenPoint& other = rows.point(j);
        const double distance = Norm(other.pixel - own.pixel);
        const double gap = own.depth - other.depth;
        const double limit = slope * (distance + 1) * own.depth + own.margin + other.margin;
        // Without branches, which would be unpredictable.
        const bool counted = (other.curve != own.curve) & (distance <= radius_px);
        nearer += counted & (gap > limit);
        agreeing += counted & (std::abs(gap) <= limit);
      }
      crowd.nearer[rows.index(k)] += nearer, crowd.agreeing[rows.index(k)] += agreeing;
    });
  });
  return crowd;
}

}  // namespace colmap_edges
