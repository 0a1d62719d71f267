// Minimum cut of a sparse graph: augmenting paths between two search trees that are kept from one
// path to the next (Boykov and Kolmogorov, An experimental comparison of min-cut/max-flow
// algorithms, PAMI 2004). Capacities are whole numbers, so the result is exact.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <deque>
#include <limits>
#include <vector>

namespace colmap_edges {

using NodePair = std::array<int32_t, 2>;

class MaxFlow {
 public:
  // The graph's edges; their capacities and those of the terminals are 0 until they are set.
  MaxFlow(int32_t num_nodes, const std::vector<NodePair>& edges) : nodes_(num_nodes) {
    first_.assign(size_t(num_nodes) + 1, 0);
    for (const auto& [a, b] : edges) ++first_[a + 1], ++first_[b + 1];
    for (int32_t i = 0; i < num_nodes; ++i) first_[i + 1] += first_[i];
    arcs_.resize(2 * edges.size());
    forward_.resize(edges.size());
    std::vector<int32_t> fill(first_.begin(), first_.end() - 1);
    for (size_t e = 0; e < edges.size(); ++e) {
      const auto& [a, b] = edges[e];
      const int32_t ab = fill[a]++, ba = fill[b]++;
      arcs_[ab] = {b, ba, 0}, arcs_[ba] = {a, ab, 0};
      forward_[e] = ab;
    }
  }

  // What may flow from the source to a node, or from it to the sink if it is negative.
  void SetTerminal(int32_t node, int64_t capacity) { nodes_[node].excess = capacity; }
  // What may flow along an edge, and against it; neither is negative.
  void SetEdge(int64_t edge, int64_t along, int64_t against) {
    Arc& arc = arcs_[forward_[edge]];
    arc.residual = along, arcs_[arc.sister].residual = against;
  }

  // The maximum flow through some nodes; nothing may flow along edges between them and others.
  // Their terminals and edges have to be set anew before the next call.
  int64_t Solve(const std::vector<int32_t>& nodes) {
    Start(nodes);
    int32_t current = kNone;
    while (true) {
      int32_t i = current;
      if (i == kNone || nodes_[i].parent == kFree) i = NextActive();
      if (i == kNone) return flow_;
      const int32_t bridge = Grow(i);
      ++time_;
      current = kNone;
      if (bridge == kNone) continue;
      current = i;
      Augment(bridge);
      while (!orphans_.empty()) {
        const int32_t orphan = orphans_.front();
        orphans_.pop_front();
        Adopt(orphan);
      }
    }
  }

  // Whether a node is cut off from the sink, on the source's side; nodes between are the sink's.
  bool IsSource(int32_t node) const { return nodes_[node].parent != kFree && !nodes_[node].sink; }

 private:
  static constexpr int32_t kNone = -1;
  static constexpr int32_t kFree = -1, kTerminal = -2, kOrphan = -3;  // in place of parent arcs
  struct Arc {
    int32_t head, sister;
    int64_t residual;
  };
  struct Node {
    int64_t excess = 0;
    int32_t parent = kFree;  // arc to it
    int32_t time = 0, distance = 0;
    bool sink = false, active = false;
  };

  void Start(const std::vector<int32_t>& nodes) {
    flow_ = 0, time_ = 1;
    active_.clear(), orphans_.clear();
    for (const int32_t i : reached_) nodes_[i].parent = kFree;
    reached_ = nodes;
    for (const int32_t i : nodes) {
      Node& node = nodes_[i];
      node.parent = kFree, node.active = false, node.time = 0, node.distance = 1;
      node.sink = node.excess < 0;
      if (node.excess == 0) continue;
      node.parent = kTerminal;
      Activate(i);
    }
  }

  void Activate(int32_t i) {
    if (nodes_[i].active) return;
    nodes_[i].active = true;
    active_.push_back(i);
  }

  int32_t NextActive() {
    while (!active_.empty()) {
      const int32_t i = active_.front();
      active_.pop_front();
      nodes_[i].active = false;
      if (nodes_[i].parent != kFree) return i;
    }
    return kNone;
  }

  // Capacity left from node to arc's head in the source's tree, from head to node in the sink's.
  int64_t Outward(const Arc& arc, bool sink) const {
    return sink ? arcs_[arc.sister].residual : arc.residual;
  }

