// Labels of the cells of all views, round by round, and how far views agree on them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/parallel.h"
#include "faces/borders.h"
#include "faces/evidence.h"
#include "faces/expansion.h"

namespace colmap_edges {

struct BorderCosts {
  double weight = 2;              // of a border in a plain part of a picture
  double least = 0.06;            // part of it that is left where the gray changes much
  double slope_scale = 2;         // gray levels a pixel
  double crossing_factor = 0.35;  // part of it where the two planes cross
};

using ViewLabels = std::vector<std::vector<int32_t>>;  // of the cells of all views; -1: no plane

// Labels of a view's cells from what they cost; `start`: labels to begin with, planes or -1.
inline std::vector<int32_t> LabelView(const FaceView& view, const ViewCosts& made,
                                      const std::vector<int32_t>& start, const BorderCosts& borders,
                                      int max_sweeps) {
  LabelProblem problem;
  problem.num_nodes = view.num_cells(), problem.num_labels = int32_t(made.planes.size()) + 1;
  problem.edges = CellPairs(view.columns, view.rows);
  problem.costs = made.costs.data(), problem.depths = made.depths.data();
  problem.crossing_factor = borders.crossing_factor;
  const Slopes slopes(view);
  std::vector<double> weights;
  for (const NodePair& pair : problem.edges)
    weights.push_back(borders.weight *
                      (std::exp(-slopes.Between(pair) / borders.slope_scale) + borders.least));
  problem.weights = weights.data();
  Expansion expansion(problem);
  if (!start.empty()) {
    std::vector<int32_t> first;
    for (const int32_t plane : start)
      first.push_back(
          plane < 0 ? problem.num_labels - 1
                    : int32_t(std::lower_bound(made.planes.begin(), made.planes.end(), plane) -
                              made.planes.begin()));
    expansion.Start(first);
  }
  std::vector<int32_t> labels = expansion.Run(max_sweeps);
  for (int32_t& label : labels) label = label == problem.num_labels - 1 ? -1 : made.planes[label];
  return labels;
}

// Labels of all views: at first each by itself, then `num_rounds` - 1 times in agreement with what
// its neighbours were labelled the time before.
inline ViewLabels LabelViews(const FaceScene& scene, const BorderCosts& borders, int num_rounds,
                             int max_sweeps, int num_threads) {
  ViewLabels labels(scene.views.size());
  std::vector<ViewCosts> observed(scene.views.size());
  for (int round = 0; round < num_rounds; ++round) {
    ViewLabels next(scene.views.size());
    ParallelFor(int64_t(scene.views.size()), num_threads, [&](int64_t v, int) {
      ViewCosts& costs = observed[v];
      if (round == 0) costs = scene.Costs(int32_t(v));
      if (round == 0) {
        next[v] = LabelView(scene.views[v], costs, {}, borders, max_sweeps);
      } else {
        ViewCosts agreed = costs;
        scene.AddLabels(int32_t(v), labels, &agreed);
        next[v] = LabelView(scene.views[v], agreed, labels[v], borders, max_sweeps);
      }
      if (round == num_rounds - 1) costs = {};
    });
    labels.swap(next);
  }
  return labels;
}

// What other views say of the point that a labelled cell sees.
struct CellSupport {
  Vec3 point;
  int32_t view, cell, plane;
  int32_t agreeing = 0, through = 0, hidden = 0, holding = 0;
  std::vector<int32_t> views;  // that agree, with its own first
};

inline std::vector<CellSupport> SupportOf(const FaceScene& scene, const ViewLabels& labels,
                                          int32_t v, double tolerance) {
  const FaceView& view = scene.views[v];
  std::vector<CellSupport> made;
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    const int32_t plane = labels[v][cell];
    if (plane < 0) continue;
    const Vec3 ray = view.RayThrough(view.CellSample(cell));
    const double depth = scene.planes[plane].DepthAlong(view.pose.center, ray);
    if (!(Norm(view.pose.center + depth * ray - scene.center) <= scene.reach)) continue;
    CellSupport support{view.pose.center + depth * ray, v, cell, plane, 1, 0, 0, 1, {v}};
    for (const int32_t u : scene.neighbors[v]) {
      const FaceView& other = scene.views[u];
      Vec2 pixel;
      double at;
      if (!other.Project(support.point, &pixel, &at)) continue;
      const int32_t label = labels[u][other.CellAt(pixel)];
      const bool same_side = SameSide(scene.planes[plane], view, other);
      support.holding += same_side;
      if (label < 0 || (label == plane && !same_side)) continue;
      const double theirs = label == plane ? at
                                           : scene.planes[label].DepthAlong(
                                                 other.pose.center, other.RayThrough(pixel));
      if (theirs > at * (1 + tolerance)) {
        ++support.through;
      } else if (!same_side) {
        continue;
      } else if (theirs < at * (1 - tolerance)) {
        ++support.hidden;
      } else {
        ++support.agreeing;
        support.views.push_back(u);
      }
    }
    made.push_back(std::move(support));
  }
  return made;
}

}  // namespace colmap_edges
