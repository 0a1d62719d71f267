// Search index of one view's edge graph, with its pose: dense polylines in undistorted pixels and a
// uniform grid over them. A position on a chain is a fractional index: the index of the previous
// point plus the fraction of the way to the next one. The last point of a closed chain is
// connected to its first.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <mutex>
#include <stdexcept>
#include <utility>
#include <vector>

#include "common/geometry.h"
#include "common/polyline.h"
#include "common/vectors.h"

namespace colmap_edges {

using Vec2f = std::array<float, 2>;
using Sides = std::array<uint8_t, 2>;  // intensities of the dark and the bright side

// The coordinates of a unit vector, times `scale`, as integers.
template <typename T, typename Vector>
std::array<T, 2> Rounded(const Vector& v, double scale) {
  const auto rounded = [=](double x) {
    const double scaled = scale * std::clamp(x, -1.0, 1.0);
    return T(scaled + std::copysign(0.5, scaled));
  };
  return {rounded(v[0]), rounded(v[1])};
}

// A value made at its first use, by any thread.
template <typename T>
class Lazy {
 public:
  template <typename Make>
  const T& Get(const Make& make) const {
    std::call_once(once_, [&] { value_ = make(); });
    return value_;
  }

 private:
  mutable std::once_flag once_;
  mutable T value_;
};

class EdgeIndex {
 public:
  // points, normals: (N, 2) undistorted pixels; sides: (N, 2) intensities of the dark and the
  // bright side; offsets: (P + 1) CSR of the points by polyline; closed: (P).
  EdgeIndex(const std::vector<Vec2f>& points, const std::vector<Vec2f>& normals,
            const std::vector<Sides>& sides, std::vector<int64_t> offsets,
            std::vector<uint8_t> closed, const PinholeView& pose)
      : points_(points.size()),
        offsets_(std::move(offsets)),
        closed_(std::move(closed)),
        pose_(pose) {
    if (offsets_.empty() || offsets_.front() != 0 || offsets_.back() != int64_t(points.size()) ||
        normals.size() != points.size() || sides.size() != points.size() ||
        closed_.size() + 1 != offsets_.size() ||
        !std::is_sorted(offsets_.begin(), offsets_.end())) {
      throw std::invalid_argument("points, normals, offsets and closed do not fit together");
    }
    if (!(pose.focal_px > 0)) throw std::invalid_argument("focal must be positive");
    for (int32_t p = 0; p < num_polylines(); ++p) {
      for (int64_t i = first(p); i <= last(p); ++i) {
        if (!std::isfinite(points[i][0]) || !std::isfinite(points[i][1])) {
          throw std::invalid_argument("edge points must be finite");
        }
        points_[i] = {points[i], {1, 0}, Direction(normals[i]), p, sides[i], i == last(p)};
      }
    }
    for (int64_t i = 0; i < num_points(); ++i) points_[i].tangent = Narrowed(FindTangent(i));
    BuildGrid();
  }

  int64_t num_points() const { return int64_t(points_.size()); }
  int64_t num_polylines() const { return int64_t(closed_.size()); }
  Vec2 point(int64_t i) const { return Widened(points_[i].xy); }
  Vec2 normal(int64_t i) const { return points_[i].normal.vector(); }
  const Sides& sides(int64_t i) const { return points_[i].sides; }
  int32_t polyline(int64_t i) const { return points_[i].polyline; }
  int64_t first(int32_t p) const { return offsets_[p]; }
  int64_t last(int32_t p) const { return offsets_[p + 1] - 1; }
  bool closed(int32_t p) const { return closed_[p] != 0; }
  const PinholeView& pose() const { return pose_; }
  const Mat3& rotation() const { return pose_.R; }
  const Vec3& translation() const { return pose_.t; }
  double focal() const { return pose_.focal_px; }
  double longest_segment() const { return longest_segment_; }  // pixels

  // Prefetches points i and i + 1.
  void Prefetch(int64_t i) const {
    __builtin_prefetch(&points_[i]);
    __builtin_prefetch(&points_[i] + 1);
  }

  // Whether there may be points within the square of half width `radius` around a pixel.
  bool Reaches(const Vec2& center, double radius) const {
    return !points_.empty() && center.x + radius >= low_.x && center.x - radius <= high_.x &&
           center.y + radius >= low_.y && center.y - radius <= high_.y;
  }

