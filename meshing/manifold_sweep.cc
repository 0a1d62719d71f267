// SPDX-License-Identifier: GPL-3.0-or-later
#include "manifold_sweep.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <queue>

namespace mesher {
namespace {

// Cost in votes of opening a solid cell, in addition to its missing votes, since there can be more
// solid cells without votes behind it.
constexpr double kOpeningCost = 8;
constexpr int kMaxFlips = 32;

// Cells around a vertex with one label, connected through facets: cells [begin, end) of `Fans`.
struct Fan {
  bool is_free;
  std::size_t begin, end;
};

// Finds the fans around vertices. Entries are indices into the values of `Triangulation::stars`.
class FanFinder {
 public:
  explicit FanFinder(const Triangulation& triangulation)
      : triangulation_(triangulation),
        entries_(4 * triangulation.cells.size()),
        stamps_(triangulation.stars.values.size()) {
    const Rows& stars = triangulation.stars;
    for (Index v = 0; v < triangulation.num_vertices(); ++v)
      for (auto e = stars.offsets[v]; e < stars.offsets[v + 1]; ++e)
        EntryOf(stars.values[e], v) = e;
  }

  // Ordered by their lowest cell. Valid until the next call.
  const std::vector<Fan>& Find(Index vertex, const std::vector<std::uint8_t>& is_free) {
    const Rows& stars = triangulation_.stars;
    fans_.clear(), cells_.clear();
    ++stamp_;
    for (auto e = stars.offsets[vertex]; e < stars.offsets[vertex + 1]; ++e) {
      if (stamps_[e] == stamp_) continue;
      const std::size_t begin = cells_.size();
      stamps_[e] = stamp_;
      cells_.push_back(stars.values[e]);
      for (std::size_t i = begin; i < cells_.size(); ++i) AddNeighbors(vertex, cells_[i], is_free);
      fans_.push_back({is_free[stars.values[e]] != 0, begin, cells_.size()});
    }
    return fans_;
  }

  const std::vector<Index>& cells() const { return cells_; }

  // Whether there is at most one fan per label.
  bool IsRegular(Index vertex, const std::vector<std::uint8_t>& is_free) {
    const auto& fans = Find(vertex, is_free);
    return fans.size() < 2 || (fans.size() == 2 && fans[0].is_free != fans[1].is_free);
  }

 private:
  std::int64_t& EntryOf(Index cell, Index vertex) {
    return entries_[4 * std::size_t(cell) + triangulation_.cells[cell].SlotOf(vertex)];
  }

  void AddNeighbors(Index vertex, Index c, const std::vector<std::uint8_t>& is_free) {
    const Cell& cell = triangulation_.cells[c];
    for (int i = 0; i < 4; ++i) {
      const Index next = cell.neighbors[i];
      if (cell.vertices[i] == vertex || is_free[next] != is_free[c]) continue;
      std::uint32_t& stamp = stamps_[EntryOf(next, vertex)];
      if (stamp != stamp_) cells_.push_back(next);
      stamp = stamp_;
    }
  }

  const Triangulation& triangulation_;
  std::vector<std::int64_t> entries_;  // of the corners of cells
  std::vector<std::uint32_t> stamps_;  // per entry: the last search that reached it
  std::uint32_t stamp_ = 0;
  std::vector<Fan> fans_;
  std::vector<Index> cells_;
};

class Sweep {
 public:
  Sweep(const Triangulation& triangulation, const std::vector<double>& votes)
      : triangulation_(triangulation),
        votes_(votes),
        finder_(triangulation),
        is_free_(votes.size()),
        flips_(votes.size()) {
    for (std::size_t c = 0; c < votes.size(); ++c) is_free_[c] = IsVoted(c);
  }

  ManifoldRegion Run() {
    RepairVertices();
    FollowVotes();
    ManifoldRegion region;
    for (Index c = 0; c < triangulation_.num_cells(); ++c) {
      region.cells_closed += IsVoted(c) && !is_free_[c];
      region.cells_opened += !IsVoted(c) && is_free_[c];
    }
    region.is_free = std::move(is_free_);
    return region;
  }

 private:
  bool IsVoted(Index cell) const { return votes_[cell] >= 0; }

  // Votes lost by changing the label of a cell.
  double Cost(Index cell) const {
    const double gain = IsVoted(cell) ? votes_[cell] : votes_[cell] - kOpeningCost;
    return is_free_[cell] ? gain : -gain;
  }

  bool IsLocked(Index cell) const { return !is_free_[cell] && flips_[cell] >= kMaxFlips; }

