// Bindings common to both methods: index of a view's edge graph, polylines, triangulation.
#include "common/bindings.h"

#include <nanobind/stl/vector.h>

#include <cmath>

#include "common/arrays.h"
#include "common/edge_index.h"
#include "common/geometry.h"
#include "common/parallel.h"
#include "common/piecewise.h"
#include "common/polyline.h"
#include "common/records.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;

template <typename T>
using Pairs = InArray<T, nb::shape<-1, 2>>;

template <typename T>
std::vector<std::array<T, 2>> ToPairs(const Pairs<T>& rows) {
  std::vector<std::array<T, 2>> pairs(rows.shape(0));
  for (size_t i = 0; i < pairs.size(); ++i) pairs[i] = {rows(i, 0), rows(i, 1)};
  return pairs;
}

void InitEdgeIndex(EdgeIndex* self, Pairs<float> points, Pairs<float> normals, Pairs<uint8_t> sides,
                   Longs offsets, Bools closed, Rotation rotation, Translation translation,
                   double focal) {
  const nb::gil_scoped_release release;
  new (self) EdgeIndex(ToPairs(points), ToPairs(normals), ToPairs(sides), ToVector(offsets),
                       {closed.data(), closed.data() + closed.size()},
                       MakePinholeView(rotation.data(), translation.data(), focal));
}

nb::tuple WalkRecordsArrays(InArray<uint8_t, nb::ndim<1>> data, int64_t first, uint64_t num_records,
                            int64_t head_size, int64_t element_size) {
  const int64_t size = int64_t(data.size());
  Require(first >= 0 && first <= size, "the first record is outside the data");
  Require(head_size >= 8 && element_size > 0,
          "records have heads of 8 bytes or more, and elements");
  Records found = WalkRecords(data.data(), size, first, num_records, head_size, element_size);
  const size_t count = found.starts.size();
  return nb::make_tuple(ToArray(std::move(found.starts), {count}),
                        ToArray(std::move(found.counts), {count}), found.end);
}

int CheckTracksArrays(InArray<uint8_t, nb::ndim<1>> data, Longs starts, Longs counts,
                      int64_t head_size, Longs image_ids, Longs num_points2D) {
  Require(starts.size() == counts.size() && image_ids.size() == num_points2D.size(),
          "starts and counts, or image_ids and num_points2D, differ in length");
  for (size_t i = 0; i < starts.size(); ++i) {
    const int64_t left = int64_t(data.size()) - head_size - starts(i);
    Require(
        starts(i) >= 0 && counts(i) >= 0 && head_size >= 0 && left >= 0 && counts(i) <= left / 8,
        "a track is outside the data");
  }
  const nb::gil_scoped_release release;
  return int(CheckTracks(data.data(), starts.data(), counts.data(), int64_t(starts.size()),
                         head_size, image_ids.data(), num_points2D.data(),
                         int64_t(image_ids.size())));
}

