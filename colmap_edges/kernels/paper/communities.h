// Communities of a weighted graph by modularity: Louvain's method (Blondel et al. 2008; paper: PEC
// generation).
#pragma once

#include <algorithm>
#include <cstdint>
#include <numeric>
#include <random>
#include <utility>
#include <vector>

namespace colmap_edges {

struct WeightedLink {
  int32_t a, b;
  double weight;
};

// An undirected graph as rows of links. A link of a node with itself counts twice in its strength.
class WeightedGraph {
 public:
  WeightedGraph(int32_t num_nodes, const std::vector<WeightedLink>& links)
      : offsets_(num_nodes + 1), strengths_(num_nodes) {
    for (const WeightedLink& link : links) {
      strengths_[link.a] += link.weight, strengths_[link.b] += link.weight;
      if (link.a != link.b) ++offsets_[link.a + 1], ++offsets_[link.b + 1];
    }
    std::partial_sum(offsets_.begin(), offsets_.end(), offsets_.begin());
    neighbors_.resize(offsets_.back());
    std::vector<int64_t> next(offsets_.begin(), offsets_.end() - 1);
    for (const WeightedLink& link : links) {
      if (link.a == link.b) continue;
      neighbors_[next[link.a]++] = {link.b, link.weight};
      neighbors_[next[link.b]++] = {link.a, link.weight};
    }
  }

  int32_t num_nodes() const { return int32_t(strengths_.size()); }
  double strength(int32_t node) const { return strengths_[node]; }
  double total_strength() const {
    return std::accumulate(strengths_.begin(), strengths_.end(), 0.0);
  }

  // Calls visit(neighbor, weight) for each link of a node with another one.
  template <typename Visit>
  void VisitNeighbors(int32_t node, const Visit& visit) const {
    for (int64_t i = offsets_[node]; i < offsets_[node + 1]; ++i)
      visit(neighbors_[i].first, neighbors_[i].second);
  }

 private:
  std::vector<int64_t> offsets_;
  std::vector<double> strengths_;
  std::vector<std::pair<int32_t, double>> neighbors_;
};

// A random permutation of [0, count), the same on any platform.
inline std::vector<int32_t> RandomOrder(int32_t count, std::mt19937_64* random) {
  std::vector<int32_t> order(count);
  std::iota(order.begin(), order.end(), 0);
  for (int32_t i = count - 1; i > 0; --i) std::swap(order[i], order[(*random)() % (i + 1)]);
  return order;
}

// Starts with one community per node and moves nodes to the neighboring community that increases
// modularity most, until none does. Returns the community of each node.
inline std::vector<int32_t> MoveNodes(const WeightedGraph& graph, double resolution,
                                      std::mt19937_64* random) {
  constexpr double kMinGain = 1e-9;  // relative to the total strength; avoids cycles by rounding
  const int32_t count = graph.num_nodes();
  const double all = graph.total_strength();
  std::vector<int32_t> labels(count), touched;
  std::iota(labels.begin(), labels.end(), 0);
  std::vector<double> totals(count), shared(count);
  for (int32_t node = 0; node < count; ++node) totals[node] = graph.strength(node);
  const std::vector<int32_t> order = RandomOrder(count, random);
  for (bool moved = all > 0; moved;) {
    moved = false;
    for (const int32_t node : order) {
      const int32_t own = labels[node];
      const double strength = graph.strength(node), expected = resolution * strength / all;
      touched.assign(1, own);
      graph.VisitNeighbors(node, [&](int32_t neighbor, double weight) {
        const int32_t label = labels[neighbor];
        if (shared[label] == 0 && label != own) touched.push_back(label);
        shared[label] += weight;
      });
      totals[own] -= strength;
      int32_t best = own;
      double most = shared[own] - expected * totals[own] + kMinGain * all;
      for (const int32_t label : touched) {
        const double gain = shared[label] - expected * totals[label];
        if (gain > most) best = label, most = gain;
        shared[label] = 0;
      }
      totals[best] += strength;
      moved |= best != own;
      labels[node] = best;
    }
  }
  return labels;
}

// Renumbers labels from 0 in the order of their first nodes; returns their number.
inline int32_t Renumber(std::vector<int32_t>* labels) {
  std::vector<int32_t> numbers(labels->size(), -1);
  int32_t count = 0;
  for (int32_t& label : *labels) {
    if (numbers[label] < 0) numbers[label] = count++;
    label = numbers[label];
  }
  return count;
}

// The graph of communities; links within one become a link with itself.
inline std::vector<WeightedLink> MergedLinks(const std::vector<WeightedLink>& links,
                                             const std::vector<int32_t>& labels) {
  std::vector<WeightedLink> merged;
  for (const WeightedLink& link : links) {
    const auto [a, b] = std::minmax(labels[link.a], labels[link.b]);
    merged.push_back({a, b, link.weight});
  }
  const auto before = [](const WeightedLink& x, const WeightedLink& y) {
    return x.a != y.a ? x.a < y.a : x.b < y.b;
  };
  std::stable_sort(merged.begin(), merged.end(), before);
  size_t count = 0;
  for (const WeightedLink& link : merged) {
    if (count && merged[count - 1].a == link.a && merged[count - 1].b == link.b)
      merged[count - 1].weight += link.weight;
    else
      merged[count++] = link;
  }
  merged.resize(count);
  return merged;
}

// (num_nodes) community of each node, numbered from 0 in the order of their first nodes.
inline std::vector<int32_t> LouvainCommunities(int32_t num_nodes, std::vector<WeightedLink> links,
                                               double resolution, uint64_t seed) {
  std::mt19937_64 random(seed);
  std::vector<int32_t> result(num_nodes);
  std::iota(result.begin(), result.end(), 0);
  for (int32_t count = num_nodes;;) {
    std::vector<int32_t> labels = MoveNodes(WeightedGraph(count, links), resolution, &random);
    const int32_t merged = Renumber(&labels);
    for (int32_t& label : result) label = labels[label];
    if (merged == count) break;
    links = MergedLinks(links, labels);
    count = merged;
  }
  Renumber(&result);
  return result;
}

}  // namespace colmap_edges
