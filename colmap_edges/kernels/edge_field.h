// The 2D edge graphs of all views in flat arrays, with a uniform grid over the chain segments of
// each view: what epipolar lines cross, and which polylines pass near a pixel.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "geometry.h"

namespace colmap_edges {

// A place on a chain: fraction in [0, 1) of the way from point `segment` to the next point; the
// last point of an open polyline is fraction 1 of its last segment.
struct ChainPosition {
  int64_t segment = -1;
  double fraction = 0;
};

// The place where a polyline comes nearest to a pixel.
struct NearPolyline {
  int32_t polyline;
  ChainPosition position;
  double distance;
};

struct Box2D {
  Vec2 min, max;
  void Include(Vec2 p) {
    min = {std::min(min.x, p.x), std::min(min.y, p.y)};
    max = {std::max(max.x, p.x), std::max(max.y, p.y)};
  }
  bool Contains(Vec2 p) const {
    return p.x >= min.x && p.x <= max.x && p.y >= min.y && p.y <= max.y;
  }
};

class EdgeField {
 public:
  // Polyline p of view polyline_views[p] (ascending) is points[offsets[p]:offsets[p + 1]].
  EdgeField(std::vector<PinholeView> views, std::vector<Vec2> points, std::vector<int64_t> offsets,
            std::vector<int32_t> polyline_views, std::vector<uint8_t> closed, double cell_px)
      : views_(std::move(views)),
        points_(std::move(points)),
        offsets_(std::move(offsets)),
        polyline_views_(std::move(polyline_views)),
        closed_(std::move(closed)),
        cell_px_(cell_px) {
    Check();
    point_polylines_.resize(points_.size());
    for (size_t p = 0; p < closed_.size(); ++p) {
      std::fill(point_polylines_.begin() + offsets_[p], point_polylines_.begin() + offsets_[p + 1],
                int32_t(p));
    }
    BuildGrids();
    BuildChunks();
  }

  const std::vector<PinholeView>& views() const { return views_; }
  const std::vector<Vec2>& points() const { return points_; }
  int64_t num_polylines() const { return int64_t(closed_.size()); }
  int32_t PolylineOf(ChainPosition at) const { return point_polylines_[at.segment]; }
  int32_t ViewOf(ChainPosition at) const { return polyline_views_[PolylineOf(at)]; }
  int32_t ViewOfPolyline(int32_t polyline) const { return polyline_views_[polyline]; }
  bool IsClosed(int32_t polyline) const { return closed_[polyline] != 0; }
  int64_t First(int32_t polyline) const { return offsets_[polyline]; }
  int64_t Last(int32_t polyline) const { return offsets_[polyline + 1] - 1; }

  // Index of the point after i on its polyline, or -1 at the end of an open one.
  int64_t Next(int64_t i) const {
    const int32_t p = point_polylines_[i];
    if (i < Last(p)) return i + 1;
    return closed_[p] && Last(p) > First(p) ? First(p) : -1;
  }
  // Index of the point before i, or -1 at the start of an open polyline.
  int64_t Previous(int64_t i) const {
    const int32_t p = point_polylines_[i];
    if (i > First(p)) return i - 1;
    return closed_[p] && Last(p) > First(p) ? Last(p) : -1;
  }

  Vec2 At(ChainPosition at) const {
    const Vec2 a = points_[at.segment], b = points_[Next(at.segment)];
    return a + at.fraction * (b - a);
  }

  // Unit direction of the chain around a position, over `reach` points to each side.
  Vec2 Tangent(ChainPosition at, int reach = 3) const {
    int64_t a = at.segment, b = Next(at.segment);
    for (int i = 1; i < reach; ++i) {
      const int64_t before = Previous(a), after = Next(b);
      if (before >= 0 && before != b) a = before;
      if (after >= 0 && after != a) b = after;
    }
    const Vec2 d = points_[b] - points_[a];
    const double norm = Norm(d);
    return norm > 0 ? (1 / norm) * d : Vec2{0, 0};
  }

  // Walks `length` px along the chain, sign +1 with its points, -1 against them. False at the end.
  bool Advance(ChainPosition from, int sign, double length, ChainPosition* to) const {
    ChainPosition at = from;
    for (int64_t guard = 0; guard <= int64_t(points_.size()); ++guard) {
      const int64_t next = Next(at.segment);
      const double segment_length = Norm(points_[next] - points_[at.segment]);
      const double left = (sign > 0 ? 1 - at.fraction : at.fraction) * segment_length;
      if (length <= left && segment_length > 0) {
        *to = {at.segment, at.fraction + sign * length / segment_length};
        to->fraction = std::clamp(to->fraction, 0.0, 1.0);
        return true;
      }
      length -= left;
      const int64_t segment = sign > 0 ? next : Previous(at.segment);
      if (segment < 0 || Next(segment) < 0) return false;
      at = {segment, sign > 0 ? 0.0 : 1.0};
    }
    return false;
  }