  // Prefetches the offsets of the cells around a pixel; then, if these are there, the first points.
  void PrefetchCells(const Vec2& center, double radius) const {
    __builtin_prefetch(&cell_offsets_[Row(center.y) * columns_ + Column(center.x - radius)]);
  }
  void PrefetchCellPoints(const Vec2& center, double radius) const {
    const int64_t cell = Row(center.y) * columns_ + Column(center.x - radius);
    const char* points = reinterpret_cast<const char*>(cell_points_.data() + cell_offsets_[cell]);
    for (int line = 0; line < 4; ++line) __builtin_prefetch(points + 64 * line);
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

  // The position at a fraction in [0, 1] of the segment from point i to its next one.
  double Position(int64_t i, double fraction) const {
    const double position = double(i) + fraction;
    return position < double(i + 1) ? position : double(Next(i));
  }

  // Whether a number is a position on a chain.
  bool Holds(double position) const { return position >= 0 && position < double(num_points()); }

  // Unit direction of the polyline around point i.
  Vec2 tangent(int64_t i) const { return Widened(points_[i].tangent); }

  // The chord of a stretch of a polyline, from point `first` over `count` steps. Lines that
  // intersect the chord intersect the stretch; the converse holds except for nearly tangent lines.
  struct Stretch {
    float ax, ay, bx, by;
    int32_t first, count;
  };
  const std::vector<Stretch>& stretches() const {
    return stretches_.Get([this] { return MakeStretches(); });
  }

  // Calls visit(i, dx, dy) for each point i within the square of half width `radius` around
  // `center`, with its offset from there.
  template <typename Visit>
  void VisitNear(const Vec2& center, double radius, const Visit& visit) const {
    const int64_t left = Column(center.x - radius), right = Column(center.x + radius);
    VisitRows(center, radius, visit, [=](int64_t) { return std::make_pair(left, right); });
  }

  // Direction of a polyline at a point and its normal, times 127: a copy beside the point's
  // position, where searches find it without another access to memory.
  struct Directions {
    static constexpr double kScale = 127, kError = 0.5 / kScale;  // of a coordinate
    std::array<int8_t, 2> tangent, normal;
  };

  // The nearest of the points within a radius for which accept(i, its directions), or -1.
  template <typename Accept>
  int64_t Nearest(const Vec2& center, double radius, const Accept& accept) const;

  // As VisitNear, but points farther than `margin` from a line may be left out.
  template <typename Visit>
  void VisitAlong(const Line2D& line, double margin, const Vec2& center, double radius,
                  const Visit& visit) const;

 private:
  static constexpr double kCell = 8;             // pixels
  static constexpr int64_t kMaxStretch = 16;     // points, so that it covers few bins of angles
  static constexpr double kStretchDistance = 1;  // pixels between a stretch and its chord
  static constexpr int64_t kTangentReach = 3;    // points on both sides used for a tangent

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

  // VisitNear in the cells of each row r in the range columns(r).
  template <typename Visit, typename Columns>
  void VisitRows(const Vec2& center, double radius, const Visit& visit,
                 const Columns& columns) const;

  std::vector<Stretch> MakeStretches() const;
  void BuildGrid();

  // A unit vector in 16 bits a coordinate: within 0.00002 of a radian.
  struct Direction {
    static constexpr double kScale = 32767;
    std::array<int16_t, 2> rounded{};

    Direction() = default;
    template <typename Vector>
    explicit Direction(const Vector& v) : rounded(Rounded<int16_t>(v, kScale)) {}
    Vec2 vector() const { return {rounded[0] * (1 / kScale), rounded[1] * (1 / kScale)}; }
  };

  // Data of a point for intersections, kept small since views do not fit into caches. Rounding to
  // single precision is a thousandth of a chain's noise.
  struct Point {
    Vec2f xy, tangent;
    Direction normal;
    int32_t polyline;
    Sides sides;
    bool last;  // of its polyline
  };
  struct CellPoint {
    Vec2f xy;
    int32_t index;
    Directions directions;
  };
  static Vec2 Widened(const Vec2f& v) { return {v[0], v[1]}; }
  static Vec2f Narrowed(const Vec2& v) { return {float(v[0]), float(v[1])}; }

  std::vector<Point> points_;
  std::vector<int64_t> offsets_;
  std::vector<uint8_t> closed_;
  PinholeView pose_;
  Vec2 low_{0, 0}, high_{0, 0};
  int64_t columns_ = 1, rows_ = 1;
  double longest_segment_ = 0;
  Lazy<std::vector<Stretch>> stretches_;
  std::vector<int32_t> cell_offsets_;
  std::vector<CellPoint> cell_points_;  // by cell, ascending
};

inline std::vector<EdgeIndex::Stretch> EdgeIndex::MakeStretches() const {
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
  stretches.shrink_to_fit();
  return stretches;
}

inline void EdgeIndex::BuildGrid() {
  if (!points_.empty()) low_ = high_ = point(0);
  for (const Point& p : points_) {
    for (int k = 0; k < 2; ++k) {
      low_[k] = std::min(low_[k], double(p.xy[k])), high_[k] = std::max(high_[k], double(p.xy[k]));
    }
  }
  double longest2 = 0;
  for (int64_t i = 0; i < num_points(); ++i) {
    if (Next(i) < 0) continue;
    const Vec2 step = point(Next(i)) - point(i);
    longest2 = std::max(longest2, Dot(step, step));
  }
  longest_segment_ = std::sqrt(longest2);
  columns_ = int64_t((high_[0] - low_[0]) / kCell) + 1;
  rows_ = int64_t((high_[1] - low_[1]) / kCell) + 1;
  cell_offsets_.assign(columns_ * rows_ + 1, 0);
  for (int64_t i = 0; i < num_points(); ++i) ++cell_offsets_[CellOf(point(i)) + 1];
  for (size_t c = 1; c < cell_offsets_.size(); ++c) cell_offsets_[c] += cell_offsets_[c - 1];
  cell_points_.resize(points_.size());
  std::vector<int32_t> fill(cell_offsets_.begin(), cell_offsets_.end() - 1);
  for (int64_t i = 0; i < num_points(); ++i) {
    const Point& p = points_[i];
    cell_points_[fill[CellOf(point(i))]++] = {p.xy,
                                              int32_t(i),
                                              {Rounded<int8_t>(tangent(i), Directions::kScale),
                                               Rounded<int8_t>(normal(i), Directions::kScale)}};
  }
}

template <typename Visit>
void EdgeIndex::VisitAlong(const Line2D& line, double margin, const Vec2& center, double radius,
                           const Visit& visit) const {
  VisitRows(center, radius, visit, [&](int64_t r) {
    double left = center.x - radius, right = center.x + radius;
    if (std::abs(line.a) > 1e-9) {
      // The part of the row within the margin of the line.
      const double top = low_.y + kCell * double(r), bottom = top + kCell;
      const auto [first, last] =
          std::minmax({-(line.c + line.b * top) / line.a, -(line.c + line.b * bottom) / line.a});
      const double aside = margin / std::abs(line.a);
      left = std::max(left, first - aside), right = std::min(right, last + aside);
    }
    return std::make_pair(Column(left), left <= right ? Column(right) : -1);
  });
}

template <typename Visit, typename Columns>
void EdgeIndex::VisitRows(const Vec2& center, double radius, const Visit& visit,
                          const Columns& columns) const {
  if (!Reaches(center, radius)) return;
  for (int64_t r = Row(center[1] - radius); r <= Row(center[1] + radius); ++r) {
    const auto [left, right] = columns(r);
    const int32_t end = cell_offsets_[r * columns_ + right + 1];
    for (int32_t k = cell_offsets_[r * columns_ + left]; k < end; ++k) {
      const CellPoint& p = cell_points_[k];
      const double dx = p.xy[0] - center[0], dy = p.xy[1] - center[1];
      if (std::abs(dx) <= radius && std::abs(dy) <= radius) visit(int64_t(p.index), dx, dy);
    }
  }
}

template <typename Accept>
int64_t EdgeIndex::Nearest(const Vec2& center, double radius, const Accept& accept) const {
  if (!Reaches(center, radius)) return -1;
  constexpr int kBlock = 32;  // points whose distances are computed before they are tested
  double best = radius * radius;
  int64_t nearest = -1;
  const int64_t left = Column(center.x - radius), right = Column(center.x + radius);
  const auto search = [&](int64_t r) {
    int32_t k = cell_offsets_[r * columns_ + left];
    const int32_t end = cell_offsets_[r * columns_ + right + 1];
    while (k < end) {
      double distances2[kBlock];
      const CellPoint* near[kBlock];
      int count = 0;
      // Without branches, which would be unpredictable.
      for (const int32_t stop = std::min(k + kBlock, end); k < stop; ++k) {
        const CellPoint& p = cell_points_[k];
        const double dx = p.xy[0] - center.x, dy = p.xy[1] - center.y;
        const double distance2 = dx * dx + dy * dy;
        distances2[count] = distance2, near[count] = &p;
        count += distance2 <= best;
      }
      for (int c = 0; c < count; ++c) {
        if (distances2[c] > best || (distances2[c] == best && nearest >= 0)) continue;
        if (!accept(int64_t(near[c]->index), near[c]->directions)) continue;
        best = distances2[c], nearest = near[c]->index;
      }
    }
  };
  // Neighbouring rows only if they can contain a nearer point.
  const int64_t middle = Row(center.y);
  search(middle);
  for (int64_t r = middle - 1; r >= Row(center.y - radius); --r) {
    const double gap = center.y - (low_.y + kCell * double(r + 1));
    if (gap > 0 && gap * gap > best) break;
    search(r);
  }
  for (int64_t r = middle + 1; r <= Row(center.y + radius); ++r) {
    const double gap = low_.y + kCell * double(r) - center.y;
    if (gap > 0 && gap * gap > best) break;
    search(r);
  }
  return nearest;
}

}  // namespace colmap_edges
