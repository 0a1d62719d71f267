// What each cell of a view costs on each plane, by what is known of the scene.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "faces/grids.h"
#include "faces/patches.h"

namespace colmap_edges {

// Weights of what speaks for and against a plane; each saturates, see `Saturated`.
struct EvidenceWeights {
  double on, before, seen_through, no_plane;
  double agree, disagree, hidden;  // of what neighbouring views were labelled
  double correlation;              // of the gray around the cell with that in neighbouring views
  double inside;                   // where a plane's points lie around
  double depth_tolerance;          // share of depth that tells one surface from another
  double missed;                   // points on a plane that neighbours observe, and the view not
};

inline double Saturated(double count, double scale) {
  return count > 0 ? 1 - std::exp(-count / scale) : 0;
}

// Cells of a view that a plane has to explain as well as any to be looked for in it, or in which
// neighbours show it.
constexpr int32_t kMinCells = 6;
// What observed points say against a plane, beyond which nothing else is asked.
constexpr double kHopeless = 0.8;
constexpr float kNextCell = 0.15f;  // of what a point says of its cell, for the eight around it
constexpr int kPatchCells = 2;      // cells, each way, that one patch stands for
constexpr int kMaxCompared = 3;     // views that a patch is compared with

struct ObservedPoint {
  int32_t point;
  int32_t cell;
  double depth;
};

// A point that neighbours of a view observe and the view does not, though it lies in its picture.
struct MissedPoint {
  int32_t point;
  int32_t cell;
  float weight;  // negative logarithm of how probable it is to miss it where it can be seen
};

inline bool SameSide(const Plane& plane, const FaceView& one, const FaceView& other) {
  return plane.Distance(one.pose.center) * plane.Distance(other.pose.center) > 0;
}

// Depths and costs of the labels of a view's cells: its planes, then none.
struct ViewCosts {
  std::vector<int32_t> planes;       // of the labels
  std::vector<int32_t> labels;       // of all planes; -1 of those that are none of the labels
  std::vector<float> costs, depths;  // (cells, planes + 1)
  std::vector<uint8_t> hopeless;     // (cells, planes + 1), of which other views are not asked

  ViewCosts() = default;
  ViewCosts(std::vector<int32_t> of_view, size_t num_planes)
      : planes(std::move(of_view)), labels(num_planes, -1) {
    for (size_t k = 0; k < planes.size(); ++k) labels[planes[k]] = int32_t(k);
  }

