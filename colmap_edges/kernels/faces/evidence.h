// What each cell of a view costs on each plane, by what is known of the scene.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "faces/grids.h"
#include "faces/patches.h"

namespace colmap_edges {

// Weights of what speaks for and against a plane; each saturates, see `Saturated`.
struct EvidenceWeights {
  double on, before, behind, seen_through, seen_there, unsupported, no_plane;
  double agree, disagree, hidden;  // of what neighbouring views were labelled
  double correlation;              // of the gray around the cell with that in neighbouring views
  double inside;                   // where a plane's points lie around
  double depth_tolerance;          // share of depth that tells one surface from another
};

inline double Saturated(double count, double scale) {
  return count > 0 ? 1 - std::exp(-count / scale) : 0;
}

// Cells of a view that a plane has to explain as well as any to be looked for in it.
constexpr int32_t kMinCells = 6;
// What observed points say against a plane, beyond which nothing else is asked.
constexpr double kHopeless = 0.8;
constexpr int kPatchCells = 2;   // cells, each way, that one patch stands for
constexpr int kMaxCompared = 3;  // views that a patch is compared with

struct ObservedPoint {
  int32_t point;
  int32_t cell;
  double depth;
};

// Depths and costs of the labels of a view's cells: its planes, then none.
struct ViewCosts {
  std::vector<int32_t> planes;       // of the labels
  std::vector<float> costs, depths;  // (cells, planes + 1)
  std::vector<bool> hopeless;        // (cells, planes + 1), of which other views are not asked
};

class FaceScene {
 public:
  std::vector<FaceView> views;
  std::vector<Plane> planes;
  std::vector<Extent> extents;  // of the planes
  FacePoints points;
  std::vector<std::vector<int32_t>> observed;   // of each view: points
  std::vector<std::vector<int32_t>> neighbors;  // of each view: views that look at the same
  Vec3 center;                                  // of the scene
  double reach = 0;                             // from it, within which surfaces may be
  EvidenceWeights weights;

  // Points and planes as views see them; the nearest depth in every cell.
  void Prepare(int32_t v) {
    const FaceView& view = views[v];
    auto& seen = sights_[v];
    auto& nearest = nearest_[v];
    for (const Plane& plane : planes) inverse_depths_[v].push_back(view.InverseDepthOf(plane));
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
    inverse_depths_.assign(views.size(), {});
  }

  // The planes on which at least `min_cells` cells of a view have as many observed points as on
  // any.
  std::vector<int32_t> PlanesOf(int32_t v, int32_t min_cells, std::vector<int32_t>* counts) const;

  // By what is observed.
  ViewCosts Costs(int32_t v) const;
  // By the labels of all views, planes or -1.
  void AddLabels(int32_t v, const std::vector<std::vector<int32_t>>& labels, ViewCosts* made) const;

 private:
  bool IsOn(int32_t point, int32_t plane) const {
    const auto begin = points.planes.begin() + points.plane_offsets[point];
    const auto end = points.planes.begin() + points.plane_offsets[point + 1];
    return std::binary_search(begin, end, plane);
  }
  void AddPoints(int32_t v, ViewCosts* made) const;
  void AddSights(int32_t v, ViewCosts* made) const;
  void AddCorrelation(int32_t v, ViewCosts* made) const;

  std::vector<std::vector<ObservedPoint>> sights_;
  std::vector<std::vector<double>> nearest_;
  std::vector<std::vector<Vec3>> inverse_depths_;  // of the planes, see `InverseDepthOf`
};

inline std::vector<int32_t> FaceScene::PlanesOf(int32_t v, int32_t min_cells,
                                                std::vector<int32_t>* counts) const {
  counts->assign(planes.size(), 0);
  std::vector<int32_t> here(planes.size(), 0), won(planes.size(), 0), touched;
  std::vector<std::pair<int32_t, int32_t>> by_cell;
  for (const ObservedPoint& sight : sights_[v]) by_cell.emplace_back(sight.cell, sight.point);
  std::sort(by_cell.begin(), by_cell.end());
  for (size_t i = 0; i < by_cell.size();) {
    const int32_t cell = by_cell[i].first;
    for (; i < by_cell.size() && by_cell[i].first == cell; ++i) {
      const int32_t point = by_cell[i].second;
      for (int64_t k = points.plane_offsets[point]; k < points.plane_offsets[point + 1]; ++k) {
        const int32_t plane = points.planes[k];
        ++(*counts)[plane];
        if (here[plane]++ == 0) touched.push_back(plane);
      }
    }
    int32_t most = 0;
    for (const int32_t plane : touched) most = std::max(most, here[plane]);
    for (const int32_t plane : touched) won[plane] += here[plane] == most, here[plane] = 0;
    touched.clear();
  }
  std::vector<int32_t> chosen;
  for (int32_t p = 0; p < int32_t(planes.size()); ++p)
    if (won[p] >= min_cells) chosen.push_back(p);
  return chosen;
}

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

inline bool SameSide(const Plane& plane, const FaceView& one, const FaceView& other) {
  return plane.Distance(one.pose.center) * plane.Distance(other.pose.center) > 0;
}

// Where the places along rays of a view lie in its neighbours.
class Neighborhood {
 public:
  Neighborhood(const FaceScene& scene, int32_t v, const std::vector<int32_t>& planes)
      : view_(scene.views[v]) {
    for (const int32_t u : scene.neighbors[v]) {
      const FaceView& other = scene.views[u];
      others_.push_back(&other);
      origins_.push_back(other.pose.FromWorld(view_.pose.center));
      for (const int32_t plane : planes)
        same_sides_.push_back(SameSide(scene.planes[plane], view_, other));
    }
    directions_.resize(others_.size());
    num_planes_ = planes.size();
  }

