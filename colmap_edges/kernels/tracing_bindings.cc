// Python face of edge fields, correspondences and following: converts arrays, releases the GIL,
// calls the core, converts back.
#include "tracing_bindings.h"

#include <stdexcept>

#include "arrays.h"
#include "correspondences.h"
#include "edge_field.h"
#include "following.h"
#include "geometry.h"
#include "parallel.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;
using Rotations = InArray<double, nb::shape<-1, 3, 3>>;
using Points3D = InArray<double, nb::shape<-1, 3>>;
using Points2D = InArray<double, nb::shape<-1, 2>>;
using Doubles = InArray<double, nb::ndim<1>>;
using Ints = InArray<int32_t, nb::ndim<1>>;
using Longs = InArray<int64_t, nb::ndim<1>>;
using Bools = InArray<bool, nb::ndim<1>>;

void Require(bool holds, const char* message) {
  if (!holds) throw std::invalid_argument(message);
}

void CheckCsr(const Longs& offsets, size_t count, size_t total) {
  Require(offsets.size() == count + 1 && offsets(0) == 0 && offsets(count) == int64_t(total),
          "offsets must have one more entry than items, start at 0 and end at the total");
  for (size_t i = 0; i < count; ++i) {
    Require(offsets(i) <= offsets(i + 1), "offsets must not decrease");
  }
}

void CheckViews(const Ints& views, size_t num_views) {
  for (size_t i = 0; i < views.size(); ++i) {
    Require(views(i) >= 0 && views(i) < int64_t(num_views), "view index out of range");
  }
}

std::vector<PinholeView> ToViews(const Rotations& R, const Points3D& t, const Doubles& focal_px) {
  Require(R.shape(0) == t.shape(0) && R.shape(0) == focal_px.size(),
          "rotations, translations and focal lengths differ in number");
  std::vector<PinholeView> views;
  for (size_t i = 0; i < R.shape(0); ++i) {
    views.push_back(MakePinholeView(R.data() + 9 * i, t.data() + 3 * i, focal_px(i)));
  }
  return views;
}

std::vector<Vec2> ToPoints(const Points2D& points) {
  std::vector<Vec2> result(points.shape(0));
  for (size_t i = 0; i < result.size(); ++i) result[i] = {points(i, 0), points(i, 1)};
  return result;
}

std::vector<ChainPosition> ToPositions(const EdgeField& field, const Longs& segments,
                                       const Doubles& fractions) {
  Require(segments.size() == fractions.size(), "segments and fractions differ in number");
  std::vector<ChainPosition> positions(segments.size());
  for (size_t i = 0; i < positions.size(); ++i) {
    Require(segments(i) >= 0 && segments(i) < int64_t(field.points().size()) &&
                field.Next(segments(i)) >= 0 && fractions(i) >= 0 && fractions(i) <= 1,
            "a position is not on a chain");
    positions[i] = {segments(i), fractions(i)};
  }
  return positions;
}

// CSR of lists: offsets, and the concatenation of the lists, which are emptied.
template <typename T>
std::vector<int64_t> Concatenate(std::vector<std::vector<T>>* lists, std::vector<T>* all) {
  std::vector<int64_t> offsets = {0};
  for (std::vector<T>& list : *lists) {
    all->insert(all->end(), list.begin(), list.end());
    offsets.push_back(int64_t(all->size()));
    std::vector<T>().swap(list);
  }
  return offsets;
}

// (offsets, segments, fractions) of lists of positions.
nb::tuple ToPositionArrays(std::vector<int64_t>&& offsets, const std::vector<ChainPosition>& at) {
  std::vector<int64_t> segments;
  std::vector<double> fractions;
  for (const ChainPosition& p : at) {
    segments.push_back(p.segment);
    fractions.push_back(p.fraction);
  }
  const size_t num_offsets = offsets.size(), count = at.size();
  return nb::make_tuple(ToArray(std::move(offsets), {num_offsets}),
                        ToArray(std::move(segments), {count}),
                        ToArray(std::move(fractions), {count}));
}

void InitEdgeField(EdgeField* self, Rotations R, Points3D t, Doubles focal_px, Points2D points,
                   Longs offsets, Ints polyline_views, Bools closed, double cell_px) {
  new (self) EdgeField(
      ToViews(R, t, focal_px), ToPoints(points),
      std::vector<int64_t>(offsets.data(), offsets.data() + offsets.size()),
      std::vector<int32_t>(polyline_views.data(), polyline_views.data() + polyline_views.size()),
      std::vector<uint8_t>(closed.data(), closed.data() + closed.size()), cell_px);
}