  // First place where the chain crosses the line when walking from `from` by at most `reach` px.
  bool FirstCrossing(ChainPosition from, int sign, const Line2D& line, double reach,
                     ChainPosition* to) const {
    int64_t segment = from.segment;
    double begin = from.fraction, walked = 0;
    for (int64_t guard = 0; guard <= int64_t(points_.size()) && walked <= reach; ++guard) {
      const int64_t next = Next(segment);
      const Vec2 a = points_[segment], b = points_[next];
      double t;
      if (CrossingFraction(line, a, b, &t) && (sign > 0 ? t > begin : t < begin)) {
        if (walked + std::abs(t - begin) * Norm(b - a) > reach) return false;
        *to = {segment, t};
        return true;
      }
      walked += std::abs((sign > 0 ? 1 : 0) - begin) * Norm(b - a);
      segment = sign > 0 ? next : Previous(segment);
      if (segment < 0 || Next(segment) < 0) return false;
      begin = sign > 0 ? -1e-12 : 1 + 1e-12;
    }
    return false;
  }

  // All places inside `box` where the chains of a view cross the line, by ascending segment.
  void IntersectLine(int32_t view, const Line2D& line, const Box2D& box,
                     std::vector<ChainPosition>* crossings) const {
    crossings->clear();
    std::vector<int64_t>& segments = Scratch();
    segments.clear();
    const Grid& grid = grids_[view];
    const bool steep = std::abs(line.a) > std::abs(line.b);
    // Columns of cells across the line's main direction, and the cells it passes in each.
    const double low =
        steep ? std::max(box.min.y, grid.origin.y) : std::max(box.min.x, grid.origin.x);
    const double high = steep ? std::min(box.max.y, grid.origin.y + grid.rows * cell_px_)
                              : std::min(box.max.x, grid.origin.x + grid.columns * cell_px_);
    if (!(low <= high)) return;
    const double start = steep ? grid.origin.y : grid.origin.x;
    const double side = steep ? grid.origin.x : grid.origin.y;
    const int64_t num_main = steep ? grid.rows : grid.columns;
    const int64_t num_side = steep ? grid.columns : grid.rows;
    const double slope = steep ? -line.b / line.a : -line.a / line.b;
    const double offset = steep ? -line.c / line.a : -line.c / line.b;
    const int64_t m0 = CellIndex(low - start, num_main), m1 = CellIndex(high - start, num_main);
    for (int64_t m = m0; m <= m1; ++m) {
      const double s0 = offset + slope * (start + m * cell_px_) - side;
      const double s1 = offset + slope * (start + (m + 1) * cell_px_) - side;
      const double margin = 1e-6 * cell_px_;
      const double below = std::min(s0, s1) - margin, above = std::max(s0, s1) + margin;
      if (above < 0 || below > num_side * cell_px_) continue;
      const int64_t k0 = CellIndex(below, num_side), k1 = CellIndex(above, num_side);
      for (int64_t k = k0; k <= k1; ++k) {
        const int64_t cell = steep ? m * grid.columns + k : k * grid.columns + m;
        for (int64_t e = grid.starts[cell]; e < grid.starts[cell + 1]; ++e) {
          const int64_t i = grid.segments[e];
          double t;
          if (CrossingFraction(line, points_[i], points_[Next(i)], &t)) segments.push_back(i);
        }
      }
    }
    std::sort(segments.begin(), segments.end());
    segments.erase(std::unique(segments.begin(), segments.end()), segments.end());
    for (const int64_t i : segments) {
      ChainPosition at{i, 0};
      CrossingFraction(line, points_[i], points_[Next(i)], &at.fraction);
      if (box.Contains(At(at))) crossings->push_back(at);
    }
  }

