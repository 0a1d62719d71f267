// Labels of the cells of all views, round by round, and how far views agree on them.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <iterator>
#include <limits>
#include <vector>

#include "common/parallel.h"
#include "faces/borders.h"
#include "faces/evidence.h"
#include "faces/expansion.h"
#include "faces/smaller_problems.h"

namespace colmap_edges {

struct BorderCosts {
  double weight = 2;              // of a border in a plain part of a picture
  double least = 0.06;            // part of it that is left where the gray changes much
  double slope_scale = 2;         // gray levels a pixel
  double crossing_factor = 0.35;  // part of it where the two planes cross
};

// Cells within so many of a border may change their label, to any within as many.
constexpr int32_t kBorderReach = 8;

using ViewLabels = std::vector<std::vector<int32_t>>;  // of the cells of all views; -1: no plane

// What labels cost in a view: its planes, then none.
inline LabelProblem ProblemOf(const FaceView& view, const BorderCosts& borders,
                              const ViewCosts& costs) {
  LabelProblem problem;
  problem.num_nodes = view.num_cells(), problem.num_labels = int32_t(costs.planes.size()) + 1;
  problem.edges = CellPairs(view.columns, view.rows);
  problem.costs = costs.costs, problem.depths = costs.depths;
  problem.crossing_factor = borders.crossing_factor;
  const Slopes slopes(view);
  for (const NodePair& pair : problem.edges)
    problem.weights.push_back(
        borders.weight * (std::exp(-slopes.Between(pair) / borders.slope_scale) + borders.least));
  return problem;
}

// Blocks of two by two cells.
struct Blocks {
  std::vector<int32_t> of_cells;
  int32_t count;

  explicit Blocks(const FaceView& view) : of_cells(view.num_cells()) {
    const int32_t columns = (view.columns + 1) / 2;
    count = columns * ((view.rows + 1) / 2);
    for (int32_t cell = 0; cell < view.num_cells(); ++cell)
      of_cells[cell] = cell / view.columns / 2 * columns + cell % view.columns / 2;
  }
};

// Which labels lie within `reach` of every cell, each way.
struct NearLabels {
  int32_t num_labels;
  std::vector<uint8_t> is_near;       // (cells, labels)
  std::vector<int32_t> border_cells;  // near which there are several

  NearLabels(const FaceView& view, const std::vector<int32_t>& labels, int32_t num_labels,
             int32_t reach)
      : num_labels(num_labels), is_near(labels.size() * num_labels, 0) {
    for (size_t cell = 0; cell < labels.size(); ++cell)
      is_near[cell * num_labels + labels[cell]] = 1;
    is_near = Spread(view, Spread(view, is_near, reach, true), reach, false);
    for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
      const auto begin = is_near.begin() + ptrdiff_t(cell) * num_labels;
      if (std::count(begin, begin + num_labels, 1) > 1) border_cells.push_back(cell);
    }
  }

 private:
  std::vector<uint8_t> Spread(const FaceView& view, const std::vector<uint8_t>& from, int32_t reach,
                              bool along_rows) const {
    const int32_t count = along_rows ? view.columns : view.rows;
    const int32_t step = along_rows ? 1 : view.columns;
    std::vector<uint8_t> to(from.size(), 0);
    for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
      const int32_t at = along_rows ? cell % view.columns : cell / view.columns;
      for (int32_t i = std::max(-reach, -at); i <= std::min(reach, count - 1 - at); ++i)
        for (int32_t k = 0; k < num_labels; ++k)
          to[size_t(cell) * num_labels + k] |= from[(cell + i * step) * size_t(num_labels) + k];
    }
    return to;
  }
};

// Labels of cells near borders, each one of those near it, while all others keep theirs.
inline void RelabelNearBorders(const LabelProblem& problem, const NearLabels& near, int max_sweeps,
                               std::vector<int32_t>* labels) {
  const std::vector<int32_t>& cells = near.border_cells;
  const int32_t num_labels = problem.num_labels;
  LabelProblem restricted = Restricted(problem, cells, *labels);
  std::vector<int32_t> first;
  for (size_t i = 0; i < cells.size(); ++i) {
    first.push_back((*labels)[cells[i]]);
    for (int32_t k = 0; k < num_labels; ++k)
      if (!near.is_near[size_t(cells[i]) * num_labels + k])
        restricted.costs[i * num_labels + k] = std::numeric_limits<float>::infinity();
  }
  Expansion expansion(restricted);
  expansion.Start(first);
  const std::vector<int32_t>& found = expansion.Run(max_sweeps);
  for (size_t i = 0; i < cells.size(); ++i) (*labels)[cells[i]] = found[i];
}

