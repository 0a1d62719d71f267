// Smaller problems in place of one: nodes taken together, and only some nodes free.
#pragma once

#include <algorithm>
#include <cstdint>
#include <utility>
#include <vector>

#include "faces/expansion.h"

namespace colmap_edges {

// The problem of giving all nodes of a block the same label; `blocks`: of the nodes, from 0 on.
// Surfaces of a block lie at the mean of its nodes' depths.
inline LabelProblem Contracted(const LabelProblem& problem, const std::vector<int32_t>& blocks,
                               int32_t num_blocks) {
  const size_t num_labels = problem.num_labels;
  LabelProblem made;
  made.num_nodes = num_blocks, made.num_labels = problem.num_labels;
  made.crossing_factor = problem.crossing_factor;
  made.costs.assign(num_blocks * num_labels, 0), made.depths.assign(num_blocks * num_labels, 0);
  std::vector<float> sizes(num_blocks, 0);
  for (const int32_t block : blocks) ++sizes[block];
  for (size_t i = 0; i < blocks.size(); ++i) {
    const size_t from = i * num_labels, to = blocks[i] * num_labels;
    for (size_t k = 0; k < num_labels; ++k) {
      made.costs[to + k] += problem.costs[from + k];
      made.depths[to + k] += problem.depths[from + k] / sizes[blocks[i]];
    }
  }
  std::vector<std::pair<NodePair, double>> edges;
  for (size_t e = 0; e < problem.edges.size(); ++e) {
    NodePair pair{blocks[problem.edges[e][0]], blocks[problem.edges[e][1]]};
    if (pair[0] == pair[1]) continue;
    if (pair[0] > pair[1]) std::swap(pair[0], pair[1]);
    edges.emplace_back(pair, problem.weights[e]);
  }
  std::stable_sort(edges.begin(), edges.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  for (const auto& [pair, weight] : edges) {
    if (made.edges.empty() || made.edges.back() != pair)
      made.edges.push_back(pair), made.weights.push_back(0);
    made.weights.back() += weight;
  }
  return made;
}

// The problem of some nodes, in ascending order, while all others keep their labels. Surfaces do
// not cross on the way to those.
inline LabelProblem Restricted(const LabelProblem& problem, const std::vector<int32_t>& nodes,
                               const std::vector<int32_t>& labels) {
  const size_t num_labels = problem.num_labels;
  LabelProblem made;
  made.num_nodes = int32_t(nodes.size()), made.num_labels = problem.num_labels;
  made.crossing_factor = problem.crossing_factor;
  std::vector<int32_t> rows(problem.num_nodes, -1);
  for (size_t i = 0; i < nodes.size(); ++i) {
    rows[nodes[i]] = int32_t(i);
    const auto first = ptrdiff_t(nodes[i] * num_labels), last = first + ptrdiff_t(num_labels);
    made.costs.insert(made.costs.end(), problem.costs.begin() + first,
                      problem.costs.begin() + last);
    made.depths.insert(made.depths.end(), problem.depths.begin() + first,
                       problem.depths.begin() + last);
  }
  for (size_t e = 0; e < problem.edges.size(); ++e) {
    const auto& [a, b] = problem.edges[e];
    if (rows[a] >= 0 && rows[b] >= 0) {
      made.edges.push_back({rows[a], rows[b]}), made.weights.push_back(problem.weights[e]);
    } else if (rows[a] >= 0 || rows[b] >= 0) {
      const size_t row = rows[a] >= 0 ? rows[a] : rows[b];
      const int32_t kept = labels[rows[a] >= 0 ? b : a];
      for (int32_t k = 0; k < problem.num_labels; ++k)
        if (k != kept) made.costs[row * num_labels + k] += float(problem.weights[e]);
    }
  }
  return made;
}

}  // namespace colmap_edges
