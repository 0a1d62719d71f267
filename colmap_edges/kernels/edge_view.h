// One view's edge graph with its pose, ready for epipolar look-ups: dense polylines in ideal
// pixels (focal length `focal`, principal point at the origin) and a uniform grid over them.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <utility>
#include <vector>

#include "polyline.h"
#include "vectors.h"

namespace colmap_edges {

using Vec2f = std::array<float, 2>;
using Sides = std::array<uint8_t, 2>;  // gray on the dark and on the bright side

class EdgeView {
 public:
  // points, normals: (N, 2) ideal pixels; sides: (N, 2) gray on the dark and the bright side;
  // offsets: (P + 1) polylines; closed: (P).
  EdgeView(const std::vector<Vec2>& points, const std::vector<Vec2>& normals,
           const std::vector<Sides>& sides, std::vector<int64_t> offsets,
           std::vector<uint8_t> closed, const Mat3& rotation, const Vec3& translation, double focal)
      : points_(points.size()),
        offsets_(std::move(offsets)),
        closed_(std::move(closed)),
        rotation_(rotation),
        translation_(translation),
        focal_(focal) {
    if (offsets_.empty() || offsets_.front() != 0 || offsets_.back() != int64_t(points.size()) ||
        normals.size() != points.size() || sides.size() != points.size() ||
        closed_.size() + 1 != offsets_.size() ||
        !std::is_sorted(offsets_.begin(), offsets_.end())) {
      throw std::invalid_argument("points, normals, offsets and closed do not fit together");
    }
    if (!(focal > 0)) throw std::invalid_argument("focal must be positive");
    for (int32_t p = 0; p < num_polylines(); ++p) {
      for (int64_t i = first(p); i <= last(p); ++i) {
        points_[i] = {Narrowed(points[i]), Narrowed(normals[i]), {1, 0}, p, sides[i], i == last(p)};
      }
    }
    for (int64_t i = 0; i < num_points(); ++i) points_[i].tangent = Narrowed(FindTangent(i));
    BuildGrid();
  }

  int64_t num_points() const { return int64_t(points_.size()); }
  int64_t num_polylines() const { return int64_t(closed_.size()); }
  Vec2 point(int64_t i) const { return Widened(points_[i].xy); }
  Vec2 normal(int64_t i) const { return Widened(points_[i].normal); }
  const Sides& sides(int64_t i) const { return points_[i].sides; }
  int32_t polyline(int64_t i) const { return points_[i].polyline; }
  int64_t first(int32_t p) const { return offsets_[p]; }
  int64_t last(int32_t p) const { return offsets_[p + 1] - 1; }
  bool closed(int32_t p) const { return closed_[p] != 0; }
  const Mat3& rotation() const { return rotation_; }
  const Vec3& translation() const { return translation_; }
  double focal() const { return focal_; }

  // Asks for points i and i + 1 ahead of their use.
  void Prefetch(int64_t i) const {
    __builtin_prefetch(&points_[i]);
    __builtin_prefetch(&points_[i] + 1);
  }

  // The point after i along its polyline, -1 at an open end.
  int64_t Next(int64_t i) const {
    if (!points_[i].last) return i + 1;
    return closed(polyline(i)) ? first(polyline(i)) : -1;
  }

  // The point `steps` after i (before, if negative), stopping at open ends.
  int64_t Advance(int64_t i, int64_t steps) const {
    const int32_t p = polyline(i);
    const int64_t a = first(p), count = last(p) - a + 1;
    if (!closed(p)) return std::clamp(i + steps, a, a + count - 1);
    return a + (((i - a + steps) % count) + count) % count;
  }

  // Steps from position `from` to `to` on one polyline, the short way round a closed one.
  double Steps(int32_t p, double from, double to) const {
    double steps = to - from;
    if (closed(p)) {
      const double count = double(last(p) - first(p) + 1);
      steps -= count * std::round(steps / count);
    }
    return steps;
  }