  // All places inside `box` where one polyline crosses the line, appended by ascending segment.
  void IntersectPolyline(int32_t polyline, const Line2D& line, const Box2D& box,
                         std::vector<ChainPosition>* crossings) const {
    for (int64_t k = chunk_offsets_[polyline]; k < chunk_offsets_[polyline + 1]; ++k) {
      const Box2D& bounds = chunk_boxes_[k];
      const Vec2 half = 0.5 * (bounds.max - bounds.min);
      const double distance = line.SignedDistance(bounds.min + half);
      if (std::abs(distance) > std::abs(line.a) * half.x + std::abs(line.b) * half.y + 1e-6 ||
          bounds.min.x > box.max.x || bounds.max.x < box.min.x || bounds.min.y > box.max.y ||
          bounds.max.y < box.min.y) {
        continue;
      }
      const int64_t first = First(polyline) + (k - chunk_offsets_[polyline]) * kChunk;
      const int64_t last = std::min(first + kChunk - 1, Last(polyline));
      for (int64_t i = first; i <= last; ++i) {
        const int64_t next = Next(i);
        ChainPosition at{i, 0};
        if (next >= 0 && CrossingFraction(line, points_[i], points_[next], &at.fraction) &&
            box.Contains(At(at))) {
          crossings->push_back(at);
        }
      }
    }
  }

  // For each polyline of the view within `radius` px of the pixel the nearest place on it, by
  // ascending polyline.
  void FindNear(int32_t view, Vec2 pixel, double radius, std::vector<NearPolyline>* found) const {
    found->clear();
    const Grid& grid = grids_[view];
    const Vec2 p = pixel - grid.origin;
    if (grid.segments.empty() || !(std::isfinite(p.x) && std::isfinite(p.y))) return;
    if (p.x + radius < 0 || p.y + radius < 0 || p.x - radius > grid.columns * cell_px_ ||
        p.y - radius > grid.rows * cell_px_) {
      return;
    }
    const int64_t x0 = CellIndex(p.x - radius, grid.columns);
    const int64_t x1 = CellIndex(p.x + radius, grid.columns);
    const int64_t y0 = CellIndex(p.y - radius, grid.rows);
    const int64_t y1 = CellIndex(p.y + radius, grid.rows);
    for (int64_t y = y0; y <= y1; ++y) {
      for (int64_t x = x0; x <= x1; ++x) {
        const int64_t cell = y * grid.columns + x;
        for (int64_t e = grid.starts[cell]; e < grid.starts[cell + 1]; ++e) {
          Consider(grid.segments[e], pixel, radius, found);
        }
      }
    }
    std::sort(found->begin(), found->end(),
              [](const NearPolyline& a, const NearPolyline& b) { return a.polyline < b.polyline; });
  }

 private:
  struct Grid {
    Vec2 origin;
    int64_t columns = 0, rows = 0;
    std::vector<int64_t> starts, segments;  // CSR of segments by cell
  };

  static std::vector<int64_t>& Scratch() {
    thread_local std::vector<int64_t> scratch;
    return scratch;
  }

  // Where the line crosses a-b, as a fraction in [0, 1); a vertex belongs to one segment only.
  static bool CrossingFraction(const Line2D& line, Vec2 a, Vec2 b, double* fraction) {
    const double s0 = line.SignedDistance(a), s1 = line.SignedDistance(b);
    if ((s0 < 0) == (s1 < 0)) return false;
    *fraction = s0 / (s0 - s1);
    return true;
  }

  void Consider(int64_t i, Vec2 pixel, double radius, std::vector<NearPolyline>* found) const {
    const Vec2 a = points_[i], b = points_[Next(i)];
    if (std::min(a.x, b.x) > pixel.x + radius || std::max(a.x, b.x) < pixel.x - radius ||
        std::min(a.y, b.y) > pixel.y + radius || std::max(a.y, b.y) < pixel.y - radius) {
      return;
    }
    const Vec2 d = b - a;
    const double length2 = Dot(d, d);
    const double t = length2 > 0 ? std::clamp(Dot(pixel - a, d) / length2, 0.0, 1.0) : 0;
    const double distance = Norm(a + t * d - pixel);
    if (distance > radius) return;
    const int32_t polyline = point_polylines_[i];
    for (NearPolyline& near : *found) {
      if (near.polyline != polyline) continue;
      if (distance < near.distance || (distance == near.distance && i < near.position.segment)) {
        near = {polyline, {i, t}, distance};
      }
      return;
    }
    found->push_back({polyline, {i, t}, distance});
  }

  int64_t CellIndex(double offset, int64_t count) const {
    return int64_t(std::clamp(std::floor(offset / cell_px_), 0.0, double(count - 1)));
  }

