// Bindings of the paper's tracing: polylines near pixels, correspondences, following.
#include "common/bindings.h"

#include <nanobind/stl/vector.h>

#include "common/arrays.h"
#include "common/parallel.h"
#include "paper/agreement.h"
#include "paper/communities.h"
#include "paper/correspondences.h"
#include "paper/following.h"
#include "paper/places.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;

std::vector<Place> ToPlaces(const Views& views, const Ints& of_views, const Doubles& positions) {
  Require(of_views.size() == positions.size(), "views and positions differ in number");
  CheckViews(of_views, views.size());
  std::vector<Place> places(positions.size());
  for (size_t i = 0; i < places.size(); ++i) {
    places[i] = {of_views(i), positions(i)};
    Require(views[of_views(i)]->Holds(positions(i)), "a position is not on a chain");
  }
  return places;
}

// CSR of lists: offsets, and the concatenation of the lists, which are emptied meanwhile.
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

// Lists of places as (offsets, views, positions).
nb::tuple ToPlaceArrays(std::vector<int64_t>&& offsets, const std::vector<Place>& places) {
  std::vector<int32_t> views;
  std::vector<double> positions;
  for (const Place& place : places) {
    views.push_back(place.view), positions.push_back(place.position);
  }
  const size_t num_offsets = offsets.size(), count = places.size();
  return nb::make_tuple(ToArray(std::move(offsets), {num_offsets}),
                        ToArray(std::move(views), {count}), ToArray(std::move(positions), {count}));
}

nb::tuple NearPolylinesArrays(const Views& views, Ints of_views, Points2D pixels, Doubles radii_px,
                              int num_threads) {
  const size_t count = of_views.size();
  Require(pixels.shape(0) == count && radii_px.size() == count,
          "views, pixels and radii_px differ in number");
  CheckViews(of_views, views.size());
  std::vector<NearPolyline> all;
  std::vector<int64_t> offsets;
  {
    nb::gil_scoped_release release;
    std::vector<std::vector<NearPolyline>> found(count);
    ParallelBlocks(int64_t(count), num_threads, 256, [&](int64_t i) {
      thread_local std::vector<NearPolyline> near;
      FindNear(*views[of_views(i)], {pixels(i, 0), pixels(i, 1)}, radii_px(i), &near);
      if (!near.empty()) found[i] = near;
    });
    offsets = Concatenate(&found, &all);
  }
  std::vector<int32_t> polylines;
  std::vector<double> positions, distances;
  for (const NearPolyline& near : all) {
    polylines.push_back(near.polyline);
    positions.push_back(near.position), distances.push_back(near.distance);
  }
  const size_t total = all.size();
  return nb::make_tuple(
      ToArray(std::move(offsets), {count + 1}), ToArray(std::move(polylines), {total}),
      ToArray(std::move(positions), {total}), ToArray(std::move(distances), {total}));
}

nb::tuple CandidatesInSpheresArrays(const Views& views, Ints start_views, Doubles start_positions,
                                    Longs start_spheres, Points3D centers, Doubles radii,
                                    Longs sphere_offsets, Ints sphere_views, int num_threads) {
  const std::vector<Place> starts = ToPlaces(views, start_views, start_positions);
  Require(start_spheres.size() == starts.size(), "starts and spheres differ in number");
  Require(radii.size() == centers.shape(0), "centers and radii differ in number");
  CheckOffsets(sphere_offsets, centers.shape(0), sphere_views.size());
  CheckViews(sphere_views, views.size());
  for (size_t i = 0; i < start_spheres.size(); ++i) {
    Require(start_spheres(i) >= 0 && start_spheres(i) < int64_t(centers.shape(0)),
            "sphere index out of range");
  }
  std::vector<Place> all;
  std::vector<int64_t> offsets;
  {
    nb::gil_scoped_release release;
    std::vector<std::vector<Place>> found(starts.size());
    ParallelBlocks(int64_t(starts.size()), num_threads, 64, [&](int64_t i) {
      const int64_t s = start_spheres(i);
      const SearchSphere sphere = {{centers(s, 0), centers(s, 1), centers(s, 2)},
                                   radii(s),
                                   sphere_views.data() + sphere_offsets(s),
                                   sphere_offsets(s + 1) - sphere_offsets(s)};
      CandidatesInSphere(views, starts[i], sphere, &found[i]);
    });
    offsets = Concatenate(&found, &all);
  }
  return ToPlaceArrays(std::move(offsets), all);
}

nb::tuple AgreedDepthsArrays(Doubles lows, Doubles highs, Ints of_views, int min_views) {
  const size_t count = lows.size();
  Require(highs.size() == count && of_views.size() == count,
          "lows, highs and views differ in number");
  std::vector<DepthInterval> intervals(count);
  for (size_t i = 0; i < count; ++i) {
    Require(of_views(i) >= 0, "views must not be negative");
    intervals[i] = {lows(i), highs(i), of_views(i)};
  }
  std::vector<AgreedDepth> agreed;
  FindAgreement(intervals, min_views, &agreed);
  std::vector<double> inverse_distances;
  std::vector<int32_t> num_views;
  for (const AgreedDepth& depth : agreed) {
    inverse_distances.push_back(depth.inverse_distance), num_views.push_back(depth.num_views);
  }
  const size_t total = agreed.size();
  return nb::make_tuple(ToArray(std::move(inverse_distances), {total}),
                        ToArray(std::move(num_views), {total}));
}

