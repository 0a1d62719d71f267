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
  };
  const std::vector<Stretch>& stretches() const { return stretches_; }

  // Calls visit(i, dx, dy) for each point i, seen from `center`, that is within the square of
  // half-width `radius` around it.
  template <typename Visit>
  void VisitNear(const Vec2& center, double radius, const Visit& visit) const;

 private:
  static constexpr double kCell = 8;             // pixels
  static constexpr int64_t kMaxStretch = 16;     // points; keeps it within few bins of angles
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
  int64_t CellOf(const Vec2& x) const { return Row(x[1]) * columns_ + Column(x[0]); }

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
  struct CellPoint {
    Vec2f xy;
    int32_t index;
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
  std::vector<int32_t> cell_offsets_;
  std::vector<CellPoint> cell_points_;  // by cell, ascending
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
  stretches_ = MakeStretches();
  cell_offsets_.assign(columns_ * rows_ + 1, 0);
  for (int64_t i = 0; i < num_points(); ++i) ++cell_offsets_[CellOf(point(i)) + 1];
  for (size_t c = 1; c < cell_offsets_.size(); ++c) cell_offsets_[c] += cell_offsets_[c - 1];
  cell_points_.resize(points_.size());
  std::vector<int32_t> fill(cell_offsets_.begin(), cell_offsets_.end() - 1);
  for (int64_t i = 0; i < num_points(); ++i) {
    cell_points_[fill[CellOf(point(i))]++] = {points_[i].xy, int32_t(i)};
  }
}

template <typename Visit>
void EdgeView::VisitNear(const Vec2& center, double radius, const Visit& visit) const {
  if (points_.empty() || center[0] + radius < low_[0] || center[0] - radius > high_[0] ||
      center[1] + radius < low_[1] || center[1] - radius > high_[1]) {
    return;
  }
  const int64_t left = Column(center[0] - radius), right = Column(center[0] + radius);
  for (int64_t r = Row(center[1] - radius); r <= Row(center[1] + radius); ++r) {
    const int32_t end = cell_offsets_[r * columns_ + right + 1];
    for (int32_t k = cell_offsets_[r * columns_ + left]; k < end; ++k) {
      const CellPoint& p = cell_points_[k];
      const double dx = p.xy[0] - center[0], dy = p.xy[1] - center[1];
      if (std::abs(dx) <= radius && std::abs(dy) <= radius) visit(int64_t(p.index), dx, dy);
    }
  }
}

}  // namespace colmap_edges
