// Bindings of tracing by depths along chains: depths, observations, refinement, occlusion.
#include "common/bindings.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <cmath>
#include <optional>

#include "chains/association.h"
#include "chains/chain_depths.h"
#include "chains/envelopes.h"
#include "chains/observations.h"
#include "chains/occlusion.h"
#include "chains/separation.h"
#include "chains/side_gray.h"
#include "common/arrays.h"
#include "common/edge_index.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;

// Samples on the chains of a view, by chain, with the inverse depths visible at them.
struct Samples {
  std::vector<int64_t> points, offsets;
  std::vector<DepthRange> ranges;
};

Samples ToSamples(const EdgeIndex& source, const Longs& samples, const Longs& sample_offsets,
                  const InArray<double, nb::shape<-1, 2>>& inverse_depths) {
  CheckOffsets(sample_offsets, samples.size());
  Require(inverse_depths.shape(0) == samples.size(), "inverse_depths and samples differ in length");
  Samples found{ToVector(samples), ToVector(sample_offsets), {}};
  found.ranges.reserve(samples.size());
  for (size_t i = 0; i < samples.size(); ++i) {
    Require(samples(i) >= 0 && samples(i) < source.num_points(),
            "a sample is not a point of the source");
    found.ranges.push_back({inverse_depths(i, 0), inverse_depths(i, 1)});
  }
  return found;
}

nb::tuple ChainDepthsArrays(const EdgeIndex& source, const std::vector<const EdgeIndex*>& neighbors,
                            Longs samples, Longs sample_offsets,
                            InArray<double, nb::shape<-1, 2>> inverse_depths, double steps,
                            double max_disagreement_px,
                            InArray<float, nb::shape<256, 256>> side_likelihoods,
                            double min_angle_sin, double visibility_rate, double detection_rate,
                            double min_log_likelihood_ratio, double break_penalty, int max_clusters,
                            int num_threads) {
  const Samples given = ToSamples(source, samples, sample_offsets, inverse_depths);
  ChainDepths result;
  {
    nb::gil_scoped_release release;
    result = ComputeChainDepths(
        source, neighbors, given.points, given.offsets, given.ranges, steps,
        {max_disagreement_px, side_likelihoods.data(), min_angle_sin, visibility_rate,
         detection_rate, min_log_likelihood_ratio, break_penalty, max_clusters},
        num_threads);
  }
  const size_t count = given.points.size(), total = result.positions.size();
  return nb::make_tuple(
      ToArray(std::move(result.inverse_depths), {count}),
      ToArray(std::move(result.sigmas), {count}), ToArray(std::move(result.scores), {count}),
      ToArray(std::move(result.support_offsets), {count + 1}),
      ToArray(std::move(result.neighbors), {total}), ToArray(std::move(result.positions), {total}));
}

nb::tuple EnvelopesArrays(const EdgeIndex& source, const std::vector<const EdgeIndex*>& neighbors,
                          Longs samples, Longs sample_offsets,
                          InArray<double, nb::shape<-1, 2>> inverse_depths,
                          double max_disagreement_px,
                          InArray<float, nb::shape<256, 256>> side_likelihoods,
                          double min_angle_sin, double visibility_rate, double detection_rate,
                          double min_log_likelihood_ratio, double break_penalty, int max_clusters,
                          int num_threads) {
  const Samples given = ToSamples(source, samples, sample_offsets, inverse_depths);
  const size_t count = given.points.size();
  std::vector<double> columns(6 * count);
  std::vector<int32_t> supports(2 * count);
  {
    nb::gil_scoped_release release;
    const std::vector<Envelope> found =
        FindEnvelopes(source, neighbors, given.points, given.offsets, given.ranges,
                      {max_disagreement_px, side_likelihoods.data(), min_angle_sin, visibility_rate,
                       detection_rate, min_log_likelihood_ratio, break_penalty, max_clusters},
                      num_threads);
    for (size_t i = 0; i < count; ++i) {
      const Envelope& e = found[i];
      const double values[] = {e.inverse_depth, e.radius,   e.sigma,
                               e.radius_sigma,  e.residual, e.score};
      for (int k = 0; k < 6; ++k) columns[k * count + i] = values[k];
      supports[i] = e.num_supports, supports[count + i] = e.goes_on;
    }
  }
  return nb::make_tuple(ToArray(std::move(columns), {6, count}),
                        ToArray(std::move(supports), {2, count}));
}

OutArray<double> AssociateArrays(const std::vector<const EdgeIndex*>& views, Points3D points,
                                 Points3D tangents, InArray<int8_t, nb::ndim<1>> sides,
                                 double max_distance_px, double min_cosine, int num_threads) {
  const size_t count = points.shape(0);
  if (tangents.shape(0) != count || sides.size() != count) {
    throw std::invalid_argument("points, tangents and sides differ in length");
  }
  std::vector<double> positions;
  {
    nb::gil_scoped_release release;
    positions = AssociateAll(views, points.data(), tangents.data(), sides.data(), int64_t(count),
                             {max_distance_px, min_cosine}, num_threads);
  }
  return ToArray(std::move(positions), {count, views.size()});
}

