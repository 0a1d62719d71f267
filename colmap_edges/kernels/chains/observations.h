// Residuals of points of curves on the chains that observe them, with derivatives and the sums of
// the normal equations.
#pragma once

#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "common/edge_index.h"
#include "common/parallel.h"

namespace colmap_edges {

constexpr double kSlack = 1e-4;  // damping of depths that hardly any observation constrains

// Pixels across a line at a tangent `t` from the axis, relative to the same angle on the axis.
inline double Obliquity(double t) { return std::sqrt(1 + t * t); }

// N points on the chains of a reference view, and positions on chains of K views that observe them.
struct ObservedCurves {
  Mat3 rotation;  // of the reference view
  Vec3 translation;
  double focal;
  const double* undistorted;     // (N, 2) pixels of the reference view
  const double* inverse_depths;  // (N)
  const double* directions;      // (N, 2) along which points may move in its image; null for none
  const double* positions;       // (N, K) on the views' chains; NaN where not observed
  int64_t num_points;
  std::vector<const EdgeIndex*> views;
};

// One observation of one point, in pixels: the distance across the chain, its derivatives by
// inverse depth and by a shift of the reference view's pixel, the derivative along the chain by
// inverse depth, the speed of the projection, and the derivative by the radius of a rounded edge in
// pixels of the reference view if depth and shift stayed.
struct Observation {
  double residual, slope, across, along, speed2, rounding;
};

// Robustly weighted sums over the observations of a point: `slope` for inverse depth, `across` for
// the shift.
struct ObservationSums {
  double slope_slope = 0, slope_residual = 0, slope_across = 0, across_across = 0,
         across_residual = 0;
  double speed2 = 0, count = 0;  // without weights
};

class CurveObserver {
 public:
  explicit CurveObserver(const ObservedCurves& curves) : curves_(curves) {
    for (const EdgeIndex* view : curves.views) {
      const Mat3 rotation = MultiplyByTransposed(view->rotation(), curves.rotation);
      const Vec3 moved = Multiply(rotation, curves.translation);
      poses_.push_back({rotation, view->translation() - moved});
    }
  }

  // Observation of point i in view k.
  Vec2 Project(int64_t i, int64_t k) const { return ToImage(k, ToView(i, k, RayOf(i))); }

  // Calls use(k, observation) for each view k that observes point i.
  template <typename Use>
  void Visit(int64_t i, const Use& use) const {
    const Vec3 ray = RayOf(i);
    const int64_t num_views = int64_t(curves_.views.size());
    const double* positions = curves_.positions + i * num_views;
    const bool goes_on = i + 1 < curves_.num_points;
    for (int64_t k = 0; k < num_views; ++k) {
      // Prefetch the next point's observation, since memory access is random.
      if (goes_on && !std::isnan(positions[num_views + k])) {
        curves_.views[k]->Prefetch(int64_t(positions[num_views + k]));
      }
      if (!std::isnan(positions[k])) use(k, Observe(k, positions[k], ray, i));
    }
  }

 private:
  Vec3 RayOf(int64_t i) const {
    const double* x = curves_.undistorted + 2 * i;
    return {x[0] / curves_.focal, x[1] / curves_.focal, 1};
  }

  // Point i in the frame of view k, divided by its depth in the reference view.
  Vec3 ToView(int64_t i, int64_t k, const Vec3& ray) const {
    const auto& [rotation, translation] = poses_[k];
    return Multiply(rotation, ray) + curves_.inverse_depths[i] * translation;
  }

  Vec2 ToImage(int64_t k, const Vec3& local) const {
    const double f = curves_.views[k]->focal();
    return {f * local.x / local.z, f * local.y / local.z};
  }

  Observation Observe(int64_t k, double position, const Vec3& ray, int64_t i) const {
    const EdgeIndex& view = *curves_.views[k];
    const auto& [rotation, translation] = poses_[k];
    const double f = view.focal();
    const Vec3 local = ToView(i, k, ray);
    const Vec2 projected = ToImage(k, local);
    // Derivative of the projection along a vector in the view's frame.
    const auto moving = [&](const Vec3& v) {
      return Vec2{(f * v.x - projected.x * v.z) / local.z, (f * v.y - projected.y * v.z) / local.z};
    };
    const Vec2 tangent = view.tangent(int64_t(position)), normal = {-tangent.y, tangent.x};
    const Vec2 with_depth = moving(translation);
    double across = 0;
    if (curves_.directions) {
      const double* d = curves_.directions + 2 * i;
      const Vec3 turned = {d[0] / curves_.focal, d[1] / curves_.focal, 0};
      across = Dot(moving(Multiply(rotation, turned)), normal);
    }
    // The outline of a rounded edge lies towards the same side in every view: the bright one, or
    // the dark one if the radius is negative. Off the axis, a pixel is a smaller angle.
    const double side = Dot(normal, view.normal(int64_t(position))) < 0 ? -1 : 1;
    const double rounding =
        side * f / (curves_.focal * local.z) * Obliquity(Dot(normal, projected) / f);
    return {Dot(projected - view.At(position), normal),
            Dot(with_depth, normal),
            across,
            Dot(with_depth, tangent),
            Dot(with_depth, with_depth),
            rounding};
  }