  void Check() const {
    if (!(cell_px_ > 0)) throw std::invalid_argument("cell_px must be positive");
    const size_t count = closed_.size();
    if (offsets_.size() != count + 1 || polyline_views_.size() != count || offsets_[0] != 0 ||
        offsets_[count] != int64_t(points_.size())) {
      throw std::invalid_argument("polyline arrays disagree in length");
    }
    for (size_t p = 0; p < count; ++p) {
      if (offsets_[p + 1] < offsets_[p]) throw std::invalid_argument("offsets must not decrease");
      if (polyline_views_[p] < 0 || polyline_views_[p] >= int64_t(views_.size()) ||
          (p > 0 && polyline_views_[p] < polyline_views_[p - 1])) {
        throw std::invalid_argument("polyline_views must ascend within the number of views");
      }
    }
    for (const Vec2& p : points_) {
      if (!std::isfinite(p.x) || !std::isfinite(p.y)) {
        throw std::invalid_argument("edge points must be finite");
      }
    }
  }

  void BuildGrids() {
    grids_.resize(views_.size());
    size_t p = 0;
    for (size_t v = 0; v < views_.size(); ++v) {
      const int64_t first = p < closed_.size() ? offsets_[p] : int64_t(points_.size());
      while (p < closed_.size() && polyline_views_[p] == int64_t(v)) ++p;
      BuildGrid(first, p < closed_.size() ? offsets_[p] : int64_t(points_.size()), &grids_[v]);
    }
  }

  // Bounding boxes of runs of kChunk segments of each polyline.
  void BuildChunks() {
    chunk_offsets_ = {0};
    for (int32_t p = 0; p < num_polylines(); ++p) {
      for (int64_t first = First(p); first <= Last(p); first += kChunk) {
        Box2D box{points_[first], points_[first]};
        for (int64_t i = first; i <= std::min(first + kChunk - 1, Last(p)); ++i) {
          for (const int64_t end : {i, Next(i)}) {
            if (end >= 0) box.Include(points_[end]);
          }
        }
        chunk_boxes_.push_back(box);
      }
      chunk_offsets_.push_back(int64_t(chunk_boxes_.size()));
    }
  }

  template <typename Visit>
  void ForEachCell(const Grid& grid, int64_t i, const Visit& visit) const {
    const Vec2 a = points_[i] - grid.origin, b = points_[Next(i)] - grid.origin;
    const int64_t x0 = CellIndex(std::min(a.x, b.x), grid.columns);
    const int64_t x1 = CellIndex(std::max(a.x, b.x), grid.columns);
    const int64_t y0 = CellIndex(std::min(a.y, b.y), grid.rows);
    const int64_t y1 = CellIndex(std::max(a.y, b.y), grid.rows);
    for (int64_t y = y0; y <= y1; ++y) {
      for (int64_t x = x0; x <= x1; ++x) visit(y * grid.columns + x);
    }
  }

  void BuildGrid(int64_t first, int64_t last, Grid* grid) const {
    constexpr double kInf = std::numeric_limits<double>::infinity();
    Box2D box{{kInf, kInf}, {-kInf, -kInf}};
    for (int64_t i = first; i < last; ++i) {
      box.Include(points_[i]);
    }
    if (first == last) box = {{0, 0}, {0, 0}};
    grid->origin = box.min;
    grid->columns = int64_t((box.max.x - box.min.x) / cell_px_) + 1;
    grid->rows = int64_t((box.max.y - box.min.y) / cell_px_) + 1;
    grid->starts.assign(grid->columns * grid->rows + 1, 0);
    for (int64_t i = first; i < last; ++i) {
      if (Next(i) >= 0) ForEachCell(*grid, i, [&](int64_t cell) { ++grid->starts[cell + 1]; });
    }
    for (size_t c = 1; c < grid->starts.size(); ++c) grid->starts[c] += grid->starts[c - 1];
    grid->segments.resize(grid->starts.back());
    std::vector<int64_t> filled(grid->starts.begin(), grid->starts.end() - 1);
    for (int64_t i = first; i < last; ++i) {
      if (Next(i) < 0) continue;
      ForEachCell(*grid, i, [&](int64_t cell) { grid->segments[filled[cell]++] = i; });
    }
  }

  std::vector<PinholeView> views_;
  std::vector<Vec2> points_;
  std::vector<int64_t> offsets_;
  std::vector<int32_t> polyline_views_;
  std::vector<uint8_t> closed_;
  double cell_px_;
  std::vector<int32_t> point_polylines_;
  std::vector<Grid> grids_;
  static constexpr int64_t kChunk = 32;
  std::vector<int64_t> chunk_offsets_;  // CSR of chunks by polyline
  std::vector<Box2D> chunk_boxes_;
};

}  // namespace colmap_edges