  // Takes free neighbours of a node into its tree. Returns an arc from the source's tree to the
  // sink's, if one is met.
  int32_t Grow(int32_t i) {
    const bool sink = nodes_[i].sink;
    for (int32_t a = first_[i]; a < first_[i + 1]; ++a) {
      const Arc& arc = arcs_[a];
      if (Outward(arc, sink) <= 0) continue;
      Node& other = nodes_[arc.head];
      if (other.parent == kFree) {
        other.sink = sink, other.parent = arc.sister;
        other.time = nodes_[i].time, other.distance = nodes_[i].distance + 1;
        Activate(arc.head);
      } else if (other.sink != sink) {
        return sink ? arc.sister : a;
      } else if (other.time <= nodes_[i].time && other.distance > nodes_[i].distance) {
        other.parent = arc.sister;
        other.time = nodes_[i].time, other.distance = nodes_[i].distance + 1;
      }
    }
    return kNone;
  }

  void MakeOrphan(int32_t i) {
    nodes_[i].parent = kOrphan;
    orphans_.push_back(i);
  }

  void Augment(int32_t bridge) {
    int64_t amount = arcs_[bridge].residual;
    const int32_t ends[2] = {arcs_[arcs_[bridge].sister].head, arcs_[bridge].head};
    for (const int32_t end : ends) {
      int32_t i = end;
      for (; nodes_[i].parent != kTerminal; i = arcs_[nodes_[i].parent].head)
        amount = std::min(amount, Inward(i));
      amount = std::min(amount, nodes_[i].sink ? -nodes_[i].excess : nodes_[i].excess);
    }
    Push(bridge, amount);
    for (const int32_t end : ends) {
      int32_t i = end;
      while (nodes_[i].parent != kTerminal) {
        const int32_t up = nodes_[i].parent, next = arcs_[up].head;
        Push(nodes_[i].sink ? up : arcs_[up].sister, amount);
        if (Inward(i) == 0) MakeOrphan(i);
        i = next;
      }
      nodes_[i].excess += nodes_[i].sink ? amount : -amount;
      if (nodes_[i].excess == 0) MakeOrphan(i);
    }
    flow_ += amount;
  }

  // Capacity left between a node and its parent, in the direction of the flow.
  int64_t Inward(int32_t i) const {
    const Arc& up = arcs_[nodes_[i].parent];
    return nodes_[i].sink ? up.residual : arcs_[up.sister].residual;
  }

  void Push(int32_t arc, int64_t amount) {
    arcs_[arc].residual -= amount;
    arcs_[arcs_[arc].sister].residual += amount;
  }

  // Finds a parent for a node that lost its own, or sets it free, and its children with it.
  void Adopt(int32_t i) {
    const bool sink = nodes_[i].sink;
    int32_t best = kNone, least = std::numeric_limits<int32_t>::max();
    for (int32_t a = first_[i]; a < first_[i + 1]; ++a) {
      const Arc& arc = arcs_[a];
      const Node& other = nodes_[arc.head];
      if (Outward(arcs_[arc.sister], sink) <= 0 || other.sink != sink || other.parent == kFree)
        continue;
      const int32_t distance = ToTerminal(arc.head);
      if (distance < least) best = a, least = distance;
    }
    if (best != kNone) {
      nodes_[i].parent = best, nodes_[i].time = time_, nodes_[i].distance = least + 1;
      return;
    }
    nodes_[i].parent = kFree;
    for (int32_t a = first_[i]; a < first_[i + 1]; ++a) {
      const Arc& arc = arcs_[a];
      Node& other = nodes_[arc.head];
      if (other.sink != sink || other.parent == kFree) continue;
      if (Outward(arcs_[arc.sister], sink) > 0) Activate(arc.head);
      if (other.parent >= 0 && arcs_[other.parent].head == i) MakeOrphan(arc.head);
    }
  }

  // Number of arcs from a node to its terminal, written down on the way; the largest number if it
  // hangs on an orphan.
  int32_t ToTerminal(int32_t i) {
    int32_t steps = 0, j = i;
    while (nodes_[j].time != time_ && nodes_[j].parent >= 0)
      j = arcs_[nodes_[j].parent].head, ++steps;
    if (nodes_[j].time != time_) {
      if (nodes_[j].parent != kTerminal) return std::numeric_limits<int32_t>::max();
      nodes_[j].time = time_, nodes_[j].distance = 1;
    } else if (nodes_[j].parent == kOrphan) {
      return std::numeric_limits<int32_t>::max();
    }
    const int32_t whole = steps + nodes_[j].distance;
    for (int32_t k = i, d = whole; k != j; k = arcs_[nodes_[k].parent].head, --d)
      nodes_[k].time = time_, nodes_[k].distance = d;
    return whole;
  }

  std::vector<Node> nodes_;
  std::vector<int32_t> first_, forward_;
  std::vector<int32_t> reached_;  // nodes of the last call
  std::vector<Arc> arcs_;
  std::deque<int32_t> active_, orphans_;
  int32_t time_ = 0;
  int64_t flow_ = 0;
};

}  // namespace colmap_edges