OutArray<double> DropLoneArray(InArray<double, nb::ndim<2>> positions, Longs offsets) {
  const size_t count = positions.shape(0), num_views = positions.shape(1);
  CheckOffsets(offsets, count);
  std::vector<double> kept;
  {
    nb::gil_scoped_release release;
    kept = DropLone(positions.data(), ToVector(offsets), int64_t(num_views));
  }
  return ToArray(std::move(kept), {count, num_views});
}

OutArray<double> SeparationsArray(const EdgeIndex& view, Points3D points, Points3D offsets,
                                  Points3D steps, Longs rows,
                                  InArray<double, nb::shape<-1, 2>> positions,
                                  double max_distance_px, double min_cosine, int num_threads) {
  const size_t count = rows.size(), num_points = points.shape(0);
  Require(
      offsets.shape(0) == num_points && steps.shape(0) == num_points && positions.shape(0) == count,
      "points, offsets and steps, or rows and positions, differ in length");
  for (size_t i = 0; i < count; ++i) {
    Require(rows(i) >= 0 && rows(i) < int64_t(num_points), "a row is not one of the points");
    for (int k = 0; k < 2; ++k) {
      Require(positions(i, k) < 0 || view.Holds(positions(i, k)), "a position is not on a chain");
    }
  }
  std::vector<double> columns(2 * count);
  {
    nb::gil_scoped_release release;
    const SidePlaces places{reinterpret_cast<const Vec3*>(points.data()),
                            reinterpret_cast<const Vec3*>(offsets.data()),
                            reinterpret_cast<const Vec3*>(steps.data())};
    ParallelBlocks(int64_t(count), num_threads, 256, [&](int64_t i) {
      const Separation found = Separate(view, places, rows.data()[i], positions.data() + 2 * i,
                                        {max_distance_px, min_cosine});
      columns[i] = found.projected, columns[count + i] = found.seen;
    });
  }
  return ToArray(std::move(columns), {2, count});
}

// View on the arrays of curves and their observations, which must outlive it.
ObservedCurves ToObservedCurves(const Rotation& rotation, const Translation& translation,
                                double focal, const Points2D& undistorted,
                                const Doubles& inverse_depths,
                                const InArray<double, nb::ndim<2>>& positions,
                                const std::vector<const EdgeIndex*>& views) {
  const size_t count = undistorted.shape(0);
  if (inverse_depths.size() != count || positions.shape(0) != count ||
      positions.shape(1) != views.size()) {
    throw std::invalid_argument("curves, positions and views differ in length");
  }
  std::vector<double> ends(views.size());
  for (size_t k = 0; k < views.size(); ++k) ends[k] = double(views[k]->num_points());
  for (size_t i = 0; i < count; ++i) {
    const double* row = positions.data() + i * views.size();
    bool held = true;
    for (size_t k = 0; k < views.size(); ++k) held &= !(row[k] < 0) & !(row[k] >= ends[k]);
    Require(held, "a position is not on a chain");
  }
  ObservedCurves curves;
  std::copy_n(rotation.data(), 9, curves.rotation.begin());
  curves.translation = {translation(0), translation(1), translation(2)};
  curves.focal = focal;
  curves.undistorted = undistorted.data(), curves.inverse_depths = inverse_depths.data();
  curves.directions = nullptr, curves.positions = positions.data();
  curves.num_points = int64_t(count);
  curves.views = views;
  return curves;
}

OutArray<double> SumObservationsArray(Rotation rotation, Translation translation, double focal,
                                      Points2D undistorted, Doubles inverse_depths,
                                      std::optional<Points2D> directions,
                                      InArray<double, nb::ndim<2>> positions,
                                      const std::vector<const EdgeIndex*>& views,
                                      double robust_scale_px, int num_threads) {
  ObservedCurves curves =
      ToObservedCurves(rotation, translation, focal, undistorted, inverse_depths, positions, views);
  const size_t count = undistorted.shape(0);
  if (directions) {
    Require(directions->shape(0) == count, "curves and directions differ in length");
    curves.directions = directions->data();
  }
  std::vector<double> columns(7 * count);
  {
    nb::gil_scoped_release release;
    const std::vector<ObservationSums> sums = SumObservations(curves, robust_scale_px, num_threads);
    for (size_t i = 0; i < count; ++i) {
      const ObservationSums& s = sums[i];
      const double row[] = {s.slope_slope,     s.slope_residual, s.slope_across, s.across_across,
                            s.across_residual, s.speed2,         s.count};
      for (size_t c = 0; c < 7; ++c) columns[c * count + i] = row[c];
    }
  }
  return ToArray(std::move(columns), {7, count});
}