  int32_t none() const { return int32_t(planes.size()); }
  // Labels of planes or -1, and the other way round.
  std::vector<int32_t> LabelsOf(const std::vector<int32_t>& of_cells) const {
    std::vector<int32_t> made;
    for (const int32_t plane : of_cells) made.push_back(plane < 0 ? none() : labels[plane]);
    return made;
  }
  std::vector<int32_t> PlanesOf(const std::vector<int32_t>& of_cells) const {
    std::vector<int32_t> made;
    for (const int32_t label : of_cells) made.push_back(label == none() ? -1 : planes[label]);
    return made;
  }
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
      if (!(nearest[cell] <= depth)) nearest[cell] = float(depth);
    }
    for (int32_t cell = 0; cell < view.num_cells(); ++cell)
      if (view.IsBackground(cell)) nearest[cell] = std::numeric_limits<float>::infinity();
  }
  void Allocate() {
    sights_.assign(views.size(), {});
    nearest_.assign(views.size(), {});
    inverse_depths_.assign(views.size(), {});
  }

  // The observed points of a view that lie in its picture.
  const std::vector<ObservedPoint>& sights(int32_t v) const { return sights_[v]; }
  // The planes on which at least `min_cells` cells of a view have as many observed points as on
  // any.
  std::vector<int32_t> PlanesOf(int32_t v, int32_t min_cells) const;

  // The planes that neighbours on the same side of them were labelled with at places in at least
  // `min_cells` cells of a view.
  std::vector<int32_t> PlanesAround(int32_t v, const std::vector<std::vector<int32_t>>& labels,
                                    int32_t min_cells) const;

  // The depth at which a view's cell, which shows no background, would show a plane along its ray;
  // NaN where it cannot.
  double DepthAt(int32_t v, int32_t cell, const Vec3& ray, int32_t plane) const {
    const FaceView& view = views[v];
    const double depth = planes[plane].DepthAlong(view.pose.center, ray);
    const bool is_near = Norm(view.pose.center + depth * ray - center) <= reach;
    return is_near && !view.Hides(cell, depth) ? depth : NAN;
  }

  // Of some planes by what is observed.
  ViewCosts Costs(int32_t v, std::vector<int32_t> planes_of_view) const {
    ViewCosts made(std::move(planes_of_view), planes.size());
    AddCosts(v, std::vector<uint8_t>(size_t(views[v].num_cells()) * (made.none() + 1), 1), &made);
    return made;
  }
  // Of the labels (cells, labels) that are asked for; others cost infinitely much.
  void AddCosts(int32_t v, const std::vector<uint8_t>& asked, ViewCosts* made) const;
  // By the labels of all views, planes or -1.
  void AddLabels(int32_t v, const std::vector<std::vector<int32_t>>& labels, ViewCosts* made) const;

 private:
  // The labels of the planes that a point lies on.
  void LabelsOf(int32_t point, const ViewCosts& made, std::vector<int32_t>* labels) const {
    labels->clear();
    for (int64_t j = points.plane_offsets[point]; j < points.plane_offsets[point + 1]; ++j)
      if (made.labels[points.planes[j]] >= 0) labels->push_back(made.labels[points.planes[j]]);
  }
  void AddPoints(int32_t v, ViewCosts* made) const;
  std::vector<MissedPoint> MissedBy(int32_t v) const;
  void AddMissed(int32_t v, ViewCosts* made) const;
  void AddSights(int32_t v, ViewCosts* made) const;
  void AddCorrelation(int32_t v, ViewCosts* made) const;

  std::vector<std::vector<ObservedPoint>> sights_;
  std::vector<std::vector<float>> nearest_;
  std::vector<std::vector<Vec3>> inverse_depths_;  // of the planes, see `InverseDepthOf`
};

