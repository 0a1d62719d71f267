// What each cell of a view costs on each plane, by what is known of the scene.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "faces/grids.h"

namespace colmap_edges {

// Weights of what speaks for and against a plane; each saturates, see `Saturated`.
struct EvidenceWeights {
  double on, before, behind, seen_through, seen_there, unsupported, no_plane;
  double agree, disagree, hidden;    // of what neighbouring views were labelled
  double correlation;                // of the gray around the cell with that in neighbouring views
  double depth_tolerance;            // share of depth that tells one surface from another
};

inline double Saturated(double count, double scale) { return 1 - std::exp(-count / scale); }

struct ObservedPoint {
  int32_t point;
  int32_t cell;
  double depth;
};

// Depths and costs of the labels of a view's cells: its planes, then none.
struct ViewCosts {
  std::vector<int32_t> planes;  // of the labels
  std::vector<double> costs, depths;  // (cells, planes + 1)
};

class FaceScene {
 public:
  std::vector<FaceView> views;
  std::vector<Plane> planes;
  FacePoints points;
  std::vector<std::vector<int32_t>> observed;    // of each view: points
  std::vector<std::vector<int32_t>> neighbors;   // of each view: views that look at the same
  Vec3 center;                                   // of the scene
  double reach = 0;                              // from it, within which surfaces may be
  EvidenceWeights weights;

  // Points as their views see them; the nearest depth in every cell.
  void Prepare(int32_t v) {
    const FaceView& view = views[v];
    auto& seen = sights_[v];
    auto& nearest = nearest_[v];
    nearest.assign(view.num_cells(), NAN);
    for (const int32_t p : observed[v]) {
      Vec2 pixel;
      double depth;
      if (!view.Project(points.points[p], &pixel, &depth)) continue;
      const int32_t cell = view.CellAt(pixel);
      seen.push_back({p, cell, depth});
      if (!(nearest[cell] <= depth)) nearest[cell] = depth;
    }
  }
  void Allocate() {
    sights_.assign(views.size(), {});
    nearest_.assign(views.size(), {});
  }

  // The planes that at least `min_points` observed points of a view lie on.
  std::vector<int32_t> PlanesOf(int32_t v, int32_t min_points, std::vector<int32_t>* counts) const {
    counts->assign(planes.size(), 0);
    for (const ObservedPoint& sight : sights_[v])
      for (int64_t k = points.plane_offsets[sight.point];
           k < points.plane_offsets[sight.point + 1]; ++k)
        ++(*counts)[points.planes[k]];
    std::vector<int32_t> chosen;
    for (int32_t p = 0; p < int32_t(planes.size()); ++p)
      if ((*counts)[p] >= min_points) chosen.push_back(p);
    return chosen;
  }

  // `labels`: of all views, planes or -1, to agree with; empty at first.
  ViewCosts Costs(int32_t v, const std::vector<std::vector<int32_t>>& labels) const;

 private:
  bool IsOn(int32_t point, int32_t plane) const {
    const auto begin = points.planes.begin() + points.plane_offsets[point];
    const auto end = points.planes.begin() + points.plane_offsets[point + 1];
    return std::binary_search(begin, end, plane);
  }
  void AddPoints(int32_t v, ViewCosts* made) const;
  void AddNeighbors(int32_t v, const std::vector<std::vector<int32_t>>& labels,
                    ViewCosts* made) const;
  double Correlation(const FaceView& view, int32_t cell, const Plane& plane,
                     const FaceView& other) const;

