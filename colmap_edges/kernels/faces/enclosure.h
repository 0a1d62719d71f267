// Cells that observed points of their plane enclose.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/parallel.h"
#include "faces/labelling.h"

namespace colmap_edges {

struct CellStep {
  int32_t columns, rows;
};

struct EnclosureOptions {
  std::vector<CellStep> directions;  // sorted by angle
  int max_open;                      // maximum number of adjacent open directions
  double min_share;                  // minimum share of enclosed cells of a whole piece
  int32_t side;  // cells along a side of those that an observed point stands for
};

// A view's cells: planes, -1 for none, and for every cell and plane whether points are observed.
struct CellGrid {
  int32_t columns, rows, num_planes;
  const int32_t* labels;
  const uint8_t* touched;  // (num_cells, num_planes), also where a plane ends at another one
  const uint8_t* inside;   // (num_cells) where a way that leaves the picture meets points, too

  int32_t num_cells() const { return columns * rows; }
  // Whether points of its own plane are observed in a cell.
  bool IsTouched(int32_t cell) const { return touched[int64_t(cell) * num_planes + labels[cell]]; }
};

// Whether steps in one direction meet points of a cell's plane before they leave the plane.
inline void FindMet(const CellGrid& grid, CellStep step, uint8_t* met) {
  // The next cell comes first: cells whose way goes on are as the next.
  const int32_t down = step.rows > 0 ? -1 : 1, right = step.columns > 0 ? -1 : 1;
  for (int32_t y = down > 0 ? 0 : grid.rows - 1; y >= 0 && y < grid.rows; y += down) {
    for (int32_t x = right > 0 ? 0 : grid.columns - 1; x >= 0 && x < grid.columns; x += right) {
      const int32_t cell = y * grid.columns + x, label = grid.labels[cell];
      const int32_t row = y + step.rows, column = x + step.columns;
      const int32_t next = row * grid.columns + column;
      if (label < 0) {
        met[cell] = false;
      } else if (row < 0 || row >= grid.rows || column < 0 || column >= grid.columns) {
        met[cell] = grid.inside[cell];
      } else {
        met[cell] = grid.touched[int64_t(next) * grid.num_planes + label] ||
                    (grid.labels[next] == label && met[next]);
      }
    }
  }
}

// Whether going straight on within a cell's label meets its plane's points all around.
inline std::vector<uint8_t> EnclosedCells(const CellGrid& grid, const EnclosureOptions& options) {
  const size_t num_cells = grid.num_cells(), num_steps = options.directions.size();
  std::vector<uint8_t> met(num_cells * num_steps);
  for (size_t k = 0; k < num_steps; ++k) FindMet(grid, options.directions[k], &met[k * num_cells]);
  std::vector<int32_t> run(num_cells, 0), longest(num_cells, 0);
  for (size_t k = 0; k < 2 * num_steps; ++k) {  // twice, as runs go on from the last to the first
    const uint8_t* here = &met[k % num_steps * num_cells];
    for (size_t i = 0; i < num_cells; ++i) {
      run[i] = here[i] ? 0 : run[i] + 1;
      longest[i] = std::max(longest[i], run[i]);
    }
  }
  std::vector<uint8_t> enclosed(num_cells);
  for (size_t i = 0; i < num_cells; ++i)
    enclosed[i] = grid.labels[i] >= 0 && longest[i] <= options.max_open;
  return enclosed;
}

// Cells that are enclosed, and all of pieces with a minimum share of such cells. A piece is a
// connected part of the cells of one plane: a wall that goes on to the end of the picture is
// believed. Where there is a backdrop, cells with points of their plane are held and end pieces,
// since what lies beyond the outline of a part is not of its plane.
inline std::vector<uint8_t> WholePieces(const CellGrid& grid, const std::vector<uint8_t>& enclosed,
                                        bool has_backdrop, double min_share) {
  std::vector<uint8_t> held = enclosed, seen(grid.num_cells(), false);
  for (int32_t cell = 0; cell < grid.num_cells(); ++cell) {
    const bool ends = has_backdrop && grid.labels[cell] >= 0 && grid.IsTouched(cell);
    seen[cell] = grid.labels[cell] < 0 || ends;
    held[cell] |= ends;
  }
  std::vector<int32_t> piece;
  for (int32_t start = 0; start < grid.num_cells(); ++start) {
    if (seen[start]) continue;
    piece.assign(1, start), seen[start] = true;
    int64_t inner = 0;
    for (size_t k = 0; k < piece.size(); ++k) {
      const int32_t cell = piece[k], row = cell / grid.columns, column = cell % grid.columns;
      inner += enclosed[cell];
      const auto add = [&](bool exists, int32_t next) {
        if (!exists || seen[next] || grid.labels[next] != grid.labels[cell]) return;
        seen[next] = true, piece.push_back(next);
      };
      add(column > 0, cell - 1), add(column + 1 < grid.columns, cell + 1);
      add(row > 0, cell - grid.columns), add(row + 1 < grid.rows, cell + grid.columns);
    }
    if (double(inner) >= min_share * double(piece.size()))
      for (const int32_t cell : piece) held[cell] = true;
  }
  return held;
}

// Sides of what a point stands for, each way, in which a plane ends at another one's cell.
constexpr int32_t kMeetSides = 2;

// Planes end where they meet the plane of a cell next to theirs: walls end at the floor. Two planes
// meet where the line in which they intersect passes through the window around a cell.
inline void TouchWherePlanesMeet(const FaceView& view, const int32_t* labels,
                                 const std::vector<Vec3>& inverse_depths, int32_t side,
                                 std::vector<uint8_t>* touched) {
  const int32_t reach = kMeetSides * side;
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    const int32_t own = labels[cell], x = cell % view.columns, y = cell / view.columns;
    if (own < 0) continue;
    const Vec2 pixel = view.CellCenter(cell);
    const int32_t right = std::min(x + reach, view.columns - 1);
    const int32_t bottom = std::min(y + reach, view.rows - 1);
    for (int32_t j = std::max(y - reach, 0); j <= bottom; ++j) {
      for (int32_t i = std::max(x - reach, 0); i <= right; ++i) {
        const int32_t other = labels[j * view.columns + i];
        if (other < 0 || other == own) continue;
        const Vec3 line = inverse_depths[other] - inverse_depths[own];
        const double off = Dot(line, {pixel.x, pixel.y, 1});
        if (std::abs(off) <= reach * FaceView::kCellPx * (std::abs(line.x) + std::abs(line.y)))
          (*touched)[cell * inverse_depths.size() + other] = true;
      }
    }
  }
}