  const ObservedCurves& curves_;
  std::vector<std::pair<Mat3, Vec3>> poses_;  // view_from_reference of the views
};

// The sums of each point, with Geman-McClure weights.
inline std::vector<ObservationSums> SumObservations(const ObservedCurves& curves,
                                                    double robust_scale_px, int num_threads) {
  const CurveObserver observer(curves);
  std::vector<ObservationSums> sums(curves.num_points);
  ParallelBlocks(curves.num_points, num_threads, 256, [&](int64_t i) {
    ObservationSums& sum = sums[i];
    observer.Visit(i, [&](int64_t, const Observation& o) {
      const double scaled = o.residual / robust_scale_px, fit = 1 + scaled * scaled;
      const double weight = 1 / (fit * fit);
      sum.slope_slope += weight * o.slope * o.slope;
      sum.slope_residual += weight * o.slope * o.residual;
      sum.slope_across += weight * o.slope * o.across;
      sum.across_across += weight * o.across * o.across;
      sum.across_residual += weight * o.across * o.residual;
      sum.speed2 += o.speed2;
      sum.count += 1;
    });
  });
  return sums;
}

// (N, K) residuals, NaN where not observed, and (N) sums of squared slopes.
inline std::pair<std::vector<double>, std::vector<double>> ObservationResiduals(
    const ObservedCurves& curves, int num_threads) {
  const CurveObserver observer(curves);
  const int64_t num_views = int64_t(curves.views.size());
  std::vector<double> residuals(curves.num_points * num_views, NAN), slopes2(curves.num_points);
  ParallelBlocks(curves.num_points, num_threads, 256, [&](int64_t i) {
    observer.Visit(i, [&](int64_t k, const Observation& o) {
      residuals[i * num_views + k] = o.residual;
      slopes2[i] += o.slope * o.slope;
    });
  });
  return {std::move(residuals), std::move(slopes2)};
}

// (N, K) changes of the residuals by the radius of a rounded edge, in pixels per pixel of the
// reference view, where depth and shift follow (Geman-McClure weights); NaN where not observed.
//
// The lines of sight are tangent to a circle around the axis of the edge, so that the point which
// is seen moves over the edge with the view. Depth and shift place the axis.
inline std::vector<double> RoundingDrifts(const ObservedCurves& curves, double robust_scale_px,
                                          int num_threads) {
  const CurveObserver observer(curves);
  const int64_t num_views = int64_t(curves.views.size());
  std::vector<double> drifts(curves.num_points * num_views, NAN);
  ParallelBlocks(curves.num_points, num_threads, 256, [&](int64_t i) {
    double dd = 0, da = 0, aa = 1, dr = 0, ar = 0, brighter = 0;
    const double* direction = curves.directions + 2 * i;
    const double own = Obliquity(
        (direction[0] * curves.undistorted[2 * i] + direction[1] * curves.undistorted[2 * i + 1]) /
        curves.focal);
    observer.Visit(i, [&](int64_t, const Observation& o) {
      const double scaled = o.residual / robust_scale_px, fit = 1 + scaled * scaled;
      const double weight = 1 / (fit * fit), rounding = o.rounding / own;
      dd += weight * o.slope * o.slope, da += weight * o.slope * o.across;
      aa += weight * o.across * o.across;
      dr += weight * o.slope * rounding, ar += weight * o.across * rounding;
      brighter += o.across * rounding;
    });
    ar += brighter < 0 ? -1 : 1;  // the reference view's own chain
    dd *= 1 + kSlack;
    const double determinant = dd * aa - da * da + 1e-300;
    const double depth = (aa * dr - da * ar) / determinant;
    const double shift = (dd * ar - da * dr) / determinant;
    observer.Visit(i, [&](int64_t k, const Observation& o) {
      drifts[i * num_views + k] = o.rounding / own - depth * o.slope - shift * o.across;
    });
  });
  return drifts;
}

}  // namespace colmap_edges