  size_t size() const { return others_.size(); }
  bool IsSameSide(size_t j, int32_t k) const { return same_sides_[j * num_planes_ + k]; }
  // Turns to the ray of a cell.
  void TurnTo(int32_t cell) {
    const Vec3 ray = view_.RayOfCell(cell);
    for (size_t j = 0; j < others_.size(); ++j) directions_[j] = others_[j]->pose.Rotate(ray);
  }
  // Pixel, cell and depth in a neighbour of the place at a depth; false outside its picture.
  bool Find(size_t j, double depth, Vec2* pixel, int32_t* cell, double* at) const {
    const FaceView& other = *others_[j];
    if (!other.ProjectLocal(origins_[j] + depth * directions_[j], pixel, at)) return false;
    *cell = other.CellAt(*pixel);
    return true;
  }

 private:
  const FaceView& view_;
  std::vector<const FaceView*> others_;
  std::vector<Vec3> origins_, directions_;  // of the ray, in the coordinates of the neighbours
  std::vector<uint8_t> same_sides_;         // whether both views see the same side of a plane
  size_t num_planes_;
};

// What neighbouring views were labelled at a place on a plane.
struct NeighborLabels {
  double agree = 0, disagree = 0, hidden = 0;

  // `inverse`: of the depth at which the other view sees the plane of its label.
  void Add(double inverse, double depth, double tolerance, bool same_side) {
    if (!(inverse > 0)) return;
    if (1 > depth * (1 + tolerance) * inverse) {
      ++disagree;
    } else if (same_side) {
      const bool nearer = 1 < depth * (1 - tolerance) * inverse;
      (nearer ? hidden : agree) += nearer ? 1 : 0.5;
    }
  }
  double Cost(const EvidenceWeights& weights) const {
    return weights.disagree * Saturated(disagree, 2) - weights.agree * Saturated(agree, 2) +
           weights.hidden * hidden / (1 + hidden + agree + disagree);
  }
};

inline void FaceScene::AddSights(int32_t v, ViewCosts* made) const {
  const int32_t num_planes = int32_t(made->planes.size());
  const double tolerance = weights.depth_tolerance;
  Neighborhood around(*this, v, made->planes);
  for (int32_t cell = 0; cell < views[v].num_cells(); ++cell) {
    around.TurnTo(cell);
    for (int32_t k = 0; k < num_planes; ++k) {
      const size_t i = size_t(cell) * (num_planes + 1) + k;
      made->hopeless[i] = std::isnan(made->depths[i]) || made->costs[i] > kHopeless;
      if (made->hopeless[i]) continue;
      int through = 0, there = 0;
      for (size_t j = 0; j < around.size(); ++j) {
        Vec2 pixel;
        int32_t theirs;
        double at;
        if (!around.Find(j, made->depths[i], &pixel, &theirs, &at)) continue;
        const double nearest = nearest_[neighbors[v][j]][theirs];
        through += nearest > at * (1 + 2 * tolerance);
        there += std::abs(nearest - at) < tolerance / 2 * at && around.IsSameSide(j, k);
      }
      made->costs[i] += float(weights.seen_through * Saturated(through, 2) -
                              weights.seen_there * Saturated(there, 2));
    }
  }
}

inline void FaceScene::AddCorrelation(int32_t v, ViewCosts* made) const {
  const FaceView& view = views[v];
  const int32_t num_planes = int32_t(made->planes.size());
  std::vector<std::vector<std::pair<const FaceView*, Mat3>>> compared(num_planes);
  for (int32_t k = 0; k < num_planes; ++k) {
    const Plane& plane = planes[made->planes[k]];
    for (const int32_t u : neighbors[v])
      if (SameSide(plane, view, views[u]))
        compared[k].emplace_back(&views[u], PlaneHomography(view, plane, views[u]));
  }
  for (int32_t y = 0; y < view.rows; y += kPatchCells) {
    for (int32_t x = 0; x < view.columns; x += kPatchCells) {
      const int32_t right = std::min(x + kPatchCells, view.columns);
      const int32_t bottom = std::min(y + kPatchCells, view.rows);
      const Vec2 middle{FaceView::kCellPx * (x + right) / 2.0,
                        FaceView::kCellPx * (y + bottom) / 2.0};
      const Patch patch(view, middle);
      if (patch.variance() <= kGrayNoise) continue;
      const Vec3 ray = view.RayThrough(middle);
      for (int32_t k = 0; k < num_planes; ++k) {
        const auto at = [&](int32_t i, int32_t j) {
          return (size_t(j) * view.columns + i) * (num_planes + 1) + k;
        };
        bool hopeless = true;
        for (int32_t j = y; j < bottom; ++j)
          for (int32_t i = x; i < right; ++i) hopeless &= made->hopeless[at(i, j)];
        if (hopeless) continue;
        const double depth = planes[made->planes[k]].DepthAlong(view.pose.center, ray);
        const Vec3 point = view.pose.center + depth * ray;
        float least = 2, most = -1;
        int tried = 0;
        for (const auto& [other, homography] : compared[k]) {
          Vec2 pixel;
          double at_depth;
          if (!other->Project(point, &pixel, &at_depth)) continue;
          const float difference = patch.Difference(homography, *other, kGrayNoise);
          if (std::isnan(difference)) continue;
          least = std::min(least, difference), most = std::max(most, difference);
          if (++tried == kMaxCompared) break;
        }
        if (tried == 0) continue;
        const float cost = float(weights.correlation) * (least + most) / 2;
        for (int32_t j = y; j < bottom; ++j)
          for (int32_t i = x; i < right; ++i)
            if (!made->hopeless[at(i, j)]) made->costs[at(i, j)] += cost;
      }
    }
  }
}

inline void FaceScene::AddLabels(int32_t v, const std::vector<std::vector<int32_t>>& labels,
                                 ViewCosts* made) const {
  const int32_t num_planes = int32_t(made->planes.size());
  Neighborhood around(*this, v, made->planes);
  for (int32_t cell = 0; cell < views[v].num_cells(); ++cell) {
    around.TurnTo(cell);
    for (int32_t k = 0; k < num_planes; ++k) {
      const size_t i = size_t(cell) * (num_planes + 1) + k;
      if (made->hopeless[i]) continue;
      NeighborLabels votes;
      for (size_t j = 0; j < around.size(); ++j) {
        Vec2 pixel;
        int32_t theirs;
        double at;
        if (!around.Find(j, made->depths[i], &pixel, &theirs, &at)) continue;
        const int32_t u = neighbors[v][j], label = labels[u][theirs];
        const bool same_side = around.IsSameSide(j, k);
        if (label == made->planes[k]) {
          votes.agree += same_side;
        } else if (label >= 0) {
          const Vec3& inverse = inverse_depths_[u][label];
          votes.Add(inverse.x * pixel.x + inverse.y * pixel.y + inverse.z, at,
                    weights.depth_tolerance, same_side);
        }
      }
      made->costs[i] += float(votes.Cost(weights));
    }
  }
}

inline ViewCosts FaceScene::Costs(int32_t v) const {
  const FaceView& view = views[v];
  ViewCosts made;
  std::vector<int32_t> counts;
  made.planes = PlanesOf(v, kMinCells, &counts);
  const int32_t num_planes = int32_t(made.planes.size()), num_labels = num_planes + 1;
  const size_t size = size_t(view.num_cells()) * num_labels;
  made.depths.assign(size, NAN), made.costs.assign(size, 0), made.hopeless.assign(size, true);
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    const Vec3 ray = view.RayOfCell(cell);
    for (int32_t k = 0; k < num_planes; ++k) {
      const double depth = planes[made.planes[k]].DepthAlong(view.pose.center, ray);
      const Vec3 point = view.pose.center + depth * ray;
      if (!(Norm(point - center) <= reach)) continue;
      made.depths[size_t(cell) * num_labels + k] = float(depth);
      if (extents[made.planes[k]].Holds(point))
        made.costs[size_t(cell) * num_labels + k] -= float(weights.inside);
    }
  }
  AddPoints(v, &made);
  AddSights(v, &made);
  if (weights.correlation > 0) AddCorrelation(v, &made);
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    float* costs = &made.costs[size_t(cell) * num_labels];
    for (int32_t k = 0; k < num_planes; ++k) {
      costs[k] += float(1 + weights.unsupported * std::exp(-counts[made.planes[k]] / 15.0));
      if (std::isnan(made.depths[size_t(cell) * num_labels + k]))
        costs[k] = std::numeric_limits<float>::infinity();
    }
    costs[num_planes] = float(weights.no_plane);
  }
  return made;
}

}  // namespace colmap_edges
