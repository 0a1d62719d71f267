// SPDX-License-Identifier: GPL-3.0-or-later
// Free space by votes: every ray votes for the cells that it crosses and their neighbors, and
// against the two cells directly behind its point.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "triangulation.h"

namespace mesher {

struct VoteOptions {
  // Votes of one ray for the cells that it crosses, their neighbors and the neighbors of these.
  std::array<double, 3> weights{1, 0, 0};
  double behind = 1;              // of one ray against each of the two cells behind its point
  double threshold = 2.1;         // minimum sum of votes of free cells
  double background_weight = 16;  // of a background ray, relative to a ray to a point
  int num_threads = 1;
};

// Sum of the votes of all rays for each cell to be free, minus those against. `rays` is as in
// VisibilityProblem.
std::vector<double> CountVotes(const Triangulation& triangulation, const Rows& rays,
                               const std::vector<Vec3>& cameras,
                               const std::vector<BackgroundRay>& background,
                               const VoteOptions& options);

// 1 for cells with at least `threshold` votes.
std::vector<std::uint8_t> FreeByVotes(const std::vector<double>& votes, double threshold);

}  // namespace mesher