nb::object LouvainArray(int num_nodes, Ints firsts, Ints seconds, Doubles weights,
                        double resolution, uint64_t seed) {
  Require(num_nodes >= 0, "num_nodes must not be negative");
  Require(firsts.size() == weights.size() && seconds.size() == weights.size(),
          "links and weights differ in number");
  std::vector<WeightedLink> links;
  for (size_t i = 0; i < weights.size(); ++i) {
    Require(std::min(firsts(i), seconds(i)) >= 0 && std::max(firsts(i), seconds(i)) < num_nodes,
            "node index out of range");
    Require(std::isfinite(weights(i)) && weights(i) > 0, "weights must be positive");
    links.push_back({firsts(i), seconds(i), weights(i)});
  }
  std::vector<int32_t> labels;
  {
    nb::gil_scoped_release release;
    labels = LouvainCommunities(num_nodes, std::move(links), resolution, seed);
  }
  return nb::cast(ToArray(std::move(labels), {size_t(num_nodes)}));
}

// Runs of the polylines of each label, by view and ascending, in CSR arrays. `labels` covers the
// polylines of all views.
std::vector<int64_t> RunsOfLabels(const Views& views, const Ints& labels,
                                  std::vector<PecRun>* all) {
  int32_t num_labels = 0;
  for (size_t p = 0; p < labels.size(); ++p) num_labels = std::max(num_labels, labels(p) + 1);
  std::vector<std::vector<PecRun>> runs(num_labels);
  size_t row = 0;
  for (int32_t view = 0; view < int32_t(views.size()); ++view) {
    for (int32_t p = 0; p < views[view]->num_polylines(); ++p, ++row) {
      if (labels(row) >= 0) AddRuns(views, view, p, &runs[labels(row)]);
    }
  }
  return Concatenate(&runs, all);
}

nb::tuple CandidatesInPecsArrays(const Views& views, Ints start_views, Doubles start_positions,
                                 Ints labels, Points2D depth_ranges, int num_threads) {
  const std::vector<Place> starts = ToPlaces(views, start_views, start_positions);
  // Index of the first polyline of each view.
  std::vector<int64_t> firsts = {0};
  for (const EdgeIndex* chains : views) firsts.push_back(firsts.back() + chains->num_polylines());
  Require(int64_t(labels.size()) == firsts.back(), "one label for each polyline is needed");
  Require(depth_ranges.shape(0) == views.size(), "one depth range a view is needed");
  std::vector<Place> all;
  std::vector<int64_t> offsets;
  {
    nb::gil_scoped_release release;
    std::vector<PecRun> runs;
    const std::vector<int64_t> run_offsets = RunsOfLabels(views, labels, &runs);
    std::vector<std::vector<Place>> found(starts.size());
    ParallelBlocks(int64_t(starts.size()), num_threads, 16, [&](int64_t i) {
      const Place& start = starts[i];
      const int32_t polyline = views[start.view]->polyline(int64_t(start.position));
      const int32_t label = labels(firsts[start.view] + polyline);
      if (label < 0) return;
      const int64_t first = run_offsets[label];
      CandidatesInPec(views, start, runs.data() + first, run_offsets[label + 1] - first,
                      depth_ranges.data(), &found[i]);
    });
    offsets = Concatenate(&found, &all);
  }
  return ToPlaceArrays(std::move(offsets), all);
}

// Edges as arrays: points, edge_offsets, closed, track_offsets, track views and positions.
nb::tuple ToEdgeArrays(const std::vector<Edge3D>& edges, std::vector<StartOutcome>&& outcomes) {
  std::vector<double> points, positions;
  std::vector<int64_t> edge_offsets = {0}, track_offsets = {0};
  std::vector<int32_t> views;
  std::vector<uint8_t> closed;
  for (const Edge3D& edge : edges) {
    for (const EdgePoint3D& point : edge.points) {
      points.insert(points.end(), {point.position.x, point.position.y, point.position.z});
      for (const Place& at : point.track) {
        views.push_back(at.view), positions.push_back(at.position);
      }
      track_offsets.push_back(int64_t(views.size()));
    }
    edge_offsets.push_back(int64_t(points.size() / 3));
    closed.push_back(edge.closed);
  }
  std::vector<uint8_t> codes;
  for (const StartOutcome outcome : outcomes) codes.push_back(uint8_t(outcome));
  const size_t num_points = points.size() / 3, num_edges = closed.size();
  const size_t total = views.size(), num_starts = codes.size();
  return nb::make_tuple(
      ToArray(std::move(points), {num_points, 3}),
      ToArray(std::move(edge_offsets), {num_edges + 1}), ToArray(std::move(closed), {num_edges}),
      ToArray(std::move(track_offsets), {num_points + 1}), ToArray(std::move(views), {total}),
      ToArray(std::move(positions), {total}), ToArray(std::move(codes), {num_starts}));
}

