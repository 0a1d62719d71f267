// Python face of what all tracing uses: the index of a view's edge graph, polylines, triangulation.
#include "common/bindings.h"

#include <nanobind/stl/vector.h>

#include <cmath>

#include "common/arrays.h"
#include "common/edge_index.h"
#include "common/geometry.h"
#include "common/parallel.h"
#include "common/polyline.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;

void InitEdgeIndex(EdgeIndex* self, Points2D points, Points2D normals,
                   InArray<uint8_t, nb::shape<-1, 2>> sides, Longs offsets, Bools closed,
                   Rotation rotation, Translation translation, double focal) {
  std::vector<Sides> grays(sides.shape(0));
  for (size_t i = 0; i < grays.size(); ++i) grays[i] = {sides(i, 0), sides(i, 1)};
  new (self) EdgeIndex(ToVec2(points), ToVec2(normals), grays, ToVector(offsets),
                       {closed.data(), closed.data() + closed.size()},
                       MakePinholeView(rotation.data(), translation.data(), focal));
}

nb::tuple ChainPointsArrays(const EdgeIndex& chains, Doubles positions) {
  const size_t count = positions.size();
  std::vector<double> points(2 * count), tangents(2 * count);
  for (size_t i = 0; i < count; ++i) {
    Require(chains.Holds(positions(i)), "a position is not on a chain");
    const Vec2 point = chains.At(positions(i)), tangent = chains.tangent(int64_t(positions(i)));
    points[2 * i] = point.x, points[2 * i + 1] = point.y;
    tangents[2 * i] = tangent.x, tangents[2 * i + 1] = tangent.y;
  }
  return nb::make_tuple(ToArray(std::move(points), {count, 2}),
                        ToArray(std::move(tangents), {count, 2}));
}

nb::tuple DouglasPeuckerArrays(Points2D points, Longs offsets, double distance) {
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

nb::tuple TriangulateTracksArrays(const std::vector<const EdgeIndex*>& views, Longs offsets,
                                  Ints track_views, Points2D track_pixels, int num_threads) {
  Require(track_views.size() == track_pixels.shape(0), "views and pixels differ in number");
  CheckOffsets(offsets, track_views.size());
  CheckViews(track_views, views.size());
  const size_t count = offsets.size() - 1;
  std::vector<double> points(3 * count), errors(count);
  {
    nb::gil_scoped_release release;
    ParallelBlocks(int64_t(count), num_threads, 256, [&](int64_t i) {
      thread_local std::vector<Sighting> sightings;
      sightings.clear();
      for (int64_t k = offsets(i); k < offsets(i + 1); ++k) {
        sightings.push_back(
            {&views[track_views(k)]->pose(), {track_pixels(k, 0), track_pixels(k, 1)}});
      }
      Vec3 point;
      const int n = int(sightings.size());
      const bool found = Triangulate(sightings.data(), n, &point);
      if (!found) point = {NAN, NAN, NAN};
      errors[i] = found ? MaxReprojectionError(sightings.data(), n, point) : INFINITY;
      points[3 * i] = point.x, points[3 * i + 1] = point.y, points[3 * i + 2] = point.z;
    });
  }
  return nb::make_tuple(ToArray(std::move(points), {count, 3}),
                        ToArray(std::move(errors), {count}));
}

}  // namespace

void BindCommon(nb::module_& m) {
  nb::class_<EdgeIndex>(m, "EdgeIndex", "A view's edge graph with its pose, searchable.")
      .def("__init__", &InitEdgeIndex, "points"_a, "normals"_a, "sides"_a, "offsets"_a, "closed"_a,
           "rotation"_a, "translation"_a, "focal"_a)
      .def_prop_ro("num_polylines", &EdgeIndex::num_polylines);
  m.def("chain_points", &ChainPointsArrays, "index"_a, "positions"_a,
        "(N, 2) ideal pixels and (N, 2) unit tangents at fractional positions on chains.");
  m.def("douglas_peucker", &DouglasPeuckerArrays, "points"_a, "offsets"_a, "distance"_a,
        "Indices that Douglas-Peucker keeps of each polyline, and their CSR offsets.");
  m.def("triangulate_tracks", &TriangulateTracksArrays, "views"_a, "offsets"_a, "track_views"_a,
        "track_pixels"_a, "num_threads"_a,
        "(N, 3) least-squares points of tracks and (N,) largest errors in pixels; NaN and inf "
        "where a track does not triangulate.");
}

}  // namespace colmap_edges