  void RepairVertices() {
    std::queue<Index> waiting;
    std::vector<std::uint8_t> is_waiting(triangulation_.points.size(), 1);
    for (Index v = 0; v < triangulation_.num_vertices(); ++v) waiting.push(v);
    while (!waiting.empty()) {
      const Index v = waiting.front();
      waiting.pop();
      is_waiting[v] = 0;
      while (!finder_.IsRegular(v, is_free_)) {
        const Fan fan = CheapestFan(v);
        for (std::size_t i = fan.begin; i < fan.end; ++i) {
          const Index c = finder_.cells()[i];
          is_free_[c] ^= 1;
          ++flips_[c];
          for (Index w : triangulation_.cells[c].vertices)
            if (w != kInfinite && w != v && !is_waiting[w]) is_waiting[w] = 1, waiting.push(w);
        }
      }
    }
  }

  // The fan to flip around a critical vertex, whose fans were just found. Each label keeps its last
  // fan, unless all others are locked; then a free fan, which is never locked, becomes solid.
  Fan CheapestFan(Index vertex) {
    const std::vector<Fan>& fans = finder_.Find(vertex, is_free_);
    const auto num_free =
        std::count_if(fans.begin(), fans.end(), [](auto& f) { return f.is_free; });
    const bool may_flip[2] = {std::int64_t(fans.size()) - num_free > 1, num_free > 1};
    const Fan* best = nullptr;
    double best_cost = std::numeric_limits<double>::infinity();
    for (const bool any_free : {false, true}) {
      for (const Fan& fan : fans) {
        if (!may_flip[fan.is_free] && !(any_free && fan.is_free)) continue;
        const double cost = Cost(fan);
        if (cost < best_cost) best = &fan, best_cost = cost;
      }
      if (best) break;
    }
    return *best;
  }

  double Cost(const Fan& fan) const {
    double cost = 0;
    for (std::size_t i = fan.begin; i < fan.end; ++i) {
      const Index c = finder_.cells()[i];
      if (IsLocked(c)) return std::numeric_limits<double>::infinity();
      cost += Cost(c) + double(flips_[c]) * flips_[c];
    }
    return cost;
  }

  // Changes cells to the labels of their votes, those of most votes first, where the boundary stays
  // a manifold.
  void FollowVotes() {
    std::vector<Index> ranks(votes_.size()), by_rank(votes_.size());
    std::iota(by_rank.begin(), by_rank.end(), 0);
    std::stable_sort(by_rank.begin(), by_rank.end(),
                     [&](Index a, Index b) { return std::abs(votes_[a]) > std::abs(votes_[b]); });
    for (Index rank = 0; rank < triangulation_.num_cells(); ++rank) ranks[by_rank[rank]] = rank;
    std::priority_queue<Index, std::vector<Index>, std::greater<Index>> waiting;
    auto push = [&](Index cell) {
      if (bool(is_free_[cell]) != IsVoted(cell)) waiting.push(ranks[cell]);
    };
    for (Index c = 0; c < triangulation_.num_cells(); ++c) push(c);
    while (!waiting.empty()) {
      const Index c = by_rank[waiting.top()];
      waiting.pop();
      if (bool(is_free_[c]) == IsVoted(c) || !FlipIfManifold(c)) continue;
      for (Index v : triangulation_.cells[c].vertices)
        if (v != kInfinite)
          std::for_each(triangulation_.stars.begin(v), triangulation_.stars.end(v), push);
    }
  }

  bool FlipIfManifold(Index cell) {
    const auto& vertices = triangulation_.cells[cell].vertices;
    is_free_[cell] ^= 1;
    const bool is_manifold = std::all_of(vertices.begin(), vertices.end(), [&](Index v) {
      return v == kInfinite || finder_.IsRegular(v, is_free_);
    });
    if (!is_manifold) is_free_[cell] ^= 1;
    return is_manifold;
  }

  const Triangulation& triangulation_;
  const std::vector<double>& votes_;
  FanFinder finder_;
  std::vector<std::uint8_t> is_free_;
  std::vector<int> flips_;
};

}  // namespace

ManifoldRegion SweepManifold(const Triangulation& triangulation, const std::vector<double>& votes) {
  return Sweep(triangulation, votes).Run();
}

bool IsRegular(const Triangulation& triangulation, const std::vector<std::uint8_t>& region,
               Index vertex) {
  return FanFinder(triangulation).IsRegular(vertex, region);
}

}  // namespace mesher
