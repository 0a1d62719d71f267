// SPDX-License-Identifier: GPL-3.0-or-later
#include "free_space.h"

#include "parallel.h"
#include "ray_walker.h"

namespace mesher {
namespace {

// Per cell: the number of rays to points that cross it, of rays whose point is directly in front of
// it, and of background rays that cross it.
struct RayCounts {
  std::vector<std::int64_t> crossed, behind, background;
};

void AddOne(std::vector<std::int64_t>& counts, Index cell) {
  AtomicAdd(counts[cell], std::int64_t{1});
}

void CountCrossed(const RayWalker& walker, std::vector<std::int64_t>& counts) {
  AddOne(counts, walker.Walk(0, [&](const Crossing& crossing) {
    AddOne(counts, crossing.cell);
    return true;
  }));
}

void CountRay(const RayWalker& walker, RayCounts& counts) {
  if (walker.front() == kNone)
    walker.VisitOutside(true, [&](Index cell) { AddOne(counts.crossed, cell); });
  else
    CountCrossed(walker, counts.crossed);
  if (walker.behind() == kNone) {
    walker.VisitOutside(false, [&](Index cell) { AddOne(counts.behind, cell); });
  } else {
    AddOne(counts.behind, walker.behind());
    AddOne(counts.behind, walker.BehindExit().next);
  }
}

RayCounts CountRays(const Triangulation& triangulation, const Rows& rays,
                    const std::vector<Vec3>& cameras, const std::vector<BackgroundRay>& background,
                    int num_threads) {
  const std::vector<std::int64_t> none(triangulation.cells.size());
  RayCounts counts{none, none, none};
  ParallelChunks(triangulation.num_vertices(), num_threads, [&](auto begin, auto end) {
    for (auto v = begin; v < end; ++v)
      for (const Index* camera = rays.begin(v); camera != rays.end(v); ++camera)
        CountRay(RayWalker(triangulation, static_cast<Index>(v), cameras[*camera]), counts);
  });
  VisitAroundCameras(triangulation, background, [&](Index cell, std::int64_t num_rays) {
    counts.background[cell] += num_rays;
  });
  ParallelChunks(background.size(), num_threads, [&](auto begin, auto end) {
    for (auto i = begin; i < end; ++i) {
      const RayWalker walker(triangulation, background[i].vertex, background[i].target);
      if (walker.front() != kNone) CountCrossed(walker, counts.background);
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
  std::vector<double> votes(counts.crossed.size()), crossed(votes.size());
  for (std::size_t c = 0; c < votes.size(); ++c)
    crossed[c] = counts.crossed[c] + options.background_weight * counts.background[c];
  ParallelChunks(triangulation.num_cells(), options.num_threads, [&](auto begin, auto end) {
    for (auto c = begin; c < end; ++c) {
      double around = 0, beyond = 0;
      for (Index neighbor : triangulation.cells[c].neighbors) {
        around += crossed[neighbor];
        for (Index second : triangulation.cells[neighbor].neighbors)
          if (second != c) beyond += crossed[second];
      }
      votes[c] = options.weights[0] * crossed[c] + options.weights[1] * around +
                 options.weights[2] * beyond - options.behind * counts.behind[c];
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
