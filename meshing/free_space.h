// SPDX-License-Identifier: GPL-3.0-or-later
// Free space by votes: every ray votes for the cells it crosses and for those around them, and
// against the two cells right behind its point.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "triangulation.h"

namespace mesher {

struct VoteOptions {
  // Votes of one ray for the cells it crosses, for their neighbors and for the neighbors of those.
  std::array<double, 3> weights{1, 0, 0};
  double behind = 1;              // of one ray against each of the two cells behind its point
  double threshold = 2.1;         // votes that make a cell free
  double background_weight = 16;  // of a background ray relative to one to a point
  int num_threads = 1;
};

// Sum of the votes of all rays for each cell to be free, minus those against; see VisibilityProblem
// for `rays`.
std::vector<double> CountVotes(const Triangulation& triangulation, const Rows& rays,
                               const std::vector<Vec3>& cameras,
                               const std::vector<BackgroundRay>& background,
                               const VoteOptions& options);

// 1 for the cells with enough votes.
std::vector<std::uint8_t> FreeByVotes(const std::vector<double>& votes, double threshold);

}  // namespace mesher