// Planes may go on behind what is held: a wall behind furniture. Returns whether any is new.
inline bool TouchBehind(const FaceView& view, const int32_t* labels,
                        const std::vector<uint8_t>& held, const std::vector<Vec3>& inverse_depths,
                        std::vector<uint8_t>* touched) {
  const size_t count = inverse_depths.size();
  bool any = false;
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    if (!held[cell]) continue;
    const Vec2 at = view.CellCenter(cell);
    const Vec3 pixel{at.x, at.y, 1};
    const double inverse = Dot(inverse_depths[labels[cell]], pixel);
    for (size_t k = 0; k < count; ++k) {
      uint8_t& is_touched = (*touched)[cell * count + k];
      if (is_touched || inverse < kNearer * Dot(inverse_depths[k], pixel)) continue;
      is_touched = any = true;
    }
  }
  return any;
}

constexpr int32_t kFarSides = 3;    // minimum distance from all observed points, each way
constexpr float kTexture = 9;       // minimum of `TextureAround`, in levels squared
constexpr float kAlike = 0.2f;      // maximum of `ComparedPlane::Difference` on a plane
constexpr float kUnlike = 0.4f;     // minimum on parallel ones, as otherwise all depths look alike
constexpr double kParallel = 1.05;  // ratio of the distances of these from the view

// Where no points are observed, a plane is known as well as at one if other views show the same
// texture on it, and on none before or behind it: a lawn before the cameras.
inline void TouchWhereTextureAgrees(const FaceScene& scene, int32_t v, const int32_t* labels,
                                    int32_t side, std::vector<uint8_t>* touched) {
  const FaceView& view = scene.views[v];
  const int32_t reach = kFarSides * side;
  std::vector<uint8_t> is_near(view.num_cells(), false);
  for (const ObservedPoint& sight : scene.sights(v)) {
    const int32_t x = sight.cell % view.columns, y = sight.cell / view.columns;
    const int32_t right = std::min(x + reach, view.columns);
    const int32_t bottom = std::min(y + reach, view.rows);
    for (int32_t j = std::max(y - reach + 1, 0); j < bottom; ++j)
      for (int32_t i = std::max(x - reach + 1, 0); i < right; ++i)
        is_near[j * view.columns + i] = true;
  }
  std::vector<std::vector<ComparedPlane>> compared(scene.planes.size());
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    const int32_t k = labels[cell];
    const Vec2 middle = view.CellCenter(cell);
    if (k < 0 || is_near[cell] || TextureAround(view, middle) < kTexture) continue;
    if (compared[k].empty())
      for (const double ratio : {1.0, kParallel, 1 / kParallel})
        compared[k].emplace_back(scene, v, scene.planes[k], ratio);
    const Patch patch(view, middle);
    const auto differs = [&](int i) { return compared[k][i].Difference(view, middle, patch); };
    const bool agrees = differs(0) <= kAlike && !(differs(1) < kUnlike) && !(differs(2) < kUnlike);
    (*touched)[cell * scene.planes.size() + k] |= agrees;
  }
}

