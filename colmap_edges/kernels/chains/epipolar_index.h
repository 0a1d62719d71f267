// Index for intersections of the epipolar lines of one view with the chains of another: a grid over
// stretches of chains in epipolar coordinates, the angle of the epipolar plane about the baseline
// and the angle between ray and baseline. They are defined for any pair of poses, also if an
// epipole is inside the image.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/edge_index.h"

namespace colmap_edges {

// Geometry of a source and a neighbour: X_neighbor ~ rotation * ray + inverse_depth * translation.
struct Pair {
  const EdgeIndex* view;
  Mat3 rotation;
  Vec3 translation;
  Vec3 source_epipole;  // source centre -> neighbour centre, in the source's camera frame
};

inline Pair MakePair(const EdgeIndex& source, const EdgeIndex& neighbor) {
  Pair pair;
  pair.view = &neighbor;
  pair.rotation = MultiplyByTransposed(neighbor.rotation(), source.rotation());
  pair.translation = neighbor.translation() - Multiply(pair.rotation, source.translation());
  pair.source_epipole = -1.0 * MultiplyTransposed(pair.rotation, pair.translation);
  return pair;
}

class EpipolarIndex {
 public:
  // A stretch in one bin of angles: its range of angles and its points.
  struct Entry {
    float start, end;
    int32_t first, count;
  };

  // An entry whose angles contain that of an epipolar line, and the approximate position on it.
  struct Crossed {
    Entry entry;
    int32_t guess;
  };

  EpipolarIndex() = default;

  // Stretches within `min_angle_sin` of the epipolar direction are left out.
  EpipolarIndex(const Pair& pair, double min_angle_sin) : view_(pair.view) {
    baseline_ = Norm(pair.translation);
    if (!(baseline_ > 0)) return;
    axis_ = 1 / baseline_ * pair.translation;
    // Angles are relative to the optical axis, so that the wrap-around is behind the camera.
    const bool forward = std::abs(axis_[2]) > 0.999;
    e2_ = Cross(axis_, forward ? Vec3{1, 0, 0} : Vec3{0, 0, 1});
    e2_ = 1 / Norm(e2_) * e2_;
    e1_ = Cross(e2_, axis_);
    Build(min_angle_sin);
  }

  // Number by which rays (neighbour's camera frame) are in the order of the angles of their
  // epipolar planes.
  float Rank(const Vec3& ray) const {
    const double x = Dot(ray, e1_), y = Dot(ray, e2_);
    const double along = x / (std::abs(x) + std::abs(y) + 1e-300);
    return float(y < 0 ? along - 1 : 1 - along);
  }

  // Calls visit(i, t) for each segment i -> Next(i) of the neighbour that the epipolar line of the
  // ray a + inverse depth * translation (neighbour's camera frame) intersects between two inverse
  // depths, or up to a bin beyond; t in [0, 1] is the fraction along the segment. `crossed` is a
  // buffer.
  template <typename Visit>
  void VisitCrossings(const Vec3& a, double low, double high, std::vector<Crossed>* crossed,
                      const Visit& visit) const;

 private:
  static constexpr double kAngleBin = 8;      // pixels
  static constexpr double kPositionBin = 32;  // pixels, longer than a stretch
  static constexpr int64_t kMaxBins = 1 << 12;
  static constexpr double kPi = 3.14159265358979323846;

  struct Place {
    double angle, position;
  };

  Place PlaceOf(const Vec3& ray) const {
    const double x = Dot(ray, e1_), y = Dot(ray, e2_), along = Dot(ray, axis_);
    return {std::atan2(y, x), std::atan2(std::sqrt(x * x + y * y), along)};
  }

  int64_t AngleBin(double angle) const {
    return std::clamp<int64_t>(int64_t((angle - low_.angle) * angle_scale_), 0, angle_bins_ - 1);
  }
  int64_t PositionBin(double position) const {
    return std::clamp<int64_t>(int64_t((position - low_.position) * position_scale_), 0,
                               position_bins_ - 1);
  }

