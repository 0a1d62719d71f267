// SPDX-License-Identifier: GPL-3.0-or-later
#include "conforming.h"

#include <algorithm>
#include <iterator>
#include <utility>

namespace mesher {
namespace {

using Segment = std::pair<Index, Index>;

std::vector<Segment> SegmentsOf(const Rows& polylines) {
  std::vector<Segment> segments;
  for (std::int64_t row = 0; row < polylines.size(); ++row)
    for (const Index* v = polylines.begin(row); v + 1 < polylines.end(row); ++v)
      if (v[0] != v[1]) segments.push_back(std::minmax(v[0], v[1]));
  std::sort(segments.begin(), segments.end());
  segments.erase(std::unique(segments.begin(), segments.end()), segments.end());
  return segments;
}

class Splitter {
 public:
  Splitter(double min_length, std::vector<double> radii, DelaunayBuilder& builder, Rows& rays)
      : min_length_(min_length),
        radii_(std::move(radii)),
        builder_(builder),
        rays_(rays),
        last_change_(builder.num_vertices(), 0) {}

  // Splits until no piece needs it. Insertions may break existing edges, so pieces near them are
  // tested again until none has changed. Returns the number of pieces that are not edges.
  Index Split(const std::vector<Segment>& segments) {
    std::vector<Piece> pieces;
    for (const Segment& segment : segments) pieces.push_back({segment});
    bool has_changed = true;
    while (has_changed) {
      has_changed = false;
      std::vector<Piece> next;
      for (const Piece& piece : pieces)
        if (IsKnown(piece))
          next.push_back(piece);
        else
          has_changed |= SplitOne(piece.ends, next);
      pieces.swap(next);
    }
    return static_cast<Index>(
        std::count_if(pieces.begin(), pieces.end(), [](const Piece& p) { return !p.is_edge; }));
  }

 private:
  struct Piece {
    Segment ends;
    bool is_edge = false;
    Index when = kNone;  // number of points added before `is_edge` was computed
  };

  // An insertion creates and breaks edges between neighbors of the new vertex only.
  bool IsKnown(const Piece& piece) const {
    const auto [a, b] = piece.ends;
    return piece.when != kNone && std::min(last_change_[a], last_change_[b]) <= piece.when;
  }

  // Writes the pieces of `ends` to `pieces`; returns whether a point was added.
  bool SplitOne(const Segment& ends, std::vector<Piece>& pieces) {
    const auto [a, b] = ends;
    if (builder_.IsEdge(a, b)) {
      pieces.push_back({ends, true, added_});
      return false;
    }
    const Vec3 at_a = builder_.points()[a], at_b = builder_.points()[b];
    const Index before = builder_.num_vertices();
    if (Norm(at_b - at_a) < 2 * min_length_) {
      pieces.push_back({ends, false, added_});
      return false;
    }
    const Index middle = Middle(a, b);
    const bool is_new = middle == before;
    if (middle != a && middle != b) {
      SplitOne({a, middle}, pieces);
      SplitOne({middle, b}, pieces);
    }
    return is_new;
  }

  // The vertex at the midpoint of two, or a vertex of a polyline that nearly coincides with it.
  Index Middle(Index a, Index b) {
    const Vec3 middle = 0.5 * builder_.points()[a] + 0.5 * builder_.points()[b];
    const double radius = std::min(radii_[a], radii_[b]);
    if (radius > 0) {
      const Index nearest = builder_.Nearest(middle, a);
      const bool is_near = Norm(builder_.points()[nearest] - middle) <= radius;
      if (is_near && radii_[nearest] > 0 && nearest != a && nearest != b) return nearest;
    }
    const Index before = builder_.num_vertices();
    const Index added = builder_.Insert(middle, a);
    if (added == before) {
      radii_.push_back(radius);
      last_change_.push_back(++added_);
      for (const Index neighbor : builder_.Neighbors(added)) last_change_[neighbor] = added_;
      AddRays(a, b);
    }
    return added;
  }

  void AddRays(Index a, Index b) {
    const std::vector<Index> of_a(rays_.begin(a), rays_.end(a)), of_b(rays_.begin(b), rays_.end(b));
    std::set_intersection(of_a.begin(), of_a.end(), of_b.begin(), of_b.end(),
                          std::back_inserter(rays_.values));
    rays_.offsets.push_back(static_cast<std::int64_t>(rays_.values.size()));
  }

  const double min_length_;
  std::vector<double> radii_;
  DelaunayBuilder& builder_;
  Rows& rays_;
  std::vector<Index> last_change_;  // per vertex: the last added point among its neighbors
  Index added_ = 0;
};

}  // namespace

ConformingStats Conform(const Rows& polylines, double min_length, std::vector<double> radii,
                        DelaunayBuilder& builder, Rows& rays) {
  const std::vector<Segment> segments = SegmentsOf(polylines);
  ConformingStats stats;
  stats.segments = static_cast<Index>(segments.size());
  const Index before = builder.num_vertices();
  stats.segments_missing = Splitter(min_length, std::move(radii), builder, rays).Split(segments);
  stats.points_added = builder.num_vertices() - before;
  return stats;
}

double TypicalSegmentLength(const Rows& polylines, const std::vector<Vec3>& points) {
  std::vector<double> lengths;
  for (const auto& [a, b] : SegmentsOf(polylines)) lengths.push_back(Norm(points[b] - points[a]));
  if (lengths.empty()) return 0;
  auto median = lengths.begin() + lengths.size() / 2;
  std::nth_element(lengths.begin(), median, lengths.end());
  return *median;
}

}  // namespace mesher
