// A view for each triangle, so that neighbours have the same: the sum of costs of triangles and of
// pairs with different views is lowered by tree-reweighted message passing (Kolmogorov, Convergent
// tree-reweighted message passing for energy minimization, PAMI 2006) over candidates.
#pragma once

#include <algorithm>
#include <cstdint>
#include <limits>
#include <vector>

namespace colmap_edges {

// Candidates of node i are those from offsets[i] to offsets[i + 1]; their labels ascend.
struct LabelCandidates {
  const int64_t* offsets;
  const int32_t* labels;
  const double* costs;
  int64_t num_nodes;
  const int32_t* pairs;  // (E, 2) neighbours
  int64_t num_pairs;
};

class ViewLabelling {
 public:
  ViewLabelling(const LabelCandidates& given, double weight) : given_(given), weight_(weight) {
    const int64_t n = given.num_nodes;
    arc_offsets_.assign(n + 1, 0);
    for (int64_t e = 0; e < 2 * given.num_pairs; ++e) ++arc_offsets_[given.pairs[e] + 1];
    for (int64_t i = 0; i < n; ++i) arc_offsets_[i + 1] += arc_offsets_[i];
    arcs_.resize(2 * given.num_pairs);
    std::vector<int64_t> fill(arc_offsets_.begin(), arc_offsets_.end() - 1);
    int64_t total = 0;
    for (int64_t e = 0; e < given.num_pairs; ++e) {
      const int32_t a = given.pairs[2 * e], b = given.pairs[2 * e + 1];
      const int64_t at = fill[a]++, other = fill[b]++;
      arcs_[at] = {b, other, total}, total += Count(a);
      arcs_[other] = {a, at, total}, total += Count(b);
    }
    messages_.assign(total, 0.f);
    for (int64_t i = 0; i < n; ++i) most_ = std::max(most_, Count(i));
    sums_.resize(most_), rest_.resize(most_);
  }

  // The index of each node's candidate, or -1 of nodes without any.
  std::vector<int32_t> Run(int num_sweeps) {
    for (int sweep = 0; sweep < num_sweeps; ++sweep) {
      for (int64_t i = 0; i < given_.num_nodes; ++i) Pass(i, true);
      for (int64_t i = given_.num_nodes - 1; i >= 0; --i) Pass(i, false);
    }
    std::vector<int32_t> chosen(given_.num_nodes, -1);
    for (int64_t i = 0; i < given_.num_nodes; ++i) Choose(i, chosen, false);
    for (int sweep = 0; sweep < num_sweeps; ++sweep)
      for (int64_t i = 0; i < given_.num_nodes; ++i) Choose(i, chosen, true);
    return chosen;
  }

 private:
  struct Arc {
    int32_t to;
    int64_t reverse;   // the arc back
    int64_t messages;  // where the messages to this arc's own node begin
  };

  int64_t Count(int64_t i) const { return given_.offsets[i + 1] - given_.offsets[i]; }
  const int32_t* Labels(int64_t i) const { return given_.labels + given_.offsets[i]; }

  // Costs of a node's candidates with all messages to it.
  void Sum(int64_t i) {
    const double* costs = given_.costs + given_.offsets[i];
    for (int64_t k = 0; k < Count(i); ++k) sums_[k] = costs[k];
    for (int64_t a = arc_offsets_[i]; a < arc_offsets_[i + 1]; ++a)
      for (int64_t k = 0; k < Count(i); ++k) sums_[k] += messages_[arcs_[a].messages + k];
  }

  // Sends messages to later neighbours, or to earlier ones.
  void Pass(int64_t i, bool forward) {
    if (!Count(i)) return;
    Sum(i);
    int64_t later = 0;
    const int64_t degree = arc_offsets_[i + 1] - arc_offsets_[i];
    for (int64_t a = arc_offsets_[i]; a < arc_offsets_[i + 1]; ++a) later += arcs_[a].to > i;
    const double share = 1.0 / double(std::max<int64_t>({later, degree - later, 1}));
    for (int64_t a = arc_offsets_[i]; a < arc_offsets_[i + 1]; ++a)
      if ((arcs_[a].to > i) == forward) Send(i, arcs_[a], share);
  }

  void Send(int64_t i, const Arc& arc, double share) {
    double least = std::numeric_limits<double>::infinity();
    for (int64_t k = 0; k < Count(i); ++k) {
      rest_[k] = share * sums_[k] - messages_[arc.messages + k];
      least = std::min(least, rest_[k]);
    }
    float* out = messages_.data() + arcs_[arc.reverse].messages;
    const int32_t *from = Labels(i), *to = Labels(arc.to);
    for (int64_t j = 0, k = 0; j < Count(arc.to); ++j) {
      while (k < Count(i) && from[k] < to[j]) ++k;
      const bool same = k < Count(i) && from[k] == to[j];
      out[j] = float(same ? std::min(rest_[k] - least, weight_) : weight_);
    }
  }

  // The best candidate given those of earlier neighbours and messages of later ones, or given
  // those of all neighbours.
  void Choose(int64_t i, std::vector<int32_t>& chosen, bool all) {
    if (!Count(i)) return;
    const double* costs = given_.costs + given_.offsets[i];
    for (int64_t k = 0; k < Count(i); ++k) sums_[k] = costs[k];
    for (int64_t a = arc_offsets_[i]; a < arc_offsets_[i + 1]; ++a) {
      const Arc& arc = arcs_[a];
      const bool fixed = (all || arc.to < i) && chosen[arc.to] >= 0;
      for (int64_t k = 0; k < Count(i); ++k) {
        if (fixed) {
          sums_[k] += Labels(i)[k] == Labels(arc.to)[chosen[arc.to]] ? 0 : weight_;
        } else if (!all) {
          sums_[k] += messages_[arc.messages + k];
        }
      }
    }
    chosen[i] = int32_t(std::min_element(sums_.begin(), sums_.begin() + Count(i)) - sums_.begin());
  }

  const LabelCandidates given_;
  double weight_;
  int64_t most_ = 0;
  std::vector<int64_t> arc_offsets_;
  std::vector<Arc> arcs_;
  std::vector<float> messages_;
  std::vector<double> sums_, rest_;
};

}  // namespace colmap_edges