nb::tuple FindNearArrays(const EdgeField& field, Ints views, Points2D pixels, Doubles radii_px,
                         int num_threads) {
  const size_t count = views.size();
  Require(pixels.shape(0) == count && radii_px.size() == count,
          "views, pixels and radii_px differ in number");
  CheckViews(views, field.views().size());
  std::vector<NearPolyline> all;
  std::vector<int64_t> offsets;
  {
    nb::gil_scoped_release release;
    std::vector<std::vector<NearPolyline>> found(count);
    ParallelBlocks(int64_t(count), num_threads, 256, [&](int64_t i) {
      thread_local std::vector<NearPolyline> near;
      field.FindNear(views(i), {pixels(i, 0), pixels(i, 1)}, radii_px(i), &near);
      if (!near.empty()) found[i] = near;
    });
    offsets = Concatenate(&found, &all);
  }
  std::vector<int32_t> polylines;
  std::vector<int64_t> segments;
  std::vector<double> fractions, distances;
  for (const NearPolyline& near : all) {
    polylines.push_back(near.polyline);
    segments.push_back(near.position.segment);
    fractions.push_back(near.position.fraction);
    distances.push_back(near.distance);
  }
  const size_t total = all.size();
  return nb::make_tuple(
      ToArray(std::move(offsets), {count + 1}), ToArray(std::move(polylines), {total}),
      ToArray(std::move(segments), {total}), ToArray(std::move(fractions), {total}),
      ToArray(std::move(distances), {total}));
}

nb::tuple IntersectLinesArrays(const EdgeField& field, Ints views, Points3D lines,
                               int num_threads) {
  const size_t count = views.size();
  Require(lines.shape(0) == count, "views and lines differ in number");
  CheckViews(views, field.views().size());
  std::vector<ChainPosition> all;
  std::vector<int64_t> offsets;
  {
    nb::gil_scoped_release release;
    const Box2D everywhere{{-INFINITY, -INFINITY}, {INFINITY, INFINITY}};
    std::vector<std::vector<ChainPosition>> found(count);
    ParallelBlocks(int64_t(count), num_threads, 64, [&](int64_t i) {
      const double norm = std::hypot(lines(i, 0), lines(i, 1));
      if (!(norm > 0)) return;
      const Line2D line = {lines(i, 0) / norm, lines(i, 1) / norm, lines(i, 2) / norm};
      field.IntersectLine(views(i), line, everywhere, &found[i]);
    });
    offsets = Concatenate(&found, &all);
  }
  return ToPositionArrays(std::move(offsets), all);
}

nb::tuple TangentsArrays(const EdgeField& field, Longs segments, Doubles fractions) {
  const std::vector<ChainPosition> positions = ToPositions(field, segments, fractions);
  const size_t count = positions.size();
  std::vector<double> pixels(2 * count), tangents(2 * count);
  for (size_t i = 0; i < count; ++i) {
    const Vec2 pixel = field.At(positions[i]), tangent = field.Tangent(positions[i]);
    pixels[2 * i] = pixel.x, pixels[2 * i + 1] = pixel.y;
    tangents[2 * i] = tangent.x, tangents[2 * i + 1] = tangent.y;
  }
  return nb::make_tuple(ToArray(std::move(pixels), {count, 2}),
                        ToArray(std::move(tangents), {count, 2}));
}

nb::tuple CandidatesInSpheresArrays(const EdgeField& field, Longs start_segments,
                                    Doubles start_fractions, Longs start_spheres, Points3D centers,
                                    Doubles radii, Longs view_offsets, Ints views,
                                    int num_threads) {
  const std::vector<ChainPosition> starts = ToPositions(field, start_segments, start_fractions);
  Require(start_spheres.size() == starts.size(), "starts and spheres differ in number");
  Require(radii.size() == centers.shape(0), "centers and radii differ in number");
  CheckCsr(view_offsets, centers.shape(0), views.size());
  CheckViews(views, field.views().size());
  for (size_t i = 0; i < start_spheres.size(); ++i) {
    Require(start_spheres(i) >= 0 && start_spheres(i) < int64_t(centers.shape(0)),
            "sphere index out of range");
  }
  std::vector<ChainPosition> all;
  std::vector<int64_t> offsets;
  {
    nb::gil_scoped_release release;
    std::vector<std::vector<ChainPosition>> found(starts.size());
    ParallelBlocks(int64_t(starts.size()), num_threads, 64, [&](int64_t i) {
      const int64_t s = start_spheres(i);
      const SearchSphere sphere = {{centers(s, 0), centers(s, 1), centers(s, 2)},
                                   radii(s),
                                   views.data() + view_offsets(s),
                                   view_offsets(s + 1) - view_offsets(s)};
      CandidatesInSphere(field, starts[i], sphere, &found[i]);
    });
    offsets = Concatenate(&found, &all);
  }
  return ToPositionArrays(std::move(offsets), all);
}