nb::tuple ChainPointsArrays(const EdgeIndex& chains, Doubles positions) {
  const size_t count = positions.size();
  std::vector<double> points(2 * count), tangents(2 * count);
  {
    const nb::gil_scoped_release release;
    for (size_t i = 0; i < count; ++i) {
      Require(chains.Holds(positions(i)), "a position is not on a chain");
      const Vec2 point = chains.At(positions(i)), tangent = chains.tangent(int64_t(positions(i)));
      points[2 * i] = point.x, points[2 * i + 1] = point.y;
      tangents[2 * i] = tangent.x, tangents[2 * i + 1] = tangent.y;
    }
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

// Costs: one row of PieceCosts, in the order of its fields, per polyline.
nb::tuple CutPiecesArrays(Points3D points, Doubles weights, Longs offsets,
                          InArray<double, nb::shape<-1, -1, 5>> costs, int64_t max_places,
                          int num_threads) {
  Require(weights.size() == points.shape(0), "points and weights differ in number");
  CheckOffsets(offsets, points.shape(0));
  const int64_t rows = int64_t(costs.shape(0)), count = int64_t(offsets.size()) - 1;
  Require(int64_t(costs.shape(1)) == count, "costs must have a row for each polyline");
  Require(max_places > 0, "max_places must be positive");
  std::vector<double> totals(rows * count);
  std::vector<std::vector<Piece>> found(rows * count);
  {
    nb::gil_scoped_release release;
    const auto* all = reinterpret_cast<const Vec3*>(points.data());
    ParallelFor(count, num_threads, [&](int64_t e, int) {
      const int64_t first = offsets(e), size = offsets(e + 1) - first;
      if (size == 0) return;
      const PieceTable table(all + first, weights.data() + first, PlacesToCut(size, max_places));
      for (int64_t row = 0; row < rows; ++row) {
        const PieceCosts cost = {costs(row, e, 0), costs(row, e, 1), costs(row, e, 2),
                                 costs(row, e, 3), costs(row, e, 4)};
        std::vector<Piece>& pieces = found[row * count + e];
        totals[row * count + e] = table.Cut(cost, &pieces);
        if (rows > 1 || size <= max_places) continue;
        // The best cuts between spaced places are refined among all points around them.
        const PieceTable fine(all + first, weights.data() + first,
                              PlacesNear(pieces, size, 1 + size / max_places));
        pieces.clear();
        totals[row * count + e] = fine.Cut(cost, &pieces);
      }
    });
  }
  std::vector<int64_t> bounds;
  std::vector<int32_t> kinds;
  std::vector<int64_t> piece_offsets = {0};
  for (int64_t i = 0; i < rows * count; ++i) {
    for (const Piece& piece : found[i]) {
      bounds.push_back(offsets(i % count) + piece.first);
      bounds.push_back(offsets(i % count) + piece.last);
      kinds.push_back(piece.kind);
    }
    piece_offsets.push_back(int64_t(kinds.size()));
  }
  const size_t num_pieces = kinds.size(), num_offsets = piece_offsets.size();
  return nb::make_tuple(ToArray(std::move(totals), {size_t(rows), size_t(count)}),
                        ToArray(std::move(bounds), {num_pieces, 2}),
                        ToArray(std::move(kinds), {num_pieces}),
                        ToArray(std::move(piece_offsets), {num_offsets}));
}

}  // namespace

void BindCommon(nb::module_& m) {
  nb::class_<EdgeIndex>(m, "EdgeIndex", "A view's edge graph with its pose, searchable.")
      .def("__init__", &InitEdgeIndex, "points"_a, "normals"_a, "sides"_a, "offsets"_a, "closed"_a,
           "rotation"_a, "translation"_a, "focal"_a)
      .def_prop_ro("num_polylines", &EdgeIndex::num_polylines);
  m.def(
      "walk_records", &WalkRecordsArrays, "data"_a, "first"_a, "num_records"_a, "head_size"_a,
      "element_size"_a,
      "Byte offsets (N,) int64 of consecutive records in the (n,) bytes of a file, each a header\n"
      "that ends with a count (8 bytes) followed by the elements; the (N,) int64 counts; and the\n"
      "end of the last record, n + 1 if the data end within a record.");
  m.def("check_tracks", &CheckTracksArrays, "data"_a, "starts"_a, "counts"_a, "head_size"_a,
        "image_ids"_a, "num_points2D"_a,
        "1 if a track names an image that is not among the ascending ids, 2 if a point2D that its "
        "image does not have, else 0. Tracks are pairs of uint32 behind the heads at `starts`.");
  m.def("chain_points", &ChainPointsArrays, "index"_a, "positions"_a,
        "(N, 2) undistorted pixels and (N, 2) unit tangents at fractional positions on chains.");
  m.def("douglas_peucker", &DouglasPeuckerArrays, "points"_a, "offsets"_a, "distance"_a,
        "Indices that Douglas-Peucker keeps of each polyline, and their CSR offsets.");
  m.def(
      "cut_pieces", &CutPiecesArrays, "points"_a, "weights"_a, "offsets"_a, "costs"_a,
      "max_places"_a, "num_threads"_a,
      "Segmentation of polylines into lines, arcs and outliers at least cost: (R, E) costs, (K, 2) "
      "ranges of points, (K,) kinds (0 line, 1 arc, -1 outliers) and (R E + 1,) offsets of the "
      "pieces by row of costs and polyline.");
  m.def("triangulate_tracks", &TriangulateTracksArrays, "views"_a, "offsets"_a, "track_views"_a,
        "track_pixels"_a, "num_threads"_a,
        "(N, 3) least-squares points of tracks and (N,) largest errors in pixels; NaN and inf if "
        "a track cannot be triangulated.");
}

}  // namespace colmap_edges
