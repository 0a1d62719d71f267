// Lines on a plane on which gray changes in several views, too little in any single one.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "common/vectors.h"
#include "faces/grids.h"

namespace colmap_edges {

// A change of gray on a plane.
struct Mark {
  Vec3 point, direction;  // direction: length 1, along the change
  double size;            // of a pixel there
  int32_t plane;
};

// The marks that a view sees where its blurred picture changes most across, at least by min_slope
// a pixel. labels: planes of the cells, -1: none.
inline std::vector<Mark> MarksOf(const FaceView& view, const double* smooth, const int32_t* labels,
                                 const std::vector<Plane>& planes, double min_slope) {
  const int64_t width = view.width();
  const double least = min_slope * min_slope;
  struct Gradient {
    double x, y, squared;
  };
  const auto gradient = [&](int64_t x, int64_t y) {
    const double* at = smooth + y * width + x;
    const double gx = 0.5 * (at[1] - at[-1]), gy = 0.5 * (at[width] - at[-width]);
    return Gradient{gx, gy, gx * gx + gy * gy};
  };
  std::vector<Mark> marks;
  for (int64_t y = 2; y < view.height() - 2; ++y) {
    for (int64_t x = 2; x < width - 2; ++x) {
      const int32_t label = labels[y / FaceView::kCellPx * view.columns + x / FaceView::kCellPx];
      if (label < 0) continue;
      const Gradient g = gradient(x, y);
      if (!(g.squared > least)) continue;
      const double most = std::max(std::abs(g.x), std::abs(g.y));
      const int64_t right = std::lrint(g.x / most), down = std::lrint(g.y / most);
      if (g.squared < gradient(x + right, y + down).squared ||
          g.squared <= gradient(x - right, y - down).squared)
        continue;
      const Plane& plane = planes[label];
      const Vec2 pixel{double(x) + 0.5, double(y) + 0.5};
      const Vec2 next = pixel + (1 / std::sqrt(g.squared)) * Vec2{-g.y, g.x};
      const auto away = [&](Vec2 at) {  // from the view to where it sees the plane
        const Vec3 ray = view.RayThrough(at);
        const double depth = -plane.Distance(view.pose.center) / Dot(plane.normal, ray);
        return (depth > 0 ? depth : NAN) * ray;
      };
      const Vec3 here = away(pixel), along = away(next) - here;
      const double size = Norm(here) / view.pose.focal_px, length = Norm(along);
      if (length > 0 && length < 8 * size)
        marks.push_back({view.pose.center + here, (1 / length) * along, size, label});
    }
  }
  return marks;
}

struct FaintLineOptions {
  int num_angles;      // line directions in half a turn
  double width;        // of lines; lengths are in sizes of a pixel
  int64_t max_places;  // maximum number of parallel positions
  double max_turn;     // maximum sine between a mark and its line
  int64_t min_marks, min_views, min_steps;
  double step;  // length of a stretch of a line
  int64_t max_tried;
};

// The marks of one plane, in its coordinates.
struct FlatMarks {
  const double *at, *along;  // (P, 2) places and directions
  const int64_t* views;      // (P)
  int64_t count;
  double size;  // of a pixel there
};

struct FaintLine {
  std::vector<int64_t> marks, steps;  // the marks on it, and the stretch of each
};

class FaintLines {
 public:
  FaintLines(const FlatMarks& marks, const FaintLineOptions& options)
      : marks_(marks), options_(options), taken_(marks.count, false) {}

  // Lines with the most votes for their angle and place first.
  std::vector<FaintLine> Run() {
    std::vector<FaintLine> lines;
    for (const auto& [angle, place] : Peaks()) {
      FaintLine line = Fitted(angle, place);
      if (line.marks.empty()) continue;
      for (const int64_t i : line.marks) taken_[i] = true;
      for (auto& row : by_row_) {
        const auto taken = [this](const Entry& entry) { return taken_[entry.mark] != 0; };
        row.erase(std::remove_if(row.begin(), row.end(), taken), row.end());
      }
      lines.push_back(std::move(line));
    }
    return lines;
  }

 private:
  struct Peak {
    double angle, place;
  };
  struct Entry {
    Vec2 at, along;
    int64_t mark;
  };

  Vec2 At(int64_t i) const { return {marks_.at[2 * i], marks_.at[2 * i + 1]}; }
  Vec2 Along(int64_t i) const { return {marks_.along[2 * i], marks_.along[2 * i + 1]}; }

  int RowOf(double angle) const {
    const double share = angle / M_PI - std::floor(angle / M_PI);
    return std::min(int(share * options_.num_angles), options_.num_angles - 1);
  }