// The chain points of all views that are covered by 3D edges.
struct CoveredChains {
  explicit CoveredChains(const Views& views) : points(NothingCovered(views)) {}
  Coverage points;
};

nb::object Covers(const CoveredChains& covered, Ints of_views, Doubles positions) {
  const size_t count = of_views.size();
  Require(positions.size() == count, "views and positions differ in number");
  CheckViews(of_views, covered.points.size());
  std::vector<uint8_t> result(count);
  for (size_t i = 0; i < count; ++i) {
    const double limit = double(covered.points[of_views(i)].size());
    Require(positions(i) >= 0 && positions(i) < limit, "a position is not on a chain");
    result[i] = IsCovered({of_views(i), positions(i)}, covered.points);
  }
  return nb::cast(ToArray(std::move(result), {count}));
}

nb::tuple TraceEdgesArrays(const Views& views, CoveredChains& covered, Ints start_views,
                           Doubles start_positions, Longs offsets, Ints candidate_views,
                           Doubles candidate_positions, double step_px, double max_error_px,
                           double max_step_ratio, double min_epipolar_sine,
                           double full_triangulation_sine, double max_stretch, int min_views,
                           int min_steps, int max_selections, int num_threads) {
  const std::vector<Place> starts = ToPlaces(views, start_views, start_positions);
  const std::vector<Place> candidates = ToPlaces(views, candidate_views, candidate_positions);
  CheckOffsets(offsets, starts.size(), candidates.size());
  Require(step_px > 0 && max_error_px > 0, "step_px and max_error_px must be positive");
  Require(min_views >= 3, "min_views must be at least 3");
  Require(covered.points.size() == views.size(), "coverage is of other views");
  for (size_t v = 0; v < views.size(); ++v) {
    Require(int64_t(covered.points[v].size()) == views[v]->num_points(),
            "coverage is of other views");
  }
  const FollowSettings settings = {
      step_px,     max_error_px, max_step_ratio, min_epipolar_sine, full_triangulation_sine,
      max_stretch, min_views,    min_steps,      max_selections};
  std::vector<StartOutcome> outcomes;
  std::vector<Edge3D> edges;
  {
    nb::gil_scoped_release release;
    edges = TraceEdges(views,
                       {starts.data(), int64_t(starts.size()), offsets.data(), candidates.data()},
                       settings, num_threads, &covered.points, &outcomes);
  }
  return ToEdgeArrays(edges, std::move(outcomes));
}

}  // namespace

void BindPaper(nb::module_& m) {
  m.def("near_polylines", &NearPolylinesArrays, "indexes"_a, "views"_a, "pixels"_a, "radii_px"_a,
        "num_threads"_a,
        "Polylines near pixels of views: CSR offsets, polylines, positions, distances.");
  m.def("candidates_in_spheres", &CandidatesInSpheresArrays, "indexes"_a, "start_views"_a,
        "start_positions"_a, "start_spheres"_a, "centers"_a, "radii"_a, "sphere_offsets"_a,
        "sphere_views"_a, "num_threads"_a,
        "Candidates of starts inside projected spheres: CSR offsets, views, positions.");
  m.def("candidates_in_pecs", &CandidatesInPecsArrays, "indexes"_a, "start_views"_a,
        "start_positions"_a, "labels"_a, "depth_ranges"_a, "num_threads"_a,
        "Candidates of starts on polylines of equal label: CSR offsets, views, positions.");
  m.def("louvain_communities", &LouvainArray, "num_nodes"_a, "firsts"_a, "seconds"_a, "weights"_a,
        "resolution"_a, "seed"_a,
        "(N,) communities of a weighted graph by Louvain's method, numbered by their first nodes.");
  m.def("agreed_depths", &AgreedDepthsArrays, "lows"_a, "highs"_a, "views"_a, "min_views"_a,
        "Maxima of the overlap of the views' intervals: inverse distances and numbers of views.");
  nb::class_<CoveredChains>(m, "CoveredChains", "Which chain points of all views 3D edges cover.")
      .def(nb::init<const Views&>(), "indexes"_a)
      .def("covers", &Covers, "views"_a, "positions"_a, "(N,) whether places are covered, uint8.");
  m.def("trace_edges", &TraceEdgesArrays, "indexes"_a, "covered"_a, "start_views"_a,
        "start_positions"_a, "offsets"_a, "candidate_views"_a, "candidate_positions"_a, "step_px"_a,
        "max_error_px"_a, "max_step_ratio"_a, "min_epipolar_sine"_a, "full_triangulation_sine"_a,
        "max_stretch"_a, "min_views"_a, "min_steps"_a, "max_selections"_a, "num_threads"_a,
        "3D edges of PEPCs, which are added to `covered`: points, edge offsets, closed, track "
        "offsets, track views and positions, and the outcome of each start.");
}

}  // namespace colmap_edges