// Labels of a view's cells from what they cost: of blocks of cells at first, then of cells near
// the borders. `start`: labels to begin with, planes or -1, or none.
inline std::vector<int32_t> LabelView(const FaceView& view, const ViewCosts& made,
                                      const std::vector<int32_t>& start, const BorderCosts& borders,
                                      int max_sweeps) {
  const LabelProblem problem = ProblemOf(view, borders, made);
  const int32_t none = problem.num_labels - 1;
  const Blocks blocks(view);
  const LabelProblem contracted = Contracted(problem, blocks.of_cells, blocks.count);
  Expansion expansion(contracted);
  if (!start.empty()) {
    std::vector<int32_t> first(blocks.count, none);
    for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
      const int32_t plane = start[cell], block = blocks.of_cells[cell];
      const int32_t label = plane < 0 ? none : made.labels[plane];
      if (contracted.Cost(block, label) < contracted.Cost(block, first[block]))
        first[block] = label;
    }
    expansion.Start(first);
  }
  const std::vector<int32_t>& of_blocks = expansion.Run(max_sweeps);
  std::vector<int32_t> labels;
  for (const int32_t block : blocks.of_cells) labels.push_back(of_blocks[block]);
  const NearLabels near(view, labels, problem.num_labels, kBorderReach);
  RelabelNearBorders(problem, near, max_sweeps, &labels);
  return made.PlanesOf(labels);
}

// Labels of all views: at first each by itself, then `num_rounds` - 1 times in agreement with what
// its neighbours were labelled the time before. A view may observe few points of what it shows: a
// plane that neighbours were labelled with is one of its labels, too.
inline ViewLabels LabelViews(const FaceScene& scene, const BorderCosts& borders, int num_rounds,
                             int max_sweeps, int num_threads) {
  ViewLabels labels(scene.views.size());
  std::vector<ViewCosts> observed(scene.views.size());
  for (int round = 0; round < num_rounds; ++round) {
    ViewLabels next(scene.views.size());
    ParallelFor(int64_t(scene.views.size()), num_threads, [&](int64_t v, int) {
      ViewCosts& costs = observed[v];
      std::vector<int32_t> planes;
      if (round == 0) {
        planes = scene.PlanesOf(int32_t(v), kMinCells);
      } else {
        const auto around = scene.PlanesAround(int32_t(v), labels, kMinCells);
        std::set_union(around.begin(), around.end(), costs.planes.begin(), costs.planes.end(),
                       std::back_inserter(planes));
      }
      if (round == 0 || planes.size() > costs.planes.size())
        costs = scene.Costs(int32_t(v), planes);
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

// Labels of all views from those of larger cells, `start`: near their borders, each cell gets one
// of the labels within `reach`.
inline ViewLabels RefineLabels(const FaceScene& scene, const BorderCosts& borders,
                               const ViewLabels& start, int32_t reach, int max_sweeps,
                               int num_threads) {
  ViewLabels refined(start.size());
  ParallelFor(int64_t(start.size()), num_threads, [&](int64_t v, int) {
    const FaceView& view = scene.views[v];
    std::vector<int32_t> shown = start[v];  // without planes that a smaller cell cannot show
    for (int32_t cell = 0; cell < view.num_cells(); ++cell)
      if (shown[cell] >= 0 &&
          (view.IsBackground(cell) ||
           std::isnan(scene.DepthAt(int32_t(v), cell, view.RayOfCell(cell), shown[cell]))))
        shown[cell] = -1;
    std::vector<int32_t> planes = shown;
    std::sort(planes.begin(), planes.end());
    planes.erase(std::unique(planes.begin(), planes.end()), planes.end());
    if (!planes.empty() && planes.front() < 0) planes.erase(planes.begin());
    ViewCosts costs(planes, scene.planes.size());
    std::vector<int32_t> labels = costs.LabelsOf(shown);
    const NearLabels near(view, labels, int32_t(planes.size()) + 1, reach);
    std::vector<uint8_t> asked(near.is_near.size(), 0);
    for (const int32_t cell : near.border_cells)
      std::copy_n(near.is_near.begin() + ptrdiff_t(cell) * near.num_labels, near.num_labels,
                  asked.begin() + ptrdiff_t(cell) * near.num_labels);
    scene.AddCosts(int32_t(v), asked, &costs);
    scene.AddLabels(int32_t(v), start, &costs);
    RelabelNearBorders(ProblemOf(view, borders, costs), near, max_sweeps, &labels);
    refined[v] = costs.PlanesOf(labels);
  });
  return refined;
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