  // Also sorts the marks by angle.
  std::vector<Peak> Peaks() {
    const double width = options_.width * marks_.size;
    std::vector<int32_t> rows(marks_.count);
    std::vector<double> across(marks_.count);
    by_row_.assign(options_.num_angles, {});
    for (int64_t i = 0; i < marks_.count; ++i) {
      const Vec2 along = Along(i);
      rows[i] = RowOf(std::atan2(along.y, along.x));
      across[i] = Cross(along.y < 0 || (along.y == 0 && along.x < 0) ? -1.0 * along : along, At(i));
      by_row_[rows[i]].push_back({At(i), along, i});
    }
    const double low = MedianOf(across) - double(options_.max_places) / 2 * width;
    std::vector<int64_t> columns(marks_.count);
    int64_t first = options_.max_places, last = -1;
    for (int64_t i = 0; i < marks_.count; ++i) {
      const double column = std::floor((across[i] - low) / width);
      columns[i] = column >= 0 && column < double(options_.max_places) ? int64_t(column) : -1;
      if (columns[i] >= 0) first = std::min(first, columns[i]), last = std::max(last, columns[i]);
    }
    if (last < first) return {};
    // With an empty border of two, as votes count for their neighbours, too.
    const int64_t across_size = last - first + 5;
    std::vector<int32_t> votes((options_.num_angles + 4) * across_size, 0);
    for (int64_t i = 0; i < marks_.count; ++i)
      if (columns[i] >= 0) ++votes[(rows[i] + 2) * across_size + columns[i] - first + 2];
    std::vector<std::pair<int32_t, int64_t>> found;
    std::vector<int32_t> sums(across_size), boxes(across_size);
    for (int64_t row = 2; row < options_.num_angles + 2; ++row) {
      const int32_t* middle = &votes[row * across_size];
      for (int64_t c = 0; c < across_size; ++c)
        sums[c] = middle[c - across_size] + middle[c] + middle[c + across_size];
      int32_t most = 0;
      for (int64_t c = 1; c < across_size - 1; ++c) {
        boxes[c] = sums[c - 1] + sums[c] + sums[c + 1];
        most = std::max(most, boxes[c]);
      }
      if (most < options_.min_marks) continue;
      for (int64_t c = 2; c < across_size - 2; ++c)
        if (boxes[c] >= options_.min_marks) found.emplace_back(-boxes[c], row * across_size + c);
    }
    const size_t kept = std::min(found.size(), size_t(options_.max_tried));
    std::partial_sort(found.begin(), found.begin() + kept, found.end());
    std::vector<Peak> peaks;
    for (size_t i = 0; i < kept; ++i) {
      const int64_t row = found[i].second / across_size - 2;
      const int64_t column = found[i].second % across_size - 2 + first;
      peaks.push_back(
          {(double(row) + 0.5) / options_.num_angles * M_PI, low + (double(column) + 0.5) * width});
    }
    return peaks;
  }

  static double MedianOf(std::vector<double> values) {
    const size_t half = values.size() / 2;
    std::nth_element(values.begin(), values.begin() + half, values.end());
    if (values.size() % 2) return values[half];
    return 0.5 * (values[half] + *std::max_element(values.begin(), values.begin() + half));
  }

  // Free marks near a line and along it, ascending.
  std::vector<int64_t> Near(double angle, double place) const {
    const Vec2 normal{-std::sin(angle), std::cos(angle)};
    const double width = options_.width * marks_.size;
    const int row = RowOf(angle);
    const int reach = std::min(int(std::asin(options_.max_turn) / M_PI * options_.num_angles) + 1,
                               (options_.num_angles - 1) / 2);
    std::vector<int64_t> near;
    const auto visit = [&](int at) {
      for (const Entry& entry : by_row_[(at + options_.num_angles) % options_.num_angles]) {
        if (std::abs(Dot(entry.at, normal) - place) < width &&
            std::abs(Dot(entry.along, normal)) < options_.max_turn)
          near.push_back(entry.mark);
      }
    };
    for (int step = -reach; step <= reach; ++step) visit(row + step);
    std::sort(near.begin(), near.end());
    return near;
  }

  // The line fitted to the free marks near it; without any where too few views agree.
  FaintLine Fitted(double angle, double place) const {
    std::vector<int64_t> near;
    for (int round = 0; round < 2; ++round) {
      near = Near(angle, place);
      if (int64_t(near.size()) < options_.min_marks) return {};
      Vec2 middle;
      for (const int64_t i : near) middle = middle + (1 / double(near.size())) * At(i);
      double xx = 0, xy = 0, yy = 0;
      for (const int64_t i : near) {
        const Vec2 off = At(i) - middle;
        xx += off.x * off.x, xy += off.x * off.y, yy += off.y * off.y;
      }
      angle = 0.5 * std::atan2(2 * xy, xx - yy);
      place = Dot(middle, {-std::sin(angle), std::cos(angle)});
    }
    return WellSeen(near, {std::cos(angle), std::sin(angle)});
  }

  // The marks of those stretches of a line that enough views see.
  FaintLine WellSeen(const std::vector<int64_t>& near, Vec2 direction) const {
    struct Place {
      int64_t step, view, mark;
    };
    std::vector<Place> places;
    for (const int64_t i : near) {
      const double step = std::floor(Dot(At(i), direction) / (options_.step * marks_.size));
      places.push_back({int64_t(step), marks_.views[i], i});
    }
    std::sort(places.begin(), places.end(), [](const Place& a, const Place& b) {
      return a.step != b.step   ? a.step < b.step
             : a.view != b.view ? a.view < b.view
                                : a.mark < b.mark;
    });
    FaintLine line;
    int64_t num_steps = 0;
    for (size_t first = 0, last; first < places.size(); first = last) {
      int64_t views = 0;
      for (last = first; last < places.size() && places[last].step == places[first].step; ++last)
        views += last == first || places[last].view != places[last - 1].view;
      if (views < options_.min_views) continue;
      ++num_steps;
      for (size_t i = first; i < last; ++i)
        line.marks.push_back(places[i].mark), line.steps.push_back(places[i].step);
    }
    return num_steps < options_.min_steps ? FaintLine{} : line;
  }

  const FlatMarks marks_;
  const FaintLineOptions options_;
  std::vector<uint8_t> taken_;              // marks that are on a line
  std::vector<std::vector<Entry>> by_row_;  // the other marks, by angle
};

}  // namespace colmap_edges