  std::vector<std::vector<ObservedPoint>> sights_;
  std::vector<std::vector<double>> nearest_;
};

inline void FaceScene::AddPoints(int32_t v, ViewCosts* made) const {
  const FaceView& view = views[v];
  const int32_t num_planes = int32_t(made->planes.size());
  const size_t size = size_t(view.num_cells()) * (num_planes + 1);
  std::vector<float> on(size, 0), before(size, 0), behind(size, 0);
  const double tolerance = weights.depth_tolerance;
  std::vector<uint8_t> is_on(num_planes);
  for (const ObservedPoint& sight : sights_[v]) {
    for (int32_t k = 0; k < num_planes; ++k) is_on[k] = IsOn(sight.point, made->planes[k]);
    const int32_t x = sight.cell % view.columns, y = sight.cell / view.columns;
    for (int32_t j = std::max(y - 1, 0); j <= std::min(y + 1, view.rows - 1); ++j) {
      for (int32_t i = std::max(x - 1, 0); i <= std::min(x + 1, view.columns - 1); ++i) {
        const float weight = i == x && j == y ? 1.f : 0.15f;
        const size_t row = (size_t(j) * view.columns + i) * (num_planes + 1);
        for (int32_t k = 0; k < num_planes; ++k) {
          const double depth = made->depths[row + k];
          if (is_on[k]) {
            on[row + k] += weight;
          } else if (depth < sight.depth * (1 - tolerance)) {
            before[row + k] += weight;
          } else if (depth > sight.depth * (1 + tolerance)) {
            behind[row + k] += weight;
          }
        }
      }
    }
  }
  for (size_t i = 0; i < size; ++i)
    made->costs[i] += -weights.on * Saturated(on[i], 3) + weights.before * Saturated(before[i], 2) +
                      weights.behind * Saturated(behind[i], 2);
}

inline double FaceScene::Correlation(const FaceView& view, int32_t cell, const Plane& plane,
                                     const FaceView& other) const {
  constexpr int kRadius = 4;  // pixels of the small pictures, every second
  const Vec2 middle = view.CellCenter(cell);
  double sum_a = 0, sum_b = 0, sum_aa = 0, sum_bb = 0, sum_ab = 0;
  int count = 0;
  for (int dy = -kRadius; dy <= kRadius; dy += 2) {
    for (int dx = -kRadius; dx <= kRadius; dx += 2) {
      const Vec2 pixel = {middle.x + dx, middle.y + dy};
      if (pixel.x < 0 || pixel.y < 0 || pixel.x >= view.width() || pixel.y >= view.height())
        continue;
      const Vec3 ray = view.RayThrough(pixel);
      const double depth = plane.DepthAlong(view.pose.center, ray);
      if (std::isnan(depth)) return NAN;
      Vec2 there;
      double unused;
      if (!other.Project(view.pose.center + depth * ray, &there, &unused)) return NAN;
      const double x = std::clamp(there.x - 0.5, 0.0, other.width() - 1.001);
      const double y = std::clamp(there.y - 0.5, 0.0, other.height() - 1.001);
      const int32_t c = int32_t(x), r = int32_t(y);
      const double s = x - c, t = y - r;
      const uint8_t* at = other.gray + size_t(r) * other.width() + c;
      const double b = (1 - t) * ((1 - s) * at[0] + s * at[1]) +
                       t * ((1 - s) * at[other.width()] + s * at[other.width() + 1]);
      const double a = view.gray[size_t(pixel.y) * view.width() + int32_t(pixel.x)];
      sum_a += a, sum_b += b, sum_aa += a * a, sum_bb += b * b, sum_ab += a * b;
      ++count;
    }
  }
  if (count < 9) return NAN;
  const double noise = 4.0;  // variance of gray that is no texture
  const double aa = sum_aa / count - sum_a * sum_a / count / count;
  const double bb = sum_bb / count - sum_b * sum_b / count / count;
  const double ab = sum_ab / count - sum_a * sum_b / count / count;
  const double difference = aa + bb - 2 * ab;
  // Share of the variance that the other does not explain, in [0, 1]; 0 without texture.
  return std::min(1.0, difference / (aa + bb + 2 * noise)) ;
}

inline void FaceScene::AddNeighbors(int32_t v, const std::vector<std::vector<int32_t>>& labels,
                                    ViewCosts* made) const {
  const FaceView& view = views[v];
  const int32_t num_planes = int32_t(made->planes.size());
  const double tolerance = weights.depth_tolerance;
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    const Vec3 ray = view.RayOfCell(cell);
    for (int32_t k = 0; k < num_planes; ++k) {
      const size_t i = size_t(cell) * (num_planes + 1) + k;
      const double depth = made->depths[i];
      if (std::isnan(depth)) continue;
      const Vec3 point = view.pose.center + depth * ray;
      double through = 0, there = 0, agree = 0, disagree = 0, hidden = 0;
      double differences[3] = {1, 1, 1};
      int tried = 0;
      for (const int32_t u : neighbors[v]) {
        const FaceView& other = views[u];
        Vec2 pixel;
        double at;
        if (!other.Project(point, &pixel, &at)) continue;
        const int32_t c = other.CellAt(pixel);
        const double nearest = nearest_[u][c];
        through += nearest > at * (1 + 2 * tolerance);
        there += std::abs(nearest - at) < tolerance / 2 * at;
        if (tried < 3 && weights.correlation > 0) {
          const double d = Correlation(view, cell, planes[made->planes[k]], other);
          if (!std::isnan(d)) differences[tried++] = d;
        }
        if (labels.empty()) continue;
        const int32_t label = labels[u][c];
        if (label < 0) continue;
        if (label == made->planes[k]) {
          ++agree;
          continue;
        }
        const double theirs =
            planes[label].DepthAlong(other.pose.center, other.RayThrough(pixel));
        if (theirs > at * (1 + tolerance)) {
          ++disagree;
        } else if (theirs < at * (1 - tolerance)) {
          ++hidden;
        } else {
          agree += 0.5;
        }
      }
      made->costs[i] += weights.seen_through * Saturated(through, 2) -
                        weights.seen_there * Saturated(there, 2);
      if (tried > 0) {
        std::sort(differences, differences + tried);
        made->costs[i] += weights.correlation * differences[tried / 2];
      }
      if (!labels.empty())
        made->costs[i] += -weights.agree * Saturated(agree, 2) +
                          weights.disagree * Saturated(disagree, 2) +
                          weights.hidden * hidden / (1 + hidden + agree + disagree);
    }
  }
}