inline std::vector<int32_t> FaceScene::PlanesOf(int32_t v, int32_t min_cells) const {
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

inline std::vector<int32_t> FaceScene::PlanesAround(int32_t v,
                                                    const std::vector<std::vector<int32_t>>& labels,
                                                    int32_t min_cells) const {
  const FaceView& view = views[v];
  std::vector<uint8_t> shown(planes.size() * view.num_cells(), false);
  std::vector<int32_t> counts(planes.size(), 0), chosen;
  for (const int32_t u : neighbors[v]) {
    const FaceView& other = views[u];
    for (int32_t cell = 0; cell < other.num_cells(); ++cell) {
      const int32_t plane = labels[u][cell];
      if (plane < 0 || !SameSide(planes[plane], view, other)) continue;
      const Vec3 ray = other.RayOfCell(cell);
      const double along = planes[plane].DepthAlong(other.pose.center, ray);
      Vec2 pixel;
      double depth;
      if (!view.Project(other.pose.center + along * ray, &pixel, &depth)) continue;
      uint8_t& is_shown = shown[size_t(plane) * view.num_cells() + view.CellAt(pixel)];
      counts[plane] += !is_shown, is_shown = true;
    }
  }
  for (int32_t p = 0; p < int32_t(planes.size()); ++p)
    if (counts[p] >= min_cells) chosen.push_back(p);
  return chosen;
}

inline void FaceScene::AddPoints(int32_t v, ViewCosts* made) const {
  const FaceView& view = views[v];
  const int32_t num_planes = int32_t(made->planes.size());
  const size_t size = size_t(view.num_cells()) * (num_planes + 1);
  std::vector<float> on(size, 0), before(size, 0);
  const double tolerance = weights.depth_tolerance;
  std::vector<float> is_off(num_planes, 1);
  std::vector<int32_t> own;
  for (const ObservedPoint& sight : sights_[v]) {
    LabelsOf(sight.point, *made, &own);
    for (const int32_t k : own) is_off[k] = 0;
    const float nearest = float(sight.depth * (1 - tolerance));
    const int32_t x = sight.cell % view.columns, y = sight.cell / view.columns;
    for (int32_t j = std::max(y - 1, 0); j <= std::min(y + 1, view.rows - 1); ++j) {
      for (int32_t i = std::max(x - 1, 0); i <= std::min(x + 1, view.columns - 1); ++i) {
        const float weight = i == x && j == y ? 1.f : kNextCell;
        const size_t row = (size_t(j) * view.columns + i) * (num_planes + 1);
        const float* depths = &made->depths[row];
        for (const int32_t k : own) on[row + k] += weight;
        for (int32_t k = 0; k < num_planes; ++k)
          before[row + k] += depths[k] < nearest ? weight * is_off[k] : 0;
      }
    }
    for (const int32_t k : own) is_off[k] = 1;
  }
  for (size_t i = 0; i < size; ++i)
    made->costs[i] += weights.before * Saturated(before[i], 2) - weights.on * Saturated(on[i], 3);
}

// The more of the neighbours that could see a point observe it, the less probable it is to miss it.
inline std::vector<MissedPoint> FaceScene::MissedBy(int32_t v) const {
  std::vector<int32_t> seen, own = observed[v];
  std::sort(own.begin(), own.end());
  for (const int32_t u : neighbors[v])
    for (const int32_t p : observed[u])
      if (points.plane_offsets[p] < points.plane_offsets[p + 1]) seen.push_back(p);
  std::sort(seen.begin(), seen.end());
  std::vector<MissedPoint> missed;
  for (size_t i = 0; i < seen.size();) {
    const int32_t p = seen[i];
    int count = 0, holding = 1;  // the view itself can see it
    for (; i < seen.size() && seen[i] == p; ++i) ++count;
    Vec2 pixel;
    double depth;
    if (std::binary_search(own.begin(), own.end(), p) ||
        !views[v].Project(points.points[p], &pixel, &depth))
      continue;
    const int32_t cell = views[v].CellAt(pixel);
    for (const int32_t u : neighbors[v])
      holding += views[u].Project(points.points[p], &pixel, &depth);
    missed.push_back({p, cell, -std::log1p(-float(count) / float(holding))});
  }
  return missed;
}

inline void FaceScene::AddMissed(int32_t v, ViewCosts* made) const {
  const FaceView& view = views[v];
  const int32_t num_planes = int32_t(made->planes.size());
  std::vector<float> missed(made->costs.size(), 0);
  std::vector<int32_t> own;
  for (const MissedPoint& point : MissedBy(v)) {
    const int32_t x = point.cell % view.columns, y = point.cell / view.columns;
    LabelsOf(point.point, *made, &own);
    for (const int32_t k : own) {
      for (int32_t j = std::max(y - 1, 0); j <= std::min(y + 1, view.rows - 1); ++j) {
        for (int32_t i = std::max(x - 1, 0); i <= std::min(x + 1, view.columns - 1); ++i) {
          const float share = i == x && j == y ? 1.f : kNextCell;
          missed[(size_t(j) * view.columns + i) * (num_planes + 1) + k] += share * point.weight;
        }
      }
    }
  }
  for (size_t i = 0; i < missed.size(); ++i)
    made->costs[i] += float(weights.missed * Saturated(missed[i], 2));
}

// Where planes meet the rays of a row of cells; only those of which other views are asked.
struct RowPlaces {
  double y;                      // pixel, of the row
  std::vector<float> x, depths;  // pixels
  std::vector<int32_t> planes;   // their places among the labels
  std::vector<size_t> entries;   // of the view's costs

  RowPlaces(const FaceView& view, const ViewCosts& costs, int32_t row)
      : y((row + 0.5) * FaceView::kCellPx) {
    const int32_t num_planes = int32_t(costs.planes.size());
    for (int32_t column = 0; column < view.columns; ++column) {
      const size_t begin = (size_t(row) * view.columns + column) * (num_planes + 1);
      for (int32_t k = 0; k < num_planes; ++k) {
        if (costs.hopeless[begin + k]) continue;
        x.push_back((column + 0.5f) * FaceView::kCellPx), depths.push_back(costs.depths[begin + k]);
        planes.push_back(k), entries.push_back(begin + k);
      }
    }
  }
  size_t size() const { return entries.size(); }
};

// The same places as a neighbour sees them.
struct SeenPlaces {
  std::vector<int32_t> cells;       // -1 outside its picture
  std::vector<float> x, y, depths;  // pixels
};

// The neighbours of a view, as they see places on its rays.
class Neighborhood {
 public:
  Neighborhood(const FaceScene& scene, int32_t v, const std::vector<int32_t>& planes)
      : view_(scene.views[v]), num_planes_(planes.size()) {
    for (const int32_t u : scene.neighbors[v]) {
      const FaceView& other = scene.views[u];
      others_.push_back(&other);
      origins_.push_back(other.pose.FromWorld(view_.pose.center));
      turns_.push_back(MultiplyByTransposed(other.pose.R, view_.pose.R));
      for (const int32_t plane : planes)
        same_sides_.push_back(SameSide(scene.planes[plane], view_, other));
    }
  }

  size_t size() const { return others_.size(); }
  bool IsSameSide(size_t j, int32_t k) const { return same_sides_[j * num_planes_ + k]; }
  void See(size_t j, const RowPlaces& places, SeenPlaces* seen) const {
    const size_t count = places.size();
    seen->cells.resize(count), seen->depths.resize(count);
    seen->x.resize(count), seen->y.resize(count);
    const FaceView& other = *others_[j];
    const Vec3& origin = origins_[j];
    const float ox = float(origin.x), oy = float(origin.y), oz = float(origin.z);
    // The ray through pixel x of the row is (at + x * per_px).
    const double f = view_.pose.focal_px, dy = (places.y - view_.principal.y) / f;
    std::array<float, 3> at, per_px;
    for (int i = 0; i < 3; ++i) {
      const double* turn = &turns_[j][3 * i];
      per_px[i] = float(turn[0] / f);
      at[i] = float(turn[1] * dy + turn[2] - turn[0] / f * view_.principal.x);
    }
    const float focal = float(other.pose.focal_px);
    const float middle_x = float(other.principal.x), middle_y = float(other.principal.y);
    const float width = float(other.width()), height = float(other.height());
    const int32_t columns = other.columns;
    const float* __restrict from = places.x.data();
    const float* __restrict along = places.depths.data();
    float* __restrict to_x = seen->x.data();
    float* __restrict to_y = seen->y.data();
    float* __restrict to_z = seen->depths.data();
    int32_t* __restrict cells = seen->cells.data();
    // Loops of few arrays, which compilers turn into vectors.
    for (size_t i = 0; i < count; ++i) {
      const float z = oz + along[i] * (at[2] + from[i] * per_px[2]);
      to_x[i] = focal * (ox + along[i] * (at[0] + from[i] * per_px[0])) / z + middle_x;
      to_y[i] = focal * (oy + along[i] * (at[1] + from[i] * per_px[1])) / z + middle_y;
      to_z[i] = z;
    }
    for (size_t i = 0; i < count; ++i) {
      const float x = to_x[i], y = to_y[i];
      const int32_t right = int32_t(std::min(std::max(0.f, x), width)) / FaceView::kCellPx;
      const int32_t down = int32_t(std::min(std::max(0.f, y), height)) / FaceView::kCellPx;
      const int32_t inside = int32_t(to_z[i] > 0) & int32_t(x >= 0) & int32_t(y >= 0) &
                             int32_t(x < width) & int32_t(y < height);
      cells[i] = (down * columns + right + 1) * inside - 1;
    }
  }

 private:
  const FaceView& view_;
  std::vector<const FaceView*> others_;
  std::vector<Vec3> origins_;        // the view's centre, in the coordinates of the neighbours
  std::vector<Mat3> turns_;          // from the view's coordinates to those of the neighbours
  std::vector<uint8_t> same_sides_;  // whether both views see the same side of a plane
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
  const float tolerance = float(weights.depth_tolerance);
  for (size_t i = 0; i < made->costs.size(); ++i)
    made->hopeless[i] = std::isnan(made->depths[i]) || made->costs[i] > kHopeless;
  const Neighborhood around(*this, v, made->planes);
  SeenPlaces seen;
  std::vector<float> through;
  for (int32_t row = 0; row < views[v].rows; ++row) {
    const RowPlaces places(views[v], *made, row);
    through.assign(places.size(), 0);
    for (size_t j = 0; j < around.size(); ++j) {
      around.See(j, places, &seen);
      const std::vector<float>& nearest = nearest_[neighbors[v][j]];
      for (size_t i = 0; i < places.size(); ++i) {
        if (seen.cells[i] < 0) continue;
        through[i] += nearest[seen.cells[i]] > seen.depths[i] * (1 + 2 * tolerance);
      }
    }
    for (size_t i = 0; i < places.size(); ++i)
      made->costs[places.entries[i]] += float(weights.seen_through * Saturated(through[i], 2));
  }
}

// A plane with the neighbours of a view that see the same side of it.
struct ComparedPlane {
  Plane plane;
  std::vector<std::pair<const FaceView*, Mat3>> others;

  // The parallel to a plane at `ratio` times its distance from view `v`.
  ComparedPlane(const FaceScene& scene, int32_t v, const Plane& of, double ratio) : plane(of) {
    const FaceView& view = scene.views[v];
    plane.offset += (1 - ratio) * of.Distance(view.pose.center);
    for (const int32_t u : scene.neighbors[v])
      if (SameSide(plane, view, scene.views[u]))
        others.emplace_back(&scene.views[u], PlaneHomography(view, plane, scene.views[u]));
  }

  // How much the gray around a pixel of the view differs from that in others, see
  // `Patch::Difference`; NaN if none sees the place.
  float Difference(const FaceView& view, Vec2 pixel, const Patch& patch) const {
    const Vec3 ray = view.RayThrough(pixel);
    const Vec3 place = view.pose.center + plane.DepthAlong(view.pose.center, ray) * ray;
    std::array<float, kMaxCompared> differences;
    int tried = 0;
    for (const auto& [other, homography] : others) {
      Vec2 seen;
      double depth;
      if (!other->Project(place, &seen, &depth)) continue;
      const float difference = patch.Difference(homography, *other, kGrayNoise);
      if (std::isnan(difference)) continue;
      differences[tried] = difference;
      if (++tried == kMaxCompared) break;
    }
    if (tried == 0) return NAN;
    // The worst of three does not count: something may hide the plane there.
    std::sort(differences.begin(), differences.begin() + tried);
    return (differences[0] + differences[std::min(tried - 1, 1)]) / 2;
  }
};

inline void FaceScene::AddCorrelation(int32_t v, ViewCosts* made) const {
  const FaceView& view = views[v];
  const int32_t num_planes = int32_t(made->planes.size());
  std::vector<ComparedPlane> compared;
  for (const int32_t plane : made->planes) compared.emplace_back(*this, v, planes[plane], 1.0);
  for (int32_t y = 0; y < view.rows; y += kPatchCells) {
    for (int32_t x = 0; x < view.columns; x += kPatchCells) {
      const int32_t right = std::min(x + kPatchCells, view.columns);
      const int32_t bottom = std::min(y + kPatchCells, view.rows);
      const Vec2 middle{FaceView::kCellPx * (x + right) / 2.0,
                        FaceView::kCellPx * (y + bottom) / 2.0};
      const Patch patch(view, middle);
      for (int32_t k = 0; k < num_planes; ++k) {
        const auto at = [&](int32_t i, int32_t j) {
          return (size_t(j) * view.columns + i) * (num_planes + 1) + k;
        };
        bool hopeless = true;
        for (int32_t j = y; j < bottom; ++j)
          for (int32_t i = x; i < right; ++i) hopeless &= made->hopeless[at(i, j)];
        if (hopeless) continue;
        const float difference = compared[k].Difference(view, middle, patch);
        if (std::isnan(difference)) continue;
        const float cost = float(weights.correlation) * difference;
        for (int32_t j = y; j < bottom; ++j)
          for (int32_t i = x; i < right; ++i)
            if (!made->hopeless[at(i, j)]) made->costs[at(i, j)] += cost;
      }
    }
  }
}

inline void FaceScene::AddLabels(int32_t v, const std::vector<std::vector<int32_t>>& labels,
                                 ViewCosts* made) const {
  const Neighborhood around(*this, v, made->planes);
  SeenPlaces seen;
  std::vector<NeighborLabels> votes;
  for (int32_t row = 0; row < views[v].rows; ++row) {
    const RowPlaces places(views[v], *made, row);
    votes.assign(places.size(), {});
    for (size_t j = 0; j < around.size(); ++j) {
      around.See(j, places, &seen);
      const int32_t u = neighbors[v][j];
      for (size_t i = 0; i < places.size(); ++i) {
        if (seen.cells[i] < 0) continue;
        const int32_t k = places.planes[i], label = labels[u][seen.cells[i]];
        const bool same_side = around.IsSameSide(j, k);
        if (label == made->planes[k]) {
          votes[i].agree += same_side;
        } else if (label >= 0) {
          const Vec3& inverse = inverse_depths_[u][label];
          votes[i].Add(inverse.x * seen.x[i] + inverse.y * seen.y[i] + inverse.z, seen.depths[i],
                       weights.depth_tolerance, same_side);
        }
      }
    }
    for (size_t i = 0; i < places.size(); ++i)
      made->costs[places.entries[i]] += float(votes[i].Cost(weights));
  }
}

inline void FaceScene::AddCosts(int32_t v, const std::vector<uint8_t>& asked,
                                ViewCosts* made) const {
  const FaceView& view = views[v];
  const int32_t num_planes = int32_t(made->planes.size()), num_labels = num_planes + 1;
  const size_t size = size_t(view.num_cells()) * num_labels;
  made->depths.assign(size, NAN), made->costs.assign(size, 0), made->hopeless.assign(size, true);
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    if (view.IsBackground(cell)) continue;
    const Vec3 ray = view.RayOfCell(cell);
    for (int32_t k = 0; k < num_planes; ++k) {
      const size_t at = size_t(cell) * num_labels + k;
      if (!asked[at]) continue;
      const double depth = DepthAt(v, cell, ray, made->planes[k]);
      if (std::isnan(depth)) continue;
      made->depths[at] = float(depth);
      if (extents[made->planes[k]].Holds(view.pose.center + depth * ray))
        made->costs[at] -= float(weights.inside);
    }
  }
  AddPoints(v, made);
  AddMissed(v, made);
  AddSights(v, made);
  if (weights.correlation > 0) AddCorrelation(v, made);
  for (int32_t cell = 0; cell < view.num_cells(); ++cell) {
    float* costs = &made->costs[size_t(cell) * num_labels];
    for (int32_t k = 0; k < num_planes; ++k) {
      costs[k] += 1;
      if (std::isnan(made->depths[size_t(cell) * num_labels + k]))
        costs[k] = std::numeric_limits<float>::infinity();
    }
    costs[num_planes] = float(weights.no_plane);
  }
}

}  // namespace colmap_edges
