// Labels of nodes by alpha expansion (Boykov, Veksler and Zabih, PAMI 2001).
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <vector>

#include "faces/max_flow.h"

namespace colmap_edges {

// What labels cost: at each node, and where they differ along an edge. There they cost the edge's
// weight, and only a part of it where the two labels' surfaces cross between the nodes.
struct LabelProblem {
  int32_t num_nodes = 0, num_labels = 0;
  std::vector<NodePair> edges;
  std::vector<double> weights;  // of the edges
  std::vector<float> costs;     // (num_nodes, num_labels); infinite where a label cannot be
  std::vector<float> depths;    // (num_nodes, num_labels); NaN of labels without a surface
  double crossing_factor = 1;   // part of the weight where surfaces cross

  double Cost(int32_t node, int32_t label) const {
    return costs[size_t(node) * num_labels + label];
  }
  double Depth(int32_t node, int32_t label) const {
    return depths[size_t(node) * num_labels + label];
  }
  // Whether the surfaces of two labels cross between the nodes of an edge.
  bool Crosses(int64_t edge, int32_t p, int32_t q) const {
    const auto& [a, b] = edges[edge];
    const double at_a = Depth(a, p) - Depth(a, q), at_b = Depth(b, p) - Depth(b, q);
    return at_a * at_b <= 0;  // false of NaN
  }
  double Between(int64_t edge, int32_t p, int32_t q) const {
    if (p == q) return 0;
    return weights[edge] * (Crosses(edge, p, q) ? crossing_factor : 1);
  }
  double Energy(const std::vector<int32_t>& labels) const {
    double sum = 0;
    for (int32_t i = 0; i < num_nodes; ++i) sum += Cost(i, labels[i]);
    for (size_t e = 0; e < edges.size(); ++e)
      sum += Between(int64_t(e), labels[edges[e][0]], labels[edges[e][1]]);
    return sum;
  }
};

class Expansion {
 public:
  explicit Expansion(const LabelProblem& problem)
      : problem_(problem),
        flow_(problem.num_nodes, problem.edges),
        is_free_(problem.num_nodes),
        change_(problem.num_nodes) {
    labels_.resize(problem.num_nodes);
    for (int32_t i = 0; i < problem.num_nodes; ++i) {
      const float* costs = problem.costs.data() + size_t(i) * problem.num_labels;
      labels_[i] = int32_t(std::min_element(costs, costs + problem.num_labels) - costs);
    }
  }

  // Begins with these labels in place of the cheapest of every node.
  void Start(const std::vector<int32_t>& labels) { labels_ = labels; }

  // Lets one label after the other take what lowers the sum, until none does or `max_sweeps`.
  const std::vector<int32_t>& Run(int max_sweeps) {
    double energy = problem_.Energy(labels_);
    int32_t unchanged = 0;
    for (int sweep = 0; sweep < max_sweeps; ++sweep) {
      for (const int32_t label : ByFrequency()) {
        if (unchanged == problem_.num_labels) return labels_;
        ++unchanged;
        std::vector<int32_t> expanded = Expanded(label);
        if (expanded == labels_) continue;
        const double lower = problem_.Energy(expanded);
        if (lower < energy - 1e-9 * std::abs(energy))
          labels_.swap(expanded), energy = lower, unchanged = 1;
      }
    }
    return labels_;
  }

 private:
  static constexpr double kUnit = 1 << 20;  // of whole-number capacities
  static constexpr double kLargest = 1e6;   // cost that stands for infinity

  static int64_t Whole(double cost) {
    const double units = kUnit * std::min(cost, kLargest);
    return int64_t(units < 0 ? units - 0.5 : units + 0.5);
  }

  std::vector<int32_t> ByFrequency() const {
    std::vector<int32_t> counts(problem_.num_labels, 0), order(problem_.num_labels);
    for (const int32_t label : labels_) ++counts[label];
    std::iota(order.begin(), order.end(), 0);
    std::stable_sort(order.begin(), order.end(),
                     [&](int32_t a, int32_t b) { return counts[a] > counts[b]; });
    return order;
  }

  // The best labels among those that are kept or become `label` (all but the best where pairs
  // of labels break the triangle inequality; the caller checks).
  std::vector<int32_t> Expanded(int32_t label) {
    free_.clear();
    for (int32_t i = 0; i < problem_.num_nodes; ++i) {
      is_free_[i] = labels_[i] != label && std::isfinite(problem_.Cost(i, label));
      if (!is_free_[i]) continue;
      free_.push_back(i);
      change_[i] = Whole(problem_.Cost(i, label)) - Whole(problem_.Cost(i, labels_[i]));
    }
    for (size_t e = 0; e < problem_.edges.size(); ++e) AddEdge(int64_t(e), label);
    // The source's side keeps, the sink's changes: an edge a -> b is cut where b alone changes.
    for (const int32_t i : free_) flow_.SetTerminal(i, change_[i]);
    flow_.Solve(free_);
    std::vector<int32_t> expanded = labels_;
    for (const int32_t i : free_)
      if (!flow_.IsSource(i)) expanded[i] = label;
    return expanded;
  }

  // What an edge costs if its free nodes keep their labels, and if they become `label`.
  void AddEdge(int64_t edge, int32_t label) {
    const auto& [a, b] = problem_.edges[edge];
    if (!is_free_[a] && !is_free_[b]) return;
    const int32_t p = labels_[a], q = labels_[b];
    const int64_t kept = Whole(problem_.Between(edge, p, q));
    if (!is_free_[b]) {
      change_[a] += Whole(problem_.Between(edge, label, q)) - kept;
      flow_.SetEdge(edge, 0, 0);
      return;
    }
    const int64_t only_b = Whole(problem_.Between(edge, p, label));
    if (!is_free_[a]) {
      change_[b] += only_b - kept;
      flow_.SetEdge(edge, 0, 0);
      return;
    }
    int64_t only_a = only_b;
    if (p != q) only_a = std::max(Whole(problem_.Between(edge, label, q)), kept - only_b);
    // kept + (only_a - kept) x_a - only_a x_b + (only_a + only_b - kept) (1 - x_a) x_b
    change_[a] += only_a - kept, change_[b] -= only_a;
    flow_.SetEdge(edge, only_a + only_b - kept, 0);
  }

  const LabelProblem& problem_;
  MaxFlow flow_;
  std::vector<int32_t> labels_;
  std::vector<int32_t> free_;  // nodes that may become the label that expands
  std::vector<uint8_t> is_free_;
  std::vector<int64_t> change_;  // cost of becoming it less that of keeping
};

}  // namespace colmap_edges