  // Point at a fractional position i + t: between point i and the one after it.
  Vec2 At(double position) const {
    const int64_t i = int64_t(position);
    const int64_t j = Next(i);
    const Vec2& a = point(i);
    if (j < 0) return a;
    const Vec2& b = point(j);
    const double t = position - double(i);
    return {a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])};
  }

  // Unit direction of the polyline around point i.
  Vec2 tangent(int64_t i) const { return Widened(points_[i].tangent); }

  // Camera coordinates of a world point.
  Vec3 ToCamera(const Vec3& world) const { return Multiply(rotation_, world) + translation_; }

  // The chord of a stretch of a polyline, from point `first` over `count` steps. What crosses the
  // chord crosses the stretch, and all but grazing lines that cross the stretch cross the chord.
  struct Stretch {
    float ax, ay, bx, by;
    int32_t first, count;

    // Whether the chord comes into the box around `center`, or may: judged by its own box.
    bool Within(const Vec2& center, double radius) const {
      return std::min(ax, bx) <= center[0] + radius && std::max(ax, bx) >= center[0] - radius &&
             std::min(ay, by) <= center[1] + radius && std::max(ay, by) >= center[1] - radius;
    }
  };
  const std::vector<Stretch>& stretches() const { return stretches_; }

  // Calls visit(i) for each point within the square of half-width `radius` around `center`.
  template <typename Visit>
  void VisitNear(const Vec2& center, double radius, const Visit& visit) const;

 private:
  static constexpr double kCell = 16;            // pixels
  static constexpr int64_t kMaxStretch = 16;     // points; keeps a stretch within few cells
  static constexpr double kStretchDistance = 1;  // pixels between a stretch and its chord
  static constexpr int64_t kTangentReach = 3;    // points to both sides that make a tangent

  Vec2 FindTangent(int64_t i) const {
    const Vec2& a = point(Advance(i, -kTangentReach));
    const Vec2& b = point(Advance(i, kTangentReach));
    const double dx = b[0] - a[0], dy = b[1] - a[1], norm = std::hypot(dx, dy);
    return norm > 0 ? Vec2{dx / norm, dy / norm} : Vec2{1, 0};
  }

  int64_t Column(double x) const {
    return std::clamp<int64_t>(int64_t((x - low_[0]) / kCell), 0, columns_ - 1);
  }
  int64_t Row(double y) const {
    return std::clamp<int64_t>(int64_t((y - low_[1]) / kCell), 0, rows_ - 1);
  }

  std::vector<Stretch> MakeStretches() const;
  void BuildGrid();

  // All that a crossing needs to know of a point, as small as it can be: views are larger than
  // caches. Single precision is a thousandth of a chain's own noise.
  struct Point {
    Vec2f xy, normal, tangent;
    int32_t polyline;
    Sides sides;
    bool last;  // of its polyline
  };
  static Vec2 Widened(const Vec2f& v) { return {v[0], v[1]}; }
  static Vec2f Narrowed(const Vec2& v) { return {float(v[0]), float(v[1])}; }

  std::vector<Point> points_;
  std::vector<int64_t> offsets_;
  std::vector<uint8_t> closed_;
  Mat3 rotation_;
  Vec3 translation_;
  double focal_;
  Vec2 low_{0, 0}, high_{0, 0};
  int64_t columns_ = 1, rows_ = 1;
  std::vector<Stretch> stretches_;
  std::vector<int64_t> cell_offsets_;
  std::vector<Stretch> cell_stretches_;  // a stretch is in every cell that its box touches
};

