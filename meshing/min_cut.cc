// SPDX-License-Identifier: GPL-3.0-or-later
#include "min_cut.h"

#include <algorithm>
#include <deque>
#include <limits>
#include <stdexcept>

namespace mesher {
namespace {

class Solver {
 public:
  Solver(const std::vector<Cell>& cells, CutProblem problem)
      : cells_(cells), residual_(std::move(problem.arcs)), nodes_(cells.size()) {
    mirrors_.resize(cells.size());
    for (Index c = 0; c < static_cast<Index>(cells.size()); ++c) {
      for (int i = 0; i < 4; ++i) {
        const auto& around = cells[cells[c].neighbors[i]].neighbors;
        const int mirror = around[0] == c ? 0 : around[1] == c ? 1 : around[2] == c ? 2 : 3;
        mirrors_[c] |= mirror << (2 * i);
      }
      AddTerminals(c, problem.source[c], problem.sink[c]);
    }
  }

  Cut Solve() {
    while (first_active_ != kNone) {
      const Index node = first_active_;
      // Nodes that became free are no longer active; nodes that met the other tree stay active.
      if (nodes_[node].parent == kFree || !Grow(node)) PopActive();
    }
    Cut cut;
    cut.flow = flow_;
    cut.is_source.resize(nodes_.size());
    for (std::size_t i = 0; i < nodes_.size(); ++i)
      cut.is_source[i] = nodes_[i].parent != kFree && !nodes_[i].in_sink_tree;
    return cut;
  }

 private:
  // Values of Node::parent besides the index (0 to 3) of the arc to the parent.
  static constexpr std::uint8_t kTerminal = 4, kOrphan = 5, kFree = 6;

  struct Node {
    std::int64_t terminal = 0;  // residual from the source (positive) or to the sink (negative)
    Index next_active = kNone;  // itself if last in the queue
    std::int32_t stamp = 0;     // time at which `distance` was valid
    std::int32_t distance = 0;  // arcs to the terminal
    std::uint8_t parent = kFree;
    bool in_sink_tree = false;
  };

  Index Neighbor(Index node, int arc) const { return cells_[node].neighbors[arc]; }
  int Mirror(Index node, int arc) const { return (mirrors_[node] >> (2 * arc)) & 3; }
  std::int64_t& Out(Index node, int arc) { return residual_[4 * std::size_t(node) + arc]; }
  std::int64_t& In(Index node, int arc) { return Out(Neighbor(node, arc), Mirror(node, arc)); }
  // Residual of an arc in the direction away from the root of a source or sink tree.
  std::int64_t Downward(Index node, int arc, bool sink) {
    return sink ? In(node, arc) : Out(node, arc);
  }
  std::int64_t& FromParent(Index node, int arc, bool sink) {
    return sink ? Out(node, arc) : In(node, arc);
  }

  void AddTerminals(Index c, std::int64_t source, std::int64_t sink) {
    if (sink < 0 ||
        std::any_of(&Out(c, 0), &Out(c, 0) + 4, [](auto capacity) { return capacity < 0; }))
      throw std::invalid_argument("capacities must not be negative");
    flow_ += std::min(source, sink);
    Node& node = nodes_[c];
    node.terminal = source - sink;
    if (node.terminal == 0) return;
    node.in_sink_tree = node.terminal < 0;
    node.parent = kTerminal;
    node.distance = 1;
    PushActive(c);
  }

  void PushActive(Index node) {
    if (nodes_[node].next_active != kNone) return;
    nodes_[node].next_active = node;
    if (last_active_ != kNone)
      nodes_[last_active_].next_active = node;
    else
      first_active_ = node;
    last_active_ = node;
  }

  void PopActive() {
    Node& node = nodes_[first_active_];
    const bool is_last = node.next_active == first_active_;
    first_active_ = is_last ? kNone : node.next_active;
    if (is_last) last_active_ = kNone;
    node.next_active = kNone;
  }

  // Extends the tree by the free neighbors of an active node. On meeting the other tree, augments
  // and returns true; the node must then be processed again.
  bool Grow(Index node) {
    const bool sink = nodes_[node].in_sink_tree;
    for (int arc = 0; arc < 4; ++arc) {
      if (Downward(node, arc, sink) == 0) continue;
      const Index other = Neighbor(node, arc);
      Node& grown = nodes_[other];
      if (grown.parent == kFree) {
        grown.in_sink_tree = sink;
        grown.parent = Mirror(node, arc);
        grown.stamp = nodes_[node].stamp;
        grown.distance = nodes_[node].distance + 1;
        PushActive(other);
      } else if (grown.in_sink_tree != sink) {
        ++time_;
        if (sink)
          Augment(other, Mirror(node, arc));
        else
          Augment(node, arc);
        Adopt();
        return true;
      } else if (grown.stamp <= nodes_[node].stamp && grown.distance > nodes_[node].distance + 1 &&
                 grown.parent != kTerminal) {
        grown.parent = Mirror(node, arc);  // a shorter way to the terminal
        grown.stamp = nodes_[node].stamp;
        grown.distance = nodes_[node].distance + 1;
      }
    }
    return false;
  }