// Polylines of each label, ascending: CSR.
std::vector<int64_t> PolylinesOfLabels(const Ints& labels, std::vector<int32_t>* all) {
  int32_t num_labels = 0;
  for (size_t p = 0; p < labels.size(); ++p) num_labels = std::max(num_labels, labels(p) + 1);
  std::vector<std::vector<int32_t>> members(num_labels);
  for (size_t p = 0; p < labels.size(); ++p) {
    if (labels(p) >= 0) members[labels(p)].push_back(int32_t(p));
  }
  return Concatenate(&members, all);
}

nb::tuple CandidatesInPecsArrays(const EdgeField& field, Longs start_segments,
                                 Doubles start_fractions, Ints labels, Points2D depth_ranges,
                                 int num_threads) {
  const std::vector<ChainPosition> starts = ToPositions(field, start_segments, start_fractions);
  Require(int64_t(labels.size()) == field.num_polylines(), "one label for each polyline is needed");
  Require(depth_ranges.shape(0) == field.views().size(), "one depth range a view is needed");
  std::vector<ChainPosition> all;
  std::vector<int64_t> offsets;
  {
    nb::gil_scoped_release release;
    std::vector<int32_t> members;
    const std::vector<int64_t> member_offsets = PolylinesOfLabels(labels, &members);
    std::vector<std::vector<ChainPosition>> found(starts.size());
    ParallelBlocks(int64_t(starts.size()), num_threads, 16, [&](int64_t i) {
      const int32_t label = labels(field.PolylineOf(starts[i]));
      if (label < 0) return;
      const int64_t first = member_offsets[label];
      CandidatesInPec(field, starts[i], members.data() + first, member_offsets[label + 1] - first,
                      depth_ranges.data(), &found[i]);
    });
    offsets = Concatenate(&found, &all);
  }
  return ToPositionArrays(std::move(offsets), all);
}

nb::tuple TriangulateTracksArrays(Rotations R, Points3D t, Doubles focal_px, Longs offsets,
                                  Ints track_views, Points2D track_pixels, int num_threads) {
  const std::vector<PinholeView> views = ToViews(R, t, focal_px);
  Require(offsets.size() > 0, "offsets are empty");
  Require(track_views.size() == track_pixels.shape(0), "views and pixels differ in number");
  const size_t count = offsets.size() - 1;
  CheckCsr(offsets, count, track_views.size());
  CheckViews(track_views, views.size());
  std::vector<double> points(3 * count), errors(count);
  {
    nb::gil_scoped_release release;
    ParallelBlocks(int64_t(count), num_threads, 256, [&](int64_t i) {
      thread_local std::vector<Sighting> sightings;
      sightings.clear();
      for (int64_t k = offsets(i); k < offsets(i + 1); ++k) {
        sightings.push_back({track_views(k), {track_pixels(k, 0), track_pixels(k, 1)}});
      }
      Vec3 point = {NAN, NAN, NAN};
      errors[i] = INFINITY;
      const int n = int(sightings.size());
      if (Triangulate(views.data(), sightings.data(), n, &point)) {
        errors[i] = MaxReprojectionError(views.data(), sightings.data(), n, point);
      } else {
        point = {NAN, NAN, NAN};
      }
      points[3 * i] = point.x, points[3 * i + 1] = point.y, points[3 * i + 2] = point.z;
    });
  }
  return nb::make_tuple(ToArray(std::move(points), {count, 3}),
                        ToArray(std::move(errors), {count}));
}

// Edges as arrays: points, edge_offsets, closed, track_offsets, track segments and fractions.
nb::tuple ToEdgeArrays(const std::vector<Edge3D>& edges, std::vector<StartOutcome>&& outcomes) {
  std::vector<double> points, fractions;
  std::vector<int64_t> edge_offsets = {0}, track_offsets = {0}, segments;
  std::vector<uint8_t> closed;
  for (const Edge3D& edge : edges) {
    for (const EdgePoint3D& point : edge.points) {
      points.insert(points.end(), {point.position.x, point.position.y, point.position.z});
      for (const ChainPosition& at : point.track) {
        segments.push_back(at.segment);
        fractions.push_back(at.fraction);
      }
      track_offsets.push_back(int64_t(segments.size()));
    }
    edge_offsets.push_back(int64_t(points.size() / 3));
    closed.push_back(edge.closed);
  }
  std::vector<uint8_t> codes;
  for (const StartOutcome outcome : outcomes) codes.push_back(uint8_t(outcome));
  const size_t num_points = points.size() / 3, num_edges = closed.size();
  const size_t total = segments.size(), num_starts = codes.size();
  return nb::make_tuple(
      ToArray(std::move(points), {num_points, 3}),
      ToArray(std::move(edge_offsets), {num_edges + 1}), ToArray(std::move(closed), {num_edges}),
      ToArray(std::move(track_offsets), {num_points + 1}), ToArray(std::move(segments), {total}),
      ToArray(std::move(fractions), {total}), ToArray(std::move(codes), {num_starts}));
}