  struct Span {
    Place from, to;
    int32_t first, count;
  };
  std::vector<Span> MakeSpans(double min_angle_sin) const;
  void Build(double min_angle_sin);
  template <typename Use>
  void ForBins(const Span& span, const Use& use) const;

  const EdgeIndex* view_ = nullptr;
  double baseline_ = 0;
  Vec3 axis_{}, e1_{}, e2_{};
  Place low_{0, 0};
  double angle_scale_ = 1, position_scale_ = 1;  // bins a unit
  int64_t angle_bins_ = 0, position_bins_ = 0;
  std::vector<int32_t> offsets_;
  std::vector<Entry> entries_;
};

inline std::vector<EpipolarIndex::Span> EpipolarIndex::MakeSpans(double min_angle_sin) const {
  std::vector<Span> spans;
  spans.reserve(view_->stretches().size());
  const double f = view_->focal();
  float last_x = NAN, last_y = NAN;
  Place last{};
  for (const EdgeIndex::Stretch& s : view_->stretches()) {
    // A stretch usually begins at the end of the previous one.
    const bool goes_on = s.ax == last_x && s.ay == last_y;
    const Place from = goes_on ? last : PlaceOf({s.ax / f, s.ay / f, 1});
    const Place to = PlaceOf({s.bx / f, s.by / f, 1});
    last_x = s.bx, last_y = s.by, last = to;
    // The epipolar direction is the projection of the baseline's direction at this pixel.
    const double dx = f * axis_[0] - s.ax * axis_[2], dy = f * axis_[1] - s.ay * axis_[2];
    const double x = s.bx - s.ax, y = s.by - s.ay;
    const double cross = std::abs(dx * y - dy * x);
    if (cross * cross < min_angle_sin * min_angle_sin * (dx * dx + dy * dy) * (x * x + y * y)) {
      continue;
    }
    spans.push_back({from, to, s.first, s.count});
    if (std::abs(from.angle - to.angle) <= kPi) continue;
    // A stretch across the wrap-around is entered on both sides.
    Span& low = spans.back();
    Span high = low;
    (low.from.angle > low.to.angle ? low.from : low.to).angle -= 2 * kPi;
    (high.from.angle < high.to.angle ? high.from : high.to).angle += 2 * kPi;
    spans.push_back(high);
  }
  return spans;
}

// Calls use(bin) for each bin of angles of a stretch, with its position there.
template <typename Use>
void EpipolarIndex::ForBins(const Span& span, const Use& use) const {
  const auto [low, high] = std::minmax(span.from.angle, span.to.angle);
  const int64_t first = AngleBin(low), last = AngleBin(high);
  const double slope = (span.to.position - span.from.position) /
                       std::max(std::abs(span.to.angle - span.from.angle), 1e-300) *
                       (span.to.angle > span.from.angle ? 1 : -1);
  for (int64_t bin = first; bin <= last; ++bin) {
    const double middle = low_.angle + (double(bin) + 0.5) / angle_scale_;
    const double angle = std::clamp(middle, low, high);
    const double position = span.from.position + slope * (angle - span.from.angle);
    use(bin * position_bins_ + PositionBin(position));
  }
}

inline void EpipolarIndex::Build(double min_angle_sin) {
  // Tolerance, since chords deviate from their stretches; the intersection is tested exactly later.
  const std::vector<Span> spans = MakeSpans(0.5 * min_angle_sin);
  if (spans.empty()) return;
  Place high{-kPi, 0};
  low_ = {kPi, kPi};
  for (const Span& span : spans) {
    for (const Place& place : {span.from, span.to}) {
      low_.angle = std::min(low_.angle, std::max(place.angle, -kPi));
      high.angle = std::max(high.angle, std::min(place.angle, kPi));
      low_.position = std::min(low_.position, place.position);
      high.position = std::max(high.position, place.position);
    }
  }
  const double f = view_->focal();
  const auto bins = [&](double extent, double pixels) {
    return std::clamp<int64_t>(int64_t(extent * f / pixels) + 1, 1, kMaxBins);
  };
  angle_bins_ = bins(high.angle - low_.angle, kAngleBin);
  position_bins_ = bins(high.position - low_.position, kPositionBin);
  angle_scale_ = double(angle_bins_) / std::max(high.angle - low_.angle, 1e-12);
  position_scale_ = double(position_bins_) / std::max(high.position - low_.position, 1e-12);
  offsets_.assign(angle_bins_ * position_bins_ + 1, 0);
  for (const Span& s : spans) ForBins(s, [&](int64_t bin) { ++offsets_[bin + 1]; });
  for (size_t b = 1; b < offsets_.size(); ++b) offsets_[b] += offsets_[b - 1];
  entries_.resize(offsets_.back());
  std::vector<int32_t> fill(offsets_.begin(), offsets_.end() - 1);
  for (const Span& s : spans) {
    const Entry entry{float(s.from.angle), float(s.to.angle), s.first, s.count};
    ForBins(s, [&](int64_t bin) { entries_[fill[bin]++] = entry; });
  }
}

template <typename Visit>
void EpipolarIndex::VisitCrossings(const Vec3& a, double low, double high,
                                   std::vector<Crossed>* crossed, const Visit& visit) const {
  if (entries_.empty()) return;
  const double x = Dot(a, e1_), y = Dot(a, e2_), across = std::sqrt(x * x + y * y);
  if (!(across > 0)) return;
  const double angle = std::atan2(y, x);
  const float target = float(angle);
  const double along = Dot(a, axis_);
  const auto bin_of = [&](double inverse_depth) {
    return PositionBin(std::atan2(across, along + inverse_depth * baseline_));
  };
  // An entry is stored at one of its positions, so an intersection may be one bin away.
  const int64_t row = AngleBin(angle) * position_bins_;
  const int64_t from = row + std::max<int64_t>(bin_of(high) - 1, 0);
  const int64_t to = row + std::min(bin_of(low) + 1, position_bins_ - 1);
  // The epipolar line: points q with normal[0] q[0] + normal[1] q[1] + f normal[2] = 0.
  const Vec3 normal = Cross(axis_, a);
  const double constant = view_->focal() * normal[2];
  const auto side = [&](int64_t i) {
    const Vec2& p = view_->point(i);
    return normal[0] * p[0] + normal[1] * p[1] + constant;
  };
  // Without branches, which would be unpredictable.
  const int32_t end_entry = offsets_[to + 1];
  if (int64_t(crossed->size()) < end_entry - offsets_[from]) {
    crossed->resize(end_entry - offsets_[from]);
  }
  int32_t count = 0;
  for (int32_t k = offsets_[from]; k < end_entry; ++k) {
    (*crossed)[count].entry = entries_[k];
    count += (entries_[k].start < target) != (entries_[k].end < target);
  }
  // Prefetch while others are tested, since memory access is random.
  for (int32_t k = 0; k < count; ++k) {
    Crossed& c = (*crossed)[k];
    const float t = (target - c.entry.start) / (c.entry.end - c.entry.start);
    c.guess = c.entry.first + std::min(int32_t(t * float(c.entry.count)), c.entry.count - 1);
    view_->Prefetch(c.guess);
  }
  for (int32_t k = 0; k < count; ++k) {
    const Crossed& c = (*crossed)[k];
    // Search the segment at which the stretch changes sides, starting where its chord does.
    const bool start = c.entry.start < target;
    const int64_t end = c.entry.first + c.entry.count - 1;
    int64_t i = c.guess;
    double before = side(i), after = side(view_->Next(i));
    while (i < end && (after < 0) == start) before = after, after = side(view_->Next(++i));
    while (i > c.entry.first && (before < 0) != start) after = before, before = side(--i);
    visit(i, before != after ? std::clamp(before / (before - after), 0.0, 1.0) : 0.5);
  }
}

}  // namespace colmap_edges