inline std::vector<EdgeView::Stretch> EdgeView::MakeStretches() const {
  std::vector<Stretch> stretches;
  std::vector<int64_t> kept;
  const auto xy = [this](int64_t i) { return point(i); };
  const auto add = [&](int64_t i, int64_t j, int64_t count) {
    const Vec2 &a = point(i), &b = point(j);
    stretches.push_back(
        {float(a[0]), float(a[1]), float(b[0]), float(b[1]), int32_t(i), int32_t(count)});
  };
  for (int32_t p = 0; p < num_polylines(); ++p) {
    if (first(p) > last(p)) continue;
    kept.clear();
    DouglasPeucker(xy, first(p), last(p), kStretchDistance, &kept);
    for (size_t k = 0; k + 1 < kept.size(); ++k) {
      for (int64_t i = kept[k]; i < kept[k + 1]; i += kMaxStretch) {
        const int64_t j = std::min(i + kMaxStretch, kept[k + 1]);
        add(i, j, j - i);
      }
    }
    if (closed(p)) {
      add(last(p), first(p), 1);
    } else if (first(p) == last(p)) {
      add(first(p), first(p), 0);
    }
  }
  return stretches;
}

inline void EdgeView::BuildGrid() {
  if (!points_.empty()) low_ = high_ = point(0);
  for (const Point& p : points_) {
    for (int k = 0; k < 2; ++k) {
      low_[k] = std::min(low_[k], double(p.xy[k])), high_[k] = std::max(high_[k], double(p.xy[k]));
    }
  }
  columns_ = int64_t((high_[0] - low_[0]) / kCell) + 1;
  rows_ = int64_t((high_[1] - low_[1]) / kCell) + 1;
  cell_offsets_.assign(columns_ * rows_ + 1, 0);
  stretches_ = MakeStretches();
  const auto for_cells = [&](const Stretch& stretch, const auto& use) {
    Vec2 low = point(stretch.first), high = low;
    for (int64_t k = 1, i = stretch.first; k <= stretch.count; ++k) {
      i = Next(i);
      for (int d = 0; d < 2; ++d) {
        low[d] = std::min(low[d], point(i)[d]), high[d] = std::max(high[d], point(i)[d]);
      }
    }
    for (int64_t r = Row(low[1]); r <= Row(high[1]); ++r) {
      for (int64_t c = Column(low[0]); c <= Column(high[0]); ++c) use(r * columns_ + c);
    }
  };
  for (const Stretch& s : stretches_) for_cells(s, [&](int64_t c) { ++cell_offsets_[c + 1]; });
  for (size_t c = 1; c < cell_offsets_.size(); ++c) cell_offsets_[c] += cell_offsets_[c - 1];
  cell_stretches_.resize(cell_offsets_.back());
  std::vector<int64_t> fill(cell_offsets_.begin(), cell_offsets_.end() - 1);
  for (const Stretch& s : stretches_)
    for_cells(s, [&](int64_t c) { cell_stretches_[fill[c]++] = s; });
}

template <typename Visit>
void EdgeView::VisitNear(const Vec2& center, double radius, const Visit& visit) const {
  if (points_.empty() || center[0] + radius < low_[0] || center[0] - radius > high_[0] ||
      center[1] + radius < low_[1] || center[1] - radius > high_[1]) {
    return;
  }
  for (int64_t r = Row(center[1] - radius); r <= Row(center[1] + radius); ++r) {
    for (int64_t c = Column(center[0] - radius); c <= Column(center[0] + radius); ++c) {
      const int64_t cell = r * columns_ + c;
      for (int64_t k = cell_offsets_[cell]; k < cell_offsets_[cell + 1]; ++k) {
        const Stretch& stretch = cell_stretches_[k];
        if (!stretch.Within(center, radius + kStretchDistance)) continue;
        // The last point of a stretch is the first of the next, or the open end of its polyline.
        const int64_t end = stretch.first + stretch.count;
        const bool at_end = stretch.count > 0 && end < num_points() && Next(end) < 0;
        for (int64_t i = stretch.first; i < end + (at_end || stretch.count == 0); ++i) {
          const Vec2& p = point(i);
          // Few points are near; to find the cell of one takes longer.
          if (std::abs(p[0] - center[0]) <= radius && std::abs(p[1] - center[1]) <= radius &&
              Column(p[0]) == c && Row(p[1]) == r) {
            visit(i);
          }
        }
      }
    }
  }
}

}  // namespace colmap_edges