nb::tuple TraceEdgesArrays(const EdgeField& field, Longs start_segments, Doubles start_fractions,
                           Longs offsets, Longs segments, Doubles fractions, double step_px,
                           double max_error_px, double max_step_ratio, double min_epipolar_sine,
                           double full_triangulation_sine, double max_stretch, int min_views,
                           int min_steps, int max_triples, int num_threads) {
  const std::vector<ChainPosition> starts = ToPositions(field, start_segments, start_fractions);
  const std::vector<ChainPosition> candidates = ToPositions(field, segments, fractions);
  CheckCsr(offsets, starts.size(), candidates.size());
  Require(step_px > 0 && max_error_px > 0, "step_px and max_error_px must be positive");
  Require(min_views >= 3, "min_views must be at least 3");
  const FollowSettings settings = {
      step_px,     max_error_px, max_step_ratio, min_epipolar_sine, full_triangulation_sine,
      max_stretch, min_views,    min_steps,      max_triples};
  std::vector<StartOutcome> outcomes;
  std::vector<Edge3D> edges;
  {
    nb::gil_scoped_release release;
    edges = TraceEdges(field,
                       {starts.data(), int64_t(starts.size()), offsets.data(), candidates.data()},
                       settings, num_threads, &outcomes);
  }
  return ToEdgeArrays(edges, std::move(outcomes));
}

}  // namespace

void BindTracing(nb::module_& m) {
  nb::class_<EdgeField>(m, "EdgeField", "Edge graphs of all views with a grid over their segments.")
      .def("__init__", &InitEdgeField, "rotations"_a, "translations"_a, "focals_px"_a, "points"_a,
           "offsets"_a, "polyline_views"_a, "closed"_a, "cell_px"_a)
      .def("find_near", &FindNearArrays, "views"_a, "pixels"_a, "radii_px"_a, "num_threads"_a,
           "Polylines near pixels: CSR offsets, polylines, segments, fractions, distances.")
      .def("intersect_lines", &IntersectLinesArrays, "views"_a, "lines"_a, "num_threads"_a,
           "Crossings of lines with chains: CSR offsets, segments, fractions.")
      .def("tangents", &TangentsArrays, "segments"_a, "fractions"_a,
           "(N, 2) pixels and (N, 2) unit tangents of places on chains.")
      .def("candidates_in_spheres", &CandidatesInSpheresArrays, "start_segments"_a,
           "start_fractions"_a, "start_spheres"_a, "centers"_a, "radii"_a, "view_offsets"_a,
           "views"_a, "num_threads"_a,
           "Candidates of starts inside projected spheres: CSR offsets, segments, fractions.")
      .def("candidates_in_pecs", &CandidatesInPecsArrays, "start_segments"_a, "start_fractions"_a,
           "labels"_a, "depth_ranges"_a, "num_threads"_a,
           "Candidates of starts on polylines of equal label: CSR offsets, segments, fractions.")
      .def("trace_edges", &TraceEdgesArrays, "start_segments"_a, "start_fractions"_a, "offsets"_a,
           "segments"_a, "fractions"_a, "step_px"_a, "max_error_px"_a, "max_step_ratio"_a,
           "min_epipolar_sine"_a, "full_triangulation_sine"_a, "max_stretch"_a, "min_views"_a,
           "min_steps"_a, "max_triples"_a, "num_threads"_a,
           "3D edges of PEPCs: points, edge offsets, closed, track offsets, track segments and "
           "fractions, and the outcome of each start.");
  m.def("triangulate_tracks", &TriangulateTracksArrays, "rotations"_a, "translations"_a,
        "focals_px"_a, "offsets"_a, "track_views"_a, "track_pixels"_a, "num_threads"_a,
        "(N, 3) least-squares points of tracks and (N,) largest errors in pixels; NaN and inf "
        "where a track does not triangulate.");
}

}  // namespace colmap_edges
