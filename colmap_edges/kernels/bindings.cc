// Python face of the kernels: converts arrays, releases the GIL, calls the core, converts back.
#include <nanobind/stl/vector.h>

#include <cmath>
#include <stdexcept>

#include "arrays.h"
#include "association.h"
#include "chain_depths.h"
#include "corners.h"
#include "edge_view.h"
#include "image_bindings.h"
#include "junctions.h"
#include "observations.h"
#include "occlusion.h"
#include "polyline.h"
#include "side_gray.h"
#include "tracing_bindings.h"

namespace colmap_edges {
namespace {

using Points2D = InArray<double, nb::shape<-1, 2>>;
using Offsets = InArray<int64_t, nb::ndim<1>>;

void CheckOffsets(const Offsets& offsets, size_t count) {
  if (offsets.size() == 0 || offsets(0) != 0 || offsets(offsets.size() - 1) != int64_t(count)) {
    throw std::invalid_argument("offsets must start at 0 and end at the number of points");
  }
  for (size_t i = 1; i < offsets.size(); ++i) {
    if (offsets(i) < offsets(i - 1)) throw std::invalid_argument("offsets must not decrease");
  }
}

nb::tuple DouglasPeuckerArrays(Points2D points, Offsets offsets, double distance) {
  CheckOffsets(offsets, points.shape(0));
  std::vector<int64_t> kept, kept_offsets = {0};
  {
    nb::gil_scoped_release release;
    const auto point = [&](int64_t i) { return Vec2{points(i, 0), points(i, 1)}; };
    for (size_t p = 0; p + 1 < offsets.size(); ++p) {
      if (offsets(p) < offsets(p + 1)) {
        DouglasPeucker(point, offsets(p), offsets(p + 1) - 1, distance, &kept);
      }
      kept_offsets.push_back(int64_t(kept.size()));
    }
  }
  const size_t num_kept = kept.size(), num_offsets = kept_offsets.size();
  return nb::make_tuple(ToArray(std::move(kept), {num_kept}),
                        ToArray(std::move(kept_offsets), {num_offsets}));
}

nb::tuple FindCornersArrays(Points2D points, Offsets offsets, InArray<bool, nb::ndim<1>> closed,
                            int64_t rounded, int64_t arm, double bent_cosine, double max_cosine,
                            double max_scatter, double slack, double max_radius, double max_cut) {
  CheckOffsets(offsets, points.shape(0));
  if (closed.size() + 1 != offsets.size()) {
    throw std::invalid_argument("closed and offsets are not of as many chains");
  }
  if (rounded < 1 || arm < 2) throw std::invalid_argument("rounded or arm is too short");
  const CornerLimits limits = {rounded,     arm,   bent_cosine, max_cosine,
                               max_scatter, slack, max_radius,  max_cut};
  std::vector<Corner> corners;
  {
    nb::gil_scoped_release release;
    for (size_t c = 0; c < closed.size(); ++c) {
      const int64_t length = offsets(c + 1) - offsets(c);
      FindCorners({points.data(), offsets(c), length, closed(c)}, limits, &corners);
    }
  }
  const size_t count = corners.size();
  std::vector<int64_t> indices(count);
  std::vector<double> crossings(2 * count);
  for (size_t i = 0; i < count; ++i) {
    indices[i] = corners[i].point;
    crossings[2 * i] = corners[i].crossing.x, crossings[2 * i + 1] = corners[i].crossing.y;
  }
  return nb::make_tuple(ToArray(std::move(indices), {count}),
                        ToArray(std::move(crossings), {count, 2}));
}

OutArray<int32_t> TouchedChainsArrays(Points2D points, Offsets offsets, int64_t width,
                                      int64_t height) {
  CheckOffsets(offsets, points.shape(0));
  if (width < 1 || height < 1) throw std::invalid_argument("the image is empty");
  std::vector<int32_t> touched;
  {
    nb::gil_scoped_release release;
    const auto point = [&](int64_t i) { return Vec2{points(i, 0), points(i, 1)}; };
    touched =
        TouchedChains(point, {offsets.data(), offsets.data() + offsets.size()}, width, height);
  }
  const size_t count = touched.size();
  return ToArray(std::move(touched), {count});
}

std::vector<Vec2> ToVec2(const Points2D& points) {
  std::vector<Vec2> result(points.shape(0));
  for (size_t i = 0; i < result.size(); ++i) result[i] = {points(i, 0), points(i, 1)};
  return result;
}

std::vector<int64_t> ToVector(const Offsets& values) {
  return {values.data(), values.data() + values.size()};
}

void MakeEdgeView(EdgeView* self, Points2D points, Points2D normals,
                  InArray<uint8_t, nb::shape<-1, 2>> sides, Offsets offsets,
                  InArray<bool, nb::ndim<1>> closed, InArray<double, nb::shape<3, 3>> rotation,
                  InArray<double, nb::shape<3>> translation, double focal) {
  std::vector<Sides> grays(sides.shape(0));
  for (size_t i = 0; i < grays.size(); ++i) grays[i] = {sides(i, 0), sides(i, 1)};
  Mat3 r;
  std::copy_n(rotation.data(), 9, r.begin());
  const Vec3 t = {translation(0), translation(1), translation(2)};
  new (self) EdgeView(ToVec2(points), ToVec2(normals), grays, ToVector(offsets),
                      {closed.data(), closed.data() + closed.size()}, r, t, focal);
}

nb::tuple ChainDepthsArrays(const EdgeView& source, const std::vector<const EdgeView*>& neighbors,
                            Offsets samples, Offsets sample_offsets,
                            InArray<double, nb::shape<-1, 2>> inverse_depths, double steps,
                            double max_disagreement_px,
                            InArray<float, nb::shape<256, 256>> side_likelihoods,
                            double min_angle_sin, double visibility_rate, double detection_rate,
                            double none_score, double break_penalty, int max_clusters,
                            int num_threads) {
  CheckOffsets(sample_offsets, samples.size());
  for (size_t i = 0; i < samples.size(); ++i) {
    if (samples(i) < 0 || samples(i) >= source.num_points()) {
      throw std::invalid_argument("a sample is not a point of the source");
    }
  }
  if (inverse_depths.shape(0) != samples.size()) {
    throw std::invalid_argument("inverse_depths and samples differ in length");
  }
  const std::vector<int64_t> starts = ToVector(samples), offsets = ToVector(sample_offsets);
  std::vector<DepthRange> ranges(starts.size());
  for (size_t i = 0; i < ranges.size(); ++i)
    ranges[i] = {inverse_depths(i, 0), inverse_depths(i, 1)};
  ChainDepths result;
  {
    nb::gil_scoped_release release;
    result = ComputeChainDepths(
        source, neighbors, starts, offsets, ranges, steps,
        {max_disagreement_px, side_likelihoods.data(), min_angle_sin, visibility_rate,
         detection_rate, none_score, break_penalty, max_clusters},
        num_threads);
  }
  const size_t count = starts.size(), total = result.positions.size();
  return nb::make_tuple(
      ToArray(std::move(result.inverse_depths), {count}),
      ToArray(std::move(result.sigmas), {count}), ToArray(std::move(result.scores), {count}),
      ToArray(std::move(result.support_offsets), {count + 1}),
      ToArray(std::move(result.neighbors), {total}), ToArray(std::move(result.positions), {total}));
}

using Points3D = InArray<double, nb::shape<-1, 3>>;

OutArray<double> AssociateArrays(const std::vector<const EdgeView*>& views, Points3D points,
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

using Doubles = InArray<double, nb::ndim<1>>;

// What the arrays of curves and their observations say; they must outlive it.
ObservedCurves ToObservedCurves(const InArray<double, nb::shape<3, 3>>& rotation,
                                const InArray<double, nb::shape<3>>& translation, double focal,
                                const Points2D& ideal, const Doubles& inverse_depths,
                                const Points2D& directions,
                                const InArray<double, nb::ndim<2>>& positions,
                                const std::vector<const EdgeView*>& views) {
  const size_t count = ideal.shape(0);
  if (inverse_depths.size() != count || directions.shape(0) != count ||
      positions.shape(0) != count || positions.shape(1) != views.size()) {
    throw std::invalid_argument("curves, directions, positions and views differ in length");
  }
  for (size_t i = 0; i < count; ++i) {
    for (size_t k = 0; k < views.size(); ++k) {
      const double position = positions(i, k);
      if (!(std::isnan(position) || (position >= 0 && position < double(views[k]->num_points())))) {
        throw std::invalid_argument("a position is not on a chain");
      }
    }
  }
  ObservedCurves curves;
  std::copy_n(rotation.data(), 9, curves.rotation.begin());
  curves.translation = {translation(0), translation(1), translation(2)};
  curves.focal = focal;
  curves.ideal = ideal.data(), curves.inverse_depths = inverse_depths.data();
  curves.directions = directions.data(), curves.positions = positions.data();
  curves.num_points = int64_t(count);
  curves.views = views;
  return curves;
}

OutArray<double> SumObservationsArray(InArray<double, nb::shape<3, 3>> rotation,
                                      InArray<double, nb::shape<3>> translation, double focal,
                                      Points2D ideal, Doubles inverse_depths, Points2D directions,
                                      InArray<double, nb::ndim<2>> positions,
                                      const std::vector<const EdgeView*>& views,
                                      double robust_scale_px, int num_threads) {
  const ObservedCurves curves = ToObservedCurves(rotation, translation, focal, ideal,
                                                 inverse_depths, directions, positions, views);
  const size_t count = ideal.shape(0);
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

nb::tuple ObservationResidualsArrays(InArray<double, nb::shape<3, 3>> rotation,
                                     InArray<double, nb::shape<3>> translation, double focal,
                                     Points2D ideal, Doubles inverse_depths,
                                     InArray<double, nb::ndim<2>> positions,
                                     const std::vector<const EdgeView*>& views, int num_threads) {
  const ObservedCurves curves = ToObservedCurves(rotation, translation, focal, ideal,
                                                 inverse_depths, ideal, positions, views);
  std::pair<std::vector<double>, std::vector<double>> found;
  {
    nb::gil_scoped_release release;
    found = ObservationResiduals(curves, num_threads);
  }
  const size_t count = ideal.shape(0);
  return nb::make_tuple(ToArray(std::move(found.first), {count, views.size()}),
                        ToArray(std::move(found.second), {count}));
}

OutArray<double> SumSideGrayArray(InArray<double, nb::shape<3, 3>> rotation,
                                  InArray<double, nb::shape<3>> translation, double focal,
                                  Points2D ideal, Doubles inverse_depths,
                                  InArray<double, nb::ndim<2>> positions,
                                  const std::vector<const EdgeView*>& views, const EdgeView& driver,
                                  Offsets indices, Offsets offsets, int reach, int window,
                                  int num_threads) {
  const ObservedCurves curves = ToObservedCurves(rotation, translation, focal, ideal,
                                                 inverse_depths, ideal, positions, views);
  const size_t count = ideal.shape(0);
  if (indices.size() != count) throw std::invalid_argument("curves and indices differ in length");
  CheckOffsets(offsets, count);
  for (size_t i = 0; i < count; ++i) {
    if (!(indices(i) >= 0 && indices(i) < driver.num_points())) {
      throw std::invalid_argument("an index is not on a chain of the driver");
    }
  }
  if (reach < 0 || window < 1) throw std::invalid_argument("reach or window is too small");
  std::vector<double> columns(2 * count);
  {
    nb::gil_scoped_release release;
    const std::vector<SideGraySums> sums =
        SumSideGray(curves, driver, indices.data(), offsets.data(), int64_t(offsets.size()) - 1,
                    {reach, window}, num_threads);
    for (size_t i = 0; i < count; ++i) {
      columns[i] = sums[i].information, columns[count + i] = sums[i].gradient;
    }
  }
  return ToArray(std::move(columns), {2, count});
}

OutArray<double> SlidePositionsArray(InArray<double, nb::shape<3, 3>> rotation,
                                     InArray<double, nb::shape<3>> translation, double focal,
                                     Points2D ideal, Doubles inverse_depths,
                                     InArray<double, nb::ndim<2>> positions,
                                     const std::vector<const EdgeView*>& views, int num_threads) {
  const ObservedCurves curves = ToObservedCurves(rotation, translation, focal, ideal,
                                                 inverse_depths, ideal, positions, views);
  std::vector<double> moved;
  {
    nb::gil_scoped_release release;
    moved = SlidePositions(curves, num_threads);
  }
  return ToArray(std::move(moved), {size_t(ideal.shape(0)), views.size()});
}

nb::tuple CountAroundArrays(Points2D pixels, InArray<double, nb::ndim<1>> depths,
                            InArray<double, nb::ndim<1>> margins, Offsets curves, double radius_px,
                            double slope, int num_threads) {
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

nb::tuple ChainPointsArrays(const EdgeView& view, InArray<double, nb::ndim<1>> positions) {
  const size_t count = positions.size();
  std::vector<double> points(2 * count), tangents(2 * count);
  for (size_t i = 0; i < count; ++i) {
    if (!(positions(i) >= 0 && positions(i) < double(view.num_points()))) {
      throw std::invalid_argument("a position is not on a chain");
    }
    const Vec2 point = view.At(positions(i));
    const Vec2& tangent = view.tangent(int64_t(positions(i)));
    points[2 * i] = point.x, points[2 * i + 1] = point.y;
    tangents[2 * i] = tangent.x, tangents[2 * i + 1] = tangent.y;
  }
  return nb::make_tuple(ToArray(std::move(points), {count, 2}),
                        ToArray(std::move(tangents), {count, 2}));
}

}  // namespace
}  // namespace colmap_edges

NB_MODULE(_kernels, m) {
  namespace nb = nanobind;
  using namespace nb::literals;
  m.doc() = "Hot loops of colmap_edges";
  m.def("douglas_peucker", &colmap_edges::DouglasPeuckerArrays, "points"_a, "offsets"_a,
        "distance"_a,
        "Indices that Douglas-Peucker keeps of each polyline, and their CSR offsets.");
  m.def(
      "find_corners", &colmap_edges::FindCornersArrays, "points"_a, "offsets"_a, "closed"_a,
      "rounded"_a, "arm"_a, "bent_cosine"_a, "max_cosine"_a, "max_scatter"_a, "slack"_a,
      "max_radius"_a, "max_cut"_a,
      "(K,) points of chains at corners, ascending, and (K, 2) where the lines along them cross.");
  m.def("touched_chains", &colmap_edges::TouchedChainsArrays, "points"_a, "offsets"_a, "width"_a,
        "height"_a, "(2C,) chain whose inside each end touches, other than its own, or -1.");
  nb::class_<colmap_edges::EdgeView>(m, "EdgeView", "A view's edge graph with its pose and a grid.")
      .def("__init__", &colmap_edges::MakeEdgeView, "points"_a, "normals"_a, "sides"_a, "offsets"_a,
           "closed"_a, "rotation"_a, "translation"_a, "focal"_a);
  m.def("chain_depths", &colmap_edges::ChainDepthsArrays, "source"_a, "neighbors"_a, "samples"_a,
        "sample_offsets"_a, "inverse_depths"_a, "steps"_a, "max_disagreement_px"_a,
        "side_likelihoods"_a, "min_angle_sin"_a, "visibility_rate"_a, "detection_rate"_a,
        "none_score"_a, "break_penalty"_a, "max_clusters"_a, "num_threads"_a,
        "Inverse depth, sigma, score of each sample, and its support as CSR: neighbour, position.");
  m.def("associate", &colmap_edges::AssociateArrays, "views"_a, "points"_a, "tangents"_a, "sides"_a,
        "max_distance_px"_a, "min_cosine"_a, "num_threads"_a,
        "(N, K) positions on the chains of K views that observe the 3D points, -1 where none.");
  m.def("sum_observations", &colmap_edges::SumObservationsArray, "rotation"_a, "translation"_a,
        "focal"_a, "ideal"_a, "inverse_depths"_a, "directions"_a, "positions"_a, "views"_a,
        "robust_scale_px"_a, "num_threads"_a,
        "(7, N) sums over the observations of each point of a driver's curves: of weight times "
        "slope slope, slope residual, slope across, across across, across residual; of the squared "
        "speed; their number.");
  m.def("observation_residuals", &colmap_edges::ObservationResidualsArrays, "rotation"_a,
        "translation"_a, "focal"_a, "ideal"_a, "inverse_depths"_a, "positions"_a, "views"_a,
        "num_threads"_a,
        "(N, K) distances across the observing chains, and (N,) sums of their squared slopes.");
  m.def("sum_side_gray", &colmap_edges::SumSideGrayArray, "rotation"_a, "translation"_a, "focal"_a,
        "ideal"_a, "inverse_depths"_a, "positions"_a, "views"_a, "driver"_a, "indices"_a,
        "offsets"_a, "reach"_a, "window"_a, "num_threads"_a,
        "(2, N) information on inverse depth and gradient, in units of the noise of gray, from the "
        "gray along the chains that observe curves and along the driver's own.");
  m.def("slide_positions", &colmap_edges::SlidePositionsArray, "rotation"_a, "translation"_a,
        "focal"_a, "ideal"_a, "inverse_depths"_a, "positions"_a, "views"_a, "num_threads"_a,
        "(N, K) positions nearest to the points on the chains that observed them.");
  m.def("count_around", &colmap_edges::CountAroundArrays, "pixels"_a, "depths"_a, "margins"_a,
        "curves"_a, "radius_px"_a, "slope"_a, "num_threads"_a,
        "(N,) how many points of other curves around each are nearer, and (N,) how many as far.");
  m.def("chain_points", &colmap_edges::ChainPointsArrays, "view"_a, "positions"_a,
        "(N, 2) ideal pixels and (N, 2) unit tangents at fractional positions on chains.");
  colmap_edges::BindImages(m);
  colmap_edges::BindTracing(m);
}