inline ViewCosts FaceScene::Costs(int32_t v,
                                  const std::vector<std::vector<int32_t>>& labels) const {
  const FaceView& view = views[v];
  ViewCosts made;
  std::vector<int32_t> counts;
  made.planes = PlanesOf(v, 3, &counts);
  if (!labels.empty()) {  // and those that neighbours see here
    std::vector<uint8_t> seen(planes.size(), 0);
    for (const int32_t u : neighbors[v])
      for (const int32_t label : labels[u])
        if (label >= 0) seen[label] = 1;
    for (const int32_t p : made.planes) seen[p] = 1;
    made.planes.clear();
    for (int32_t p = 0; p < int32_t(planes.size()); ++p)
      if (seen[p]) made.planes.push_back(p);
  }
  const int32_t num_planes = int32_t(made.planes.size()), num_labels = num_planes + 1;
  made.depths.assign(size_t(view.num_cells()) * num_labels, NAN);
  made.costs.assign(size_t(view.num_cells()) * num_labels, 0);
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    const Vec3 ray = view.RayOfCell(cell);
    for (int32_t k = 0; k < num_planes; ++k) {
      const double depth = planes[made.planes[k]].DepthAlong(view.pose.center, ray);
      if (Norm(view.pose.center + depth * ray - center) <= reach)
        made.depths[size_t(cell) * num_labels + k] = depth;
    }
  }
  AddPoints(v, &made);
  AddNeighbors(v, labels, &made);
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    double* costs = &made.costs[size_t(cell) * num_labels];
    for (int32_t k = 0; k < num_planes; ++k) {
      costs[k] += 1 + weights.unsupported * std::exp(-counts[made.planes[k]] / 15.0);
      if (std::isnan(made.depths[size_t(cell) * num_labels + k]))
        costs[k] = std::numeric_limits<double>::infinity();
    }
    costs[num_planes] = weights.no_plane;
  }
  return made;
}

}  // namespace colmap_edges