  template <typename Visit>
  Index ClimbToRoot(Index node, Visit&& visit) {
    while (nodes_[node].parent != kTerminal) {
      const int arc = nodes_[node].parent;
      visit(node, arc);
      node = Neighbor(node, arc);
    }
    return node;
  }

  // Pushes as much as fits from the source through `arc` of `from` to the sink.
  void Augment(Index from, int arc) {
    const Index to = Neighbor(from, arc);
    std::int64_t amount = Out(from, arc);
    for (const bool sink : {false, true}) {
      const Index root = ClimbToRoot(sink ? to : from, [&](Index node, int up) {
        amount = std::min(amount, FromParent(node, up, sink));
      });
      amount = std::min(amount, std::abs(nodes_[root].terminal));
    }
    Out(from, arc) -= amount;
    In(from, arc) += amount;
    for (const bool sink : {false, true}) {
      const Index root = ClimbToRoot(sink ? to : from, [&](Index node, int up) {
        Out(node, up) += sink ? -amount : amount;
        In(node, up) += sink ? amount : -amount;
        if (FromParent(node, up, sink) == 0) MakeOrphan(node);
      });
      nodes_[root].terminal += sink ? amount : -amount;
      if (nodes_[root].terminal == 0) MakeOrphan(root);
    }
    flow_ += amount;
  }

  void MakeOrphan(Index node) { new_orphans_.push_back(node); }

  // Finds new parents for the nodes that an augmentation cut off, or frees them.
  void Adopt() {
    for (Index node : new_orphans_) nodes_[node].parent = kOrphan;
    orphans_.insert(orphans_.end(), new_orphans_.begin(), new_orphans_.end());
    new_orphans_.clear();
    while (!orphans_.empty()) {
      const Index node = orphans_.front();
      orphans_.pop_front();
      const int arc = NearestParent(node);
      if (arc == kFree)
        Free(node);
      else
        nodes_[node].parent = arc;
    }
  }

  int NearestParent(Index node) {
    const bool sink = nodes_[node].in_sink_tree;
    int best_arc = kFree;
    std::int32_t best = std::numeric_limits<std::int32_t>::max();
    for (int arc = 0; arc < 4; ++arc) {
      if (FromParent(node, arc, sink) == 0) continue;
      const Index other = Neighbor(node, arc);
      if (nodes_[other].parent == kFree || nodes_[other].in_sink_tree != sink) continue;
      const std::int32_t distance = DistanceToTerminal(other);
      if (distance < best) best = distance, best_arc = arc;
    }
    if (best_arc != kFree) {
      nodes_[node].stamp = time_;
      nodes_[node].distance = best + 1;
    }
    return best_arc;
  }

  // Arcs from `node` to its terminal, or the maximum if it hangs on an orphan.
  std::int32_t DistanceToTerminal(Index node) {
    std::int32_t distance = 0;
    Index at = node;
    while (nodes_[at].stamp != time_) {
      ++distance;
      if (nodes_[at].parent == kOrphan) return std::numeric_limits<std::int32_t>::max();
      if (nodes_[at].parent == kTerminal) {
        nodes_[at].stamp = time_;
        nodes_[at].distance = 1;
        distance -= 1;
        break;
      }
      at = Neighbor(at, nodes_[at].parent);
    }
    distance += nodes_[at].distance;
    std::int32_t remaining = distance;
    for (at = node; nodes_[at].stamp != time_; at = Neighbor(at, nodes_[at].parent)) {
      nodes_[at].stamp = time_;
      nodes_[at].distance = remaining--;
    }
    return distance;
  }

  void Free(Index node) {
    const bool sink = nodes_[node].in_sink_tree;
    for (int arc = 0; arc < 4; ++arc) {
      const Index other = Neighbor(node, arc);
      if (nodes_[other].parent == kFree || nodes_[other].in_sink_tree != sink) continue;
      if (FromParent(node, arc, sink) > 0) PushActive(other);
      if (nodes_[other].parent == Mirror(node, arc)) {
        nodes_[other].parent = kOrphan;
        orphans_.push_back(other);
      }
    }
    nodes_[node].parent = kFree;
  }

  const std::vector<Cell>& cells_;
  std::vector<std::int64_t> residual_;
  std::vector<Node> nodes_;
  std::vector<std::uint8_t> mirrors_;
  std::vector<Index> new_orphans_;
  std::deque<Index> orphans_;
  Index first_active_ = kNone, last_active_ = kNone;
  std::int32_t time_ = 0;
  std::int64_t flow_ = 0;
};

}  // namespace

Cut MinimumCut(const std::vector<Cell>& cells, CutProblem problem) {
  if (problem.source.size() != cells.size() || problem.sink.size() != cells.size() ||
      problem.arcs.size() != 4 * cells.size())
    throw std::invalid_argument("capacities do not match the number of cells");
  return Solver(cells, std::move(problem)).Solve();
}

}  // namespace mesher