// The cells of a view that are enclosed, or of a whole piece. `plain`: whether each cell may show
// the backdrop, on which only cells between points of their plane are held.
inline std::vector<uint8_t> HeldCells(const FaceScene& scene, int32_t v, const int32_t* labels,
                                      const uint8_t* plain, const EnclosureOptions& options) {
  const FaceView& view = scene.views[v];
  const size_t count = scene.planes.size();
  std::vector<uint8_t> touched(view.num_cells() * count, false);
  for (const ObservedPoint& sight : scene.sights(v)) {
    const FacePoints& points = scene.points;
    const int32_t side = options.side;
    const int32_t left = sight.cell % view.columns / side * side;
    const int32_t top = sight.cell / view.columns / side * side;
    const int32_t right = std::min(left + 2 * side - 1, view.columns);
    const int32_t bottom = std::min(top + 2 * side - 1, view.rows);
    for (int32_t y = std::max(top - side + 1, 0); y < bottom; ++y)
      for (int32_t x = std::max(left - side + 1, 0); x < right; ++x)
        for (int64_t j = points.plane_offsets[sight.point];
             j < points.plane_offsets[sight.point + 1]; ++j)
          touched[(y * view.columns + x) * count + points.planes[j]] = true;
  }
  std::vector<Vec3> inverse_depths;
  for (const Plane& plane : scene.planes) inverse_depths.push_back(view.InverseDepthOf(plane));
  // Planes end before background, and may go on behind round bodies.
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    if (std::isnan(view.shown[cell])) continue;
    const Vec2 at = view.CellCenter(cell);
    for (size_t k = 0; k < count; ++k)
      touched[cell * count + k] |= view.Hides(cell, 1 / Dot(inverse_depths[k], {at.x, at.y, 1}));
  }
  TouchWherePlanesMeet(view, labels, inverse_depths, options.side, &touched);
  TouchWhereTextureAgrees(scene, v, labels, options.side, &touched);
  std::vector<uint8_t> inside(view.num_cells(), false);
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    const int32_t label = labels[cell];
    if (label < 0) continue;
    const Vec3 ray = view.RayOfCell(cell);
    const double depth = scene.planes[label].DepthAlong(view.pose.center, ray);
    inside[cell] = depth > 0 && scene.extents[label].Holds(view.pose.center + depth * ray);
  }
  const CellGrid grid{view.columns, view.rows,      int32_t(count),
                      labels,       touched.data(), inside.data()};
  const bool has_backdrop =
      std::any_of(plain, plain + view.num_cells(), [](uint8_t p) { return p; });
  std::vector<uint8_t> enclosed, held;
  // Objects before a backdrop are seen from outside: slices through a body hide one another.
  do {
    enclosed = EnclosedCells(grid, options);
    held = WholePieces(grid, enclosed, has_backdrop, options.min_share);
  } while (!has_backdrop && TouchBehind(view, labels, held, inverse_depths, &touched));
  for (int32_t cell = 0; cell < view.num_cells(); ++cell)
    if (held[cell] && plain[cell])
      held[cell] = enclosed[cell] && inside[cell] && !grid.IsTouched(cell);
  return held;
}

// Places on planes, and the views that agree on them.
struct PlaneSamples {
  const double* points;    // (S, 3)
  const int32_t* planes;   // (S)
  const int64_t* offsets;  // (S + 1) of the views
  const int32_t* views;
  int64_t count;
};

// Number of the agreeing views of each sample that show it in a held cell of its plane.
inline std::vector<int64_t> CountEnclosing(const FaceScene& scene, const ViewLabels& labels,
                                           const std::vector<const uint8_t*>& plain,
                                           const PlaneSamples& samples,
                                           const EnclosureOptions& options, int num_threads) {
  std::vector<std::vector<uint8_t>> held(scene.views.size());
  ParallelFor(int64_t(held.size()), num_threads, [&](int64_t v, int) {
    held[v] = HeldCells(scene, int32_t(v), labels[v].data(), plain[v], options);
  });
  std::vector<int64_t> counts(samples.count, 0);
  ParallelBlocks(samples.count, num_threads, 4096, [&](int64_t s) {
    const Vec3 point{samples.points[3 * s], samples.points[3 * s + 1], samples.points[3 * s + 2]};
    for (int64_t i = samples.offsets[s]; i < samples.offsets[s + 1]; ++i) {
      const int32_t v = samples.views[i];
      Vec2 pixel;
      double depth;
      if (!scene.views[v].Project(point, &pixel, &depth)) continue;
      const int32_t cell = scene.views[v].CellAt(pixel);
      counts[s] += held[v][cell] && labels[v][cell] == samples.planes[s];
    }
  });
  return counts;
}

}  // namespace colmap_edges
