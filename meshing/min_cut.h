// SPDX-License-Identifier: GPL-3.0-or-later
// Minimum cut on the dual graph of a tetrahedralisation: every node has exactly four arcs.
#pragma once

#include <cstdint>
#include <vector>

#include "triangulation.h"

namespace mesher {

// Capacities are integers, so that sums do not depend on their order and the cut is exact.
struct CutProblem {
  std::vector<std::int64_t> source;  // per cell
  std::vector<std::int64_t> sink;    // per cell
  std::vector<std::int64_t> arcs;    // 4 per cell: from the cell to its neighbors[i]

  explicit CutProblem(std::size_t num_cells)
      : source(num_cells), sink(num_cells), arcs(4 * num_cells) {}
};

struct Cut {
  std::int64_t flow = 0;
  // 1 for cells reachable from the source: the smallest source side of all minimum cuts, which is
  // unique.
  std::vector<std::uint8_t> is_source;
};

// Augmenting paths from two search trees (Boykov & Kolmogorov, PAMI 2004). Takes the problem's
// arrays as its working memory. Capacities must not be negative, but for those of sources: what is
// missing there flows to the sink.
Cut MinimumCut(const std::vector<Cell>& cells, CutProblem problem);

}  // namespace mesher
