// SPDX-License-Identifier: GPL-3.0-or-later
// Free space by votes: every ray votes for the cells it crosses and for those around them.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "triangulation.h"

namespace mesher {

struct VoteOptions {
  // Of one ray: for the cells it crosses, for their neighbors and for the neighbors of those.
  std::array<double, 3> weights{1, 0.2, 0};
  double threshold = 1;  // votes that make a cell free
  int num_threads = 1;
};

// Votes of all rays for each cell; see VisibilityProblem for `rays`.
std::vector<double> CountVotes(const Triangulation& triangulation, const Rows& rays,
                               const std::vector<Vec3>& cameras,
                               const std::vector<BackgroundRay>& background,
                               const VoteOptions& options);

// 1 for the cells with enough votes.
std::vector<std::uint8_t> FreeByVotes(const std::vector<double>& votes, double threshold);

}  // namespace mesher