nb::tuple ObservationResidualsArrays(Rotation rotation, Translation translation, double focal,
                                     Points2D undistorted, Doubles inverse_depths,
                                     InArray<double, nb::ndim<2>> positions,
                                     const std::vector<const EdgeIndex*>& views, int num_threads) {
  const ObservedCurves curves =
      ToObservedCurves(rotation, translation, focal, undistorted, inverse_depths, positions, views);
  std::pair<std::vector<double>, std::vector<double>> found;
  {
    nb::gil_scoped_release release;
    found = ObservationResiduals(curves, num_threads);
  }
  const size_t count = undistorted.shape(0);
  return nb::make_tuple(ToArray(std::move(found.first), {count, views.size()}),
                        ToArray(std::move(found.second), {count}));
}

OutArray<double> RoundingDriftsArray(Rotation rotation, Translation translation, double focal,
                                     Points2D undistorted, Doubles inverse_depths,
                                     Points2D directions, InArray<double, nb::ndim<2>> positions,
                                     const std::vector<const EdgeIndex*>& views,
                                     double robust_scale_px, int num_threads) {
  ObservedCurves curves =
      ToObservedCurves(rotation, translation, focal, undistorted, inverse_depths, positions, views);
  const size_t count = undistorted.shape(0);
  Require(directions.shape(0) == count, "curves and directions differ in length");
  curves.directions = directions.data();
  std::vector<double> drifts;
  {
    nb::gil_scoped_release release;
    drifts = RoundingDrifts(curves, robust_scale_px, num_threads);
  }
  return ToArray(std::move(drifts), {count, views.size()});
}

OutArray<double> SumSideGrayArray(Rotation rotation, Translation translation, double focal,
                                  Points2D undistorted, Doubles inverse_depths,
                                  InArray<double, nb::ndim<2>> positions,
                                  const std::vector<const EdgeIndex*>& views,
                                  const EdgeIndex& reference, Longs indices, Longs offsets,
                                  int reach, int window, int num_threads) {
  const ObservedCurves curves =
      ToObservedCurves(rotation, translation, focal, undistorted, inverse_depths, positions, views);
  const size_t count = undistorted.shape(0);
  if (indices.size() != count) throw std::invalid_argument("curves and indices differ in length");
  CheckOffsets(offsets, count);
  for (size_t i = 0; i < count; ++i) {
    if (!(indices(i) >= 0 && indices(i) < reference.num_points())) {
      throw std::invalid_argument("an index is not on a chain of the reference view");
    }
  }
  if (reach < 0 || window < 1) throw std::invalid_argument("reach or window is too small");
  std::vector<double> columns(2 * count);
  {
    nb::gil_scoped_release release;
    const std::vector<SideGraySums> sums =
        SumSideGray(curves, reference, indices.data(), offsets.data(), int64_t(offsets.size()) - 1,
                    {reach, window}, num_threads);
    for (size_t i = 0; i < count; ++i) {
      columns[i] = sums[i].information, columns[count + i] = sums[i].gradient;
    }
  }
  return ToArray(std::move(columns), {2, count});
}

OutArray<double> SlidePositionsArray(Rotation rotation, Translation translation, double focal,
                                     Points2D undistorted, Doubles inverse_depths,
                                     InArray<double, nb::ndim<2>> positions,
                                     const std::vector<const EdgeIndex*>& views, int num_threads) {
  const ObservedCurves curves =
      ToObservedCurves(rotation, translation, focal, undistorted, inverse_depths, positions, views);
  std::vector<double> moved;
  {
    nb::gil_scoped_release release;
    moved = SlidePositions(curves, num_threads);
  }
  return ToArray(std::move(moved), {size_t(undistorted.shape(0)), views.size()});
}

nb::tuple CountAroundArrays(Points2D pixels, Doubles depths, Doubles margins, Longs curves,
                            double radius_px, double slope, int num_threads) {
  const size_t count = pixels.shape(0);
  if (depths.size() != count || margins.size() != count || curves.size() != count) {
    throw std::invalid_argument("pixels, depths, margins and curves differ in length");
  }
  if (!(radius_px > 0)) throw std::invalid_argument("the radius must be positive");
  std::vector<SeenPoint> points(count);
  for (size_t i = 0; i < count; ++i) {
    if (!(std::abs(pixels(i, 0)) < 1e9 * radius_px && std::abs(pixels(i, 1)) < 1e9 * radius_px)) {
      throw std::invalid_argument("a pixel is not finite or too far away");
    }
    points[i] = {{pixels(i, 0), pixels(i, 1)}, depths(i), margins(i), curves(i)};
  }
  Crowd crowd;
  {
    nb::gil_scoped_release release;
    crowd = CountAround(points, radius_px, slope, num_threads);
  }
  return nb::make_tuple(ToArray(std::move(crowd.nearer), {count}),
                        ToArray(std::move(crowd.agreeing), {count}));
}

}  // namespace

