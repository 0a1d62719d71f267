// Photometric term: intensities on the sides of an edge vary along it, and at a wrong depth those
// in two views are displaced along the chain. This determines the depth of edges parallel to
// epipolar lines, which distances across the chain do not.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "chains/association.h"
#include "chains/observations.h"
#include "common/edge_index.h"
#include "common/parallel.h"

namespace colmap_edges {

struct SideGrayParameters {
  int64_t reach;   // half width, in chain points, of the smoothing of intensities
  int64_t window;  // half width, in curve points, in which intensity differences are compared
};

// Information and gradient of a point's inverse depth, for the sum of squared differences.
struct SideGraySums {
  double information = 0, gradient = 0;
};

// The intensities of the dark and the bright side.
using Grays = std::array<double, 2>;

// Intensities at a position on a chain, smoothed over `reach` points to both sides.
inline Grays SmoothGray(const EdgeIndex& view, double position, int64_t reach) {
  const int64_t i = int64_t(position);
  const double fraction = position - double(i);
  const int32_t p = view.polyline(i);
  const bool inside = i - reach >= view.first(p) && i + 1 + reach <= view.last(p);
  const auto sides = [&](int64_t k) -> const Sides& {
    return view.sides(inside ? i + k : view.Advance(i, k));
  };
  int inner[2] = {0, 0};
  for (int64_t k = 1 - reach; k <= reach; ++k) {
    const Sides& gray = sides(k);
    inner[0] += gray[0], inner[1] += gray[1];
  }
  const Sides &first = sides(-reach), &last = sides(1 + reach);
  Grays mean;
  for (int s = 0; s < 2; ++s) {
    mean[s] = (inner[s] + (1 - fraction) * first[s] + fraction * last[s]) / double(2 * reach + 1);
  }
  return mean;
}

// Compares intensities along curves of a reference view with those along the observing chains.
class SideGray {
 public:
  // indices: (N) indices of the curves' points in the reference view's graph.
  SideGray(const ObservedCurves& curves, const EdgeIndex& reference, const int64_t* indices,
           const SideGrayParameters& parameters)
      : curves_(curves), observer_(curves), driver_(reference), indices_(indices), p_(parameters) {}

  // Adds to the sums of one curve, the points [first, last).
  void AddCurve(int64_t first, int64_t last, SideGraySums* sums) const {
    const int64_t num_views = int64_t(curves_.views.size());
    std::vector<std::vector<Row>> rows(num_views);
    for (int64_t i = first; i < last; ++i) {
      const Grays own = SmoothGray(driver_, double(indices_[i]), p_.reach);
      observer_.Visit(i, [&](int64_t k, const Observation& o) {
        const EdgeIndex& view = *curves_.views[k];
        const double position = curves_.positions[i * num_views + k];
        const int64_t j = int64_t(position);
        const double step =
            0.5 * Norm(view.point(view.Advance(j, 1)) - view.point(view.Advance(j, -1)));
        if (step > kDensest && step < kSparsest) {
          rows[k].push_back(Compare(view, i, position, o.along / step, own));
        }
      });
    }
    for (const std::vector<Row>& of_view : rows) {
      for (int side = 0; side < 2; ++side) AddSide(of_view, side, sums);
    }
  }

 private:
  static constexpr int64_t kFewest = 6;      // minimum number of compared points
  static constexpr double kLeastNoise2 = 1;  // minimum variance of intensities, due to rounding
  static constexpr double kDensest = 0.4;    // range of distances in pixels between chain points
  static constexpr double kSparsest = 2;     // in which positions are proportional to lengths

  // Intensity difference of one view to the reference view, and its derivative by inverse depth.
  struct Difference {
    double gray, slope;
  };
  struct Row {
    int64_t point;
    Difference sides[2];
  };

  // Point i at a position on a chain of a view, along which it moves by `speed` with inverse depth.
  Row Compare(const EdgeIndex& view, int64_t i, double position, double speed,
              const Grays& own) const {
    const int64_t step = std::max<int64_t>(p_.reach, 1), j = int64_t(position);
    const double fraction = position - double(j);
    const Grays there = SmoothGray(view, position, p_.reach);
    const Grays ahead = SmoothGray(view, double(view.Advance(j, step)) + fraction, p_.reach);
    const Grays behind = SmoothGray(view, double(view.Advance(j, -step)) + fraction, p_.reach);
    Row row{i, {}};
    for (int s = 0; s < 2; ++s) {
      row.sides[s] = {there[s] - own[s], (ahead[s] - behind[s]) / double(2 * step) * speed};
    }
    return row;
  }

