// SPDX-License-Identifier: GPL-3.0-or-later
#include "manifold_growth.h"

#include <algorithm>
#include <numeric>
#include <queue>

namespace mesher {
namespace {

class Grower {
 public:
  Grower(const Triangulation& triangulation, const std::vector<double>& votes,
         const std::vector<std::uint8_t>& is_free)
      : triangulation_(triangulation),
        is_free_(is_free),
        region_(triangulation.cells.size()),
        ranks_(triangulation.cells.size()) {
    by_rank_.resize(triangulation.cells.size());
    std::iota(by_rank_.begin(), by_rank_.end(), 0);
    std::stable_sort(by_rank_.begin(), by_rank_.end(),
                     [&](Index a, Index b) { return votes[a] > votes[b]; });
    for (Index rank = 0; rank < triangulation.num_cells(); ++rank) ranks_[by_rank_[rank]] = rank;
  }

  std::vector<std::uint8_t> Grow() {
    for (Index seed : by_rank_) {
      if (!is_free_[seed] || region_[seed] || TouchesRegion(seed)) continue;
      region_[seed] = 1;
      PushNeighbors(seed);
      do GrowByCells();
      while (GrowByStars());
    }
    return std::move(region_);
  }

 private:
  bool TouchesRegion(Index seed) const {
    for (Index v : triangulation_.cells[seed].vertices) {
      if (v == kInfinite) continue;
      const auto& stars = triangulation_.stars;
      if (std::any_of(stars.begin(v), stars.end(v), [&](Index c) { return region_[c]; }))
        return true;
    }
    return false;
  }

  void PushNeighbors(Index cell) {
    for (Index neighbor : triangulation_.cells[cell].neighbors)
      if (is_free_[neighbor] && !region_[neighbor]) queue_.push(ranks_[neighbor]);
  }

  // Adds all cells if the boundary stays a manifold, or none.
  bool TryAdd(const std::vector<Index>& cells) {
    std::vector<Index> vertices;
    for (Index c : cells) {
      region_[c] = 1;
      for (Index v : triangulation_.cells[c].vertices)
        if (v != kInfinite) vertices.push_back(v);
    }
    std::sort(vertices.begin(), vertices.end());
    vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
    const bool is_manifold = std::all_of(vertices.begin(), vertices.end(), [&](Index v) {
      return IsRegular(triangulation_, region_, v);
    });
    for (Index c : cells) region_[c] = is_manifold;
    if (is_manifold)
      for (Index c : cells) PushNeighbors(c);
    return is_manifold;
  }

  void GrowByCells() {
    std::vector<Index> one(1);
    while (!queue_.empty()) {
      one[0] = by_rank_[queue_.top()];
      queue_.pop();
      if (!region_[one[0]]) TryAdd(one);
    }
  }

  bool GrowByStars() {
    bool has_grown = false;
    std::vector<Index> missing;
    for (Index v = 0; v < triangulation_.num_vertices(); ++v) {
      missing.clear();
      bool is_reached = false;
      const auto& stars = triangulation_.stars;
      for (const Index* c = stars.begin(v); c != stars.end(v); ++c) {
        is_reached |= region_[*c] != 0;
        if (is_free_[*c] && !region_[*c]) missing.push_back(*c);
      }
      if (is_reached && !missing.empty() && TryAdd(missing)) has_grown = true;
    }
    return has_grown;
  }

  const Triangulation& triangulation_;
  const std::vector<std::uint8_t>& is_free_;
  std::vector<std::uint8_t> region_;
  std::vector<Index> ranks_, by_rank_;  // the most voted cell has rank 0
  std::priority_queue<Index, std::vector<Index>, std::greater<Index>> queue_;
};

}  // namespace

bool IsRegular(const Triangulation& triangulation, const std::vector<std::uint8_t>& region,
               Index vertex) {
  const Index* begin = triangulation.stars.begin(vertex);
  const Index* end = triangulation.stars.end(vertex);  // ascending
  std::vector<std::uint8_t> is_reached(end - begin);
  std::vector<Index> stack;
  bool has_component[2] = {false, false};
  for (const Index* seed = begin; seed != end; ++seed) {
    if (is_reached[seed - begin]) continue;
    const bool side = region[*seed];
    if (has_component[side]) return false;
    has_component[side] = true;
    is_reached[seed - begin] = 1;
    stack.push_back(*seed);
    while (!stack.empty()) {
      const Cell& cell = triangulation.cells[stack.back()];
      stack.pop_back();
      for (int i = 0; i < 4; ++i) {
        const Index next = cell.neighbors[i];
        if (cell.vertices[i] == vertex || bool(region[next]) != side) continue;
        const auto place = std::lower_bound(begin, end, next) - begin;
        if (is_reached[place]) continue;
        is_reached[place] = 1;
        stack.push_back(next);
      }
    }
  }
  return true;
}

std::vector<std::uint8_t> GrowManifold(const Triangulation& triangulation,
                                       const std::vector<double>& votes,
                                       const std::vector<std::uint8_t>& is_free) {
  return Grower(triangulation, votes, is_free).Grow();
}

}  // namespace mesher
