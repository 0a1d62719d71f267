// SPDX-License-Identifier: GPL-3.0-or-later
#include "free_space.h"

#include "parallel.h"
#include "ray_walker.h"

namespace mesher {
namespace {

std::vector<std::int64_t> CountRays(const Triangulation& triangulation, const Rows& rays,
                                    const std::vector<Vec3>& cameras,
                                    const std::vector<BackgroundRay>& background, int num_threads) {
  std::vector<std::int64_t> counts(triangulation.cells.size());
  auto count = [&](Index cell) { AtomicAdd(counts[cell], std::int64_t{1}); };
  auto count_crossed = [&](const RayWalker& walker) {
    count(walker.Walk(0, [&](const Crossing& crossing) { count(crossing.cell); }));
  };
  ParallelChunks(triangulation.num_vertices(), num_threads, [&](auto begin, auto end) {
    for (auto v = begin; v < end; ++v) {
      for (const Index* camera = rays.begin(v); camera != rays.end(v); ++camera) {
        const RayWalker walker(triangulation, static_cast<Index>(v), cameras[*camera]);
        if (walker.front() == kNone)
          walker.VisitOutside(true, count);
        else
          count_crossed(walker);
      }
    }
  });
  VisitAroundCameras(triangulation, background,
                     [&](Index cell, std::int64_t num_rays) { counts[cell] += num_rays; });
  ParallelChunks(background.size(), num_threads, [&](auto begin, auto end) {
    for (auto i = begin; i < end; ++i) {
      const RayWalker walker(triangulation, background[i].vertex, background[i].target);
      if (walker.front() != kNone) count_crossed(walker);
    }
  });
  return counts;
}

}  // namespace

std::vector<double> CountVotes(const Triangulation& triangulation, const Rows& rays,
                               const std::vector<Vec3>& cameras,
                               const std::vector<BackgroundRay>& background,
                               const VoteOptions& options) {
  const auto counts = CountRays(triangulation, rays, cameras, background, options.num_threads);
  std::vector<double> votes(counts.size());
  ParallelChunks(triangulation.num_cells(), options.num_threads, [&](auto begin, auto end) {
    for (auto c = begin; c < end; ++c) {
      std::int64_t around = 0, beyond = 0;
      for (Index neighbor : triangulation.cells[c].neighbors) {
        around += counts[neighbor];
        for (Index second : triangulation.cells[neighbor].neighbors)
          if (second != c) beyond += counts[second];
      }
      votes[c] = options.weights[0] * counts[c] + options.weights[1] * around +
                 options.weights[2] * beyond;
    }
  });
  return votes;
}

std::vector<std::uint8_t> FreeByVotes(const std::vector<double>& votes, double threshold) {
  std::vector<std::uint8_t> is_free(votes.size());
  for (std::size_t c = 0; c < votes.size(); ++c) is_free[c] = votes[c] >= threshold;
  return is_free;
}

}  // namespace mesher