  void AddSide(const std::vector<Row>& rows, int side, SideGraySums* sums) const {
    const int64_t count = int64_t(rows.size());
    if (count < kFewest) return;
    std::vector<Difference> differences(count);
    for (int64_t r = 0; r < count; ++r) differences[r] = rows[r].sides[side];
    // Local means by running sums, to remove exposure and shading, which change slowly along an
    // edge.
    std::vector<Difference> total(count + 1, {0, 0});
    for (int64_t r = 0; r < count; ++r) {
      total[r + 1] = {total[r].gray + differences[r].gray, total[r].slope + differences[r].slope};
    }
    std::vector<int64_t> low(count), high(count);
    for (int64_t r = 0, a = 0, b = 0; r < count; ++r) {
      while (rows[a].point < rows[r].point - p_.window) ++a;
      while (b < count && rows[b].point <= rows[r].point + p_.window) ++b;
      low[r] = a, high[r] = b;
    }
    for (int64_t r = 0; r < count; ++r) {
      const double within = double(high[r] - low[r]);
      differences[r].gray -= (total[high[r]].gray - total[low[r]].gray) / within;
      differences[r].slope -= (total[high[r]].slope - total[low[r]].slope) / within;
    }
    std::vector<double> squares(count + 1, 0);
    for (int64_t r = 0; r < count; ++r) {
      squares[r + 1] = squares[r] + differences[r].gray * differences[r].gray;
    }
    for (int64_t r = 0; r < count; ++r) {
      const int64_t within = high[r] - low[r];
      if (within < kFewest) continue;
      const double noise2 =
          std::max((squares[high[r]] - squares[low[r]]) / double(within), kLeastNoise2);
      const auto [gray, slope] = differences[r];
      const double fit = 1 + gray * gray / (4 * noise2), weight = 1 / (fit * fit * noise2);
      sums[rows[r].point].information += weight * slope * slope;
      sums[rows[r].point].gradient -= weight * slope * gray;
    }
  }

  const ObservedCurves& curves_;
  const CurveObserver observer_;
  const EdgeIndex& driver_;
  const int64_t* indices_;
  const SideGrayParameters p_;
};

// The sums of each point. offsets: CSR of the points by curve.
inline std::vector<SideGraySums> SumSideGray(const ObservedCurves& curves,
                                             const EdgeIndex& reference, const int64_t* indices,
                                             const int64_t* offsets, int64_t num_curves,
                                             const SideGrayParameters& parameters,
                                             int num_threads) {
  const SideGray gray(curves, reference, indices, parameters);
  std::vector<SideGraySums> sums(curves.num_points);
  ParallelBlocks(num_curves, num_threads, 8,
                 [&](int64_t c) { gray.AddCurve(offsets[c], offsets[c + 1], sums.data()); });
  return sums;
}

// Position nearest to x on the chain around a given position: the observation of a moved point.
inline double SlideTo(const EdgeIndex& view, double position, const Vec2& x) {
  constexpr int kMostSteps = 64;
  const auto distance2 = [&](int64_t i) {
    const Vec2 away = x - view.point(i);
    return Dot(away, away);
  };
  int64_t i = int64_t(position);
  for (int step = 0; step < kMostSteps; ++step) {
    const int64_t ahead = view.Advance(i, 1), behind = view.Advance(i, -1);
    const int64_t next = distance2(ahead) < distance2(behind) ? ahead : behind;
    if (!(distance2(next) < distance2(i))) break;
    i = next;
  }
  return NearestPosition(view, i, x);
}

// (N, K) positions of the points, at new depths, on the chains that observe them.
inline std::vector<double> SlidePositions(const ObservedCurves& curves, int num_threads) {
  const CurveObserver observer(curves);
  const int64_t num_views = int64_t(curves.views.size());
  std::vector<double> positions(curves.positions, curves.positions + curves.num_points * num_views);
  ParallelBlocks(curves.num_points, num_threads, 256, [&](int64_t i) {
    for (int64_t k = 0; k < num_views; ++k) {
      double& position = positions[i * num_views + k];
      if (std::isnan(position)) continue;
      const Vec2 x = observer.Project(i, k);
      if (std::isfinite(x.x) && std::isfinite(x.y)) {
        position = SlideTo(*curves.views[k], position, x);
      }
    }
  });
  return positions;
}

}  // namespace colmap_edges
