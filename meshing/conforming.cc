// SPDX-License-Identifier: GPL-3.0-or-later
#include "conforming.h"

#include <algorithm>
#include <iterator>
#include <tuple>
#include <utility>

namespace mesher {
namespace {

class Splitter {
 public:
  Splitter(double min_length, std::vector<double> radii, DelaunayBuilder& builder, Rows& rays)
      : min_length_(min_length),
        radii_(std::move(radii)),
        builder_(builder),
        rays_(rays),
        last_change_(builder.num_vertices(), 0) {}

  // Splits until no piece needs it. Insertions may break existing edges, so pieces near them are
  // tested again until none has changed.
  void Split(Conforming& result) {
    std::vector<Tested> pieces;
    for (const Piece& piece : result.pieces) pieces.push_back({piece});
    bool has_changed = true;
    while (has_changed) {
      has_changed = false;
      std::vector<Tested> next;
      for (const Tested& tested : pieces)
        if (IsKnown(tested))
          next.push_back(tested);
        else
          has_changed |= SplitOne(tested.piece, next);
      pieces.swap(next);
    }
    result.pieces.clear();
    for (const Tested& tested : pieces) {
      result.pieces.push_back(tested.piece);
      result.segments_missing += !tested.is_edge;
    }
  }

 private:
  struct Tested {
    Piece piece;
    bool is_edge = false;
    Index when = kNone;  // number of points added before `is_edge` was computed
  };

  // An insertion creates and breaks edges between neighbors of the new vertex only.
  bool IsKnown(const Tested& tested) const {
    const auto [a, b, row] = tested.piece;
    return tested.when != kNone && std::min(last_change_[a], last_change_[b]) <= tested.when;
  }

  // Writes the parts of `piece` to `pieces`; returns whether a point was added.
  bool SplitOne(const Piece& piece, std::vector<Tested>& pieces) {
    const auto [a, b, row] = piece;
    if (builder_.IsEdge(a, b)) {
      pieces.push_back({piece, true, added_});
      return false;
    }
    const Vec3 at_a = builder_.points()[a], at_b = builder_.points()[b];
    const Index before = builder_.num_vertices();
    if (Norm(at_b - at_a) < 2 * min_length_) {
      pieces.push_back({piece, false, added_});
      return false;
    }
    const Index middle = Middle(a, b);
    const bool is_new = middle == before;
    if (middle != a && middle != b) {
      SplitOne({std::min(a, middle), std::max(a, middle), row}, pieces);
      SplitOne({std::min(middle, b), std::max(middle, b), row}, pieces);
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

std::vector<Piece> PiecesOf(const Rows& polylines) {
  std::vector<Piece> pieces;
  for (Index row = 0; row < polylines.size(); ++row)
    for (const Index* v = polylines.begin(row); v + 1 < polylines.end(row); ++v)
      if (v[0] != v[1]) pieces.push_back({std::min(v[0], v[1]), std::max(v[0], v[1]), row});
  std::sort(pieces.begin(), pieces.end(), [](const Piece& p, const Piece& q) {
    return std::tie(p.a, p.b, p.row) < std::tie(q.a, q.b, q.row);
  });
  const auto is_same = [](const Piece& p, const Piece& q) { return p.a == q.a && p.b == q.b; };
  pieces.erase(std::unique(pieces.begin(), pieces.end(), is_same), pieces.end());
  return pieces;
}

Conforming Conform(const Rows& polylines, double min_length, std::vector<double> radii,
                   DelaunayBuilder& builder, Rows& rays) {
  Conforming result{PiecesOf(polylines)};
  result.segments = static_cast<Index>(result.pieces.size());
  const Index before = builder.num_vertices();
  Splitter(min_length, std::move(radii), builder, rays).Split(result);
  result.points_added = builder.num_vertices() - before;
  return result;
}

double TypicalSegmentLength(const Rows& polylines, const std::vector<Vec3>& points) {
  std::vector<double> lengths;
  for (const Piece& piece : PiecesOf(polylines))
    lengths.push_back(Norm(points[piece.b] - points[piece.a]));
  if (lengths.empty()) return 0;
  auto median = lengths.begin() + lengths.size() / 2;
  std::nth_element(lengths.begin(), median, lengths.end());
  return *median;
}

}  // namespace mesher