void BindChains(nb::module_& m) {
  m.def("chain_depths", &ChainDepthsArrays, "source"_a, "neighbors"_a, "samples"_a,
        "sample_offsets"_a, "inverse_depths"_a, "steps"_a, "max_disagreement_px"_a,
        "side_likelihoods"_a, "min_angle_sin"_a, "visibility_rate"_a, "detection_rate"_a,
        "min_log_likelihood_ratio"_a, "break_penalty"_a, "max_clusters"_a, "num_threads"_a,
        "Inverse depth, sigma, score of each sample, and its support as CSR: neighbour, position.");
  m.def("envelopes", &EnvelopesArrays, "source"_a, "neighbors"_a, "samples"_a, "sample_offsets"_a,
        "inverse_depths"_a, "max_disagreement_px"_a, "side_likelihoods"_a, "min_angle_sin"_a,
        "visibility_rate"_a, "detection_rate"_a, "min_log_likelihood_ratio"_a, "break_penalty"_a,
        "max_clusters"_a, "num_threads"_a,
        "(6, S) inverse depths, radii over depths, their standard deviations for 1 px, residuals "
        "and scores of samples on outlines; (2, S) numbers of supporting neighbours, and whether a "
        "sample continues the outline of the previous one.");
  m.def("associate", &AssociateArrays, "views"_a, "points"_a, "tangents"_a, "sides"_a,
        "max_distance_px"_a, "min_cosine"_a, "num_threads"_a,
        "(N, K) positions on the chains of K views that observe the 3D points, -1 where none.");
  m.def("drop_lone", &DropLoneArray, "positions"_a, "offsets"_a,
        "(N, K) positions that observe points of curves, NaN where no neighbouring point of the "
        "curve is observed next to it.");
  m.def(
      "separations", &SeparationsArray, "view"_a, "points"_a, "offsets"_a, "steps"_a, "rows"_a,
      "positions"_a, "max_distance_px"_a, "min_cosine"_a, "num_threads"_a,
      "(2, n) distances in pixels across edges, between points at rows and points at offsets from "
      "them: of the projections, and of the chains that observe them at positions (if negative: "
      "the nearest); NaN if unknown.");
  m.def(
      "sum_observations", &SumObservationsArray, "rotation"_a, "translation"_a, "focal"_a,
      "undistorted"_a, "inverse_depths"_a, "directions"_a.none(), "positions"_a, "views"_a,
      "robust_scale_px"_a, "num_threads"_a,
      "(7, N) sums over the observations of each point of a reference view's curves: weight times "
      "slope slope, slope residual, slope across, across across, across residual; squared speed; "
      "number.");
  m.def("observation_residuals", &ObservationResidualsArrays, "rotation"_a, "translation"_a,
        "focal"_a, "undistorted"_a, "inverse_depths"_a, "positions"_a, "views"_a, "num_threads"_a,
        "(N, K) distances across the observing chains, and (N,) sums of their squared slopes.");
  m.def("rounding_drifts", &RoundingDriftsArray, "rotation"_a, "translation"_a, "focal"_a,
        "undistorted"_a, "inverse_depths"_a, "directions"_a, "positions"_a, "views"_a,
        "robust_scale_px"_a, "num_threads"_a,
        "(N, K) changes of the distances across the observing chains by the radius of a rounded "
        "edge, in pixels per pixel of the reference view, if depths and shifts along directions "
        "follow.");
  m.def("sum_side_gray", &SumSideGrayArray, "rotation"_a, "translation"_a, "focal"_a,
        "undistorted"_a, "inverse_depths"_a, "positions"_a, "views"_a, "reference"_a, "indices"_a,
        "offsets"_a, "reach"_a, "window"_a, "num_threads"_a,
        "(2, N) information and gradient of inverse depth, in units of the noise, from the "
        "intensities along the observing chains and the reference view's.");
  m.def("slide_positions", &SlidePositionsArray, "rotation"_a, "translation"_a, "focal"_a,
        "undistorted"_a, "inverse_depths"_a, "positions"_a, "views"_a, "num_threads"_a,
        "(N, K) positions nearest to the points on their observing chains.");
  m.def("count_around", &CountAroundArrays, "pixels"_a, "depths"_a, "margins"_a, "curves"_a,
        "radius_px"_a, "slope"_a, "num_threads"_a,
        "(N,) numbers of neighbours on other curves that are nearer, (N,) that are equally far.");
}

}  // namespace colmap_edges
