// Bindings of the search for planes and cylinders, and of what lies on planes.
#include "common/arrays.h"
#include "common/bindings.h"
#include "faces/cylinders.h"
#include "faces/hypotheses.h"
#include "faces/incidence.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;

PlaneEvidence ToEvidence(const Points3D& points, const Points3D& tangents, const Points3D& rays,
                         const Doubles& sigmas) {
  const size_t count = points.shape(0);
  Require(tangents.shape(0) == count && rays.shape(0) == count && sigmas.size() == count,
          "what is known of the points differs in number");
  return {points.data(), tangents.data(), rays.data(), sigmas.data(), int64_t(count)};
}

std::vector<Plane> ToPlanes(const Points3D& normals, const Doubles& offsets) {
  Require(normals.shape(0) == offsets.size(), "normals and offsets differ in number");
  std::vector<Plane> planes;
  for (size_t k = 0; k < offsets.size(); ++k)
    planes.push_back({{normals(k, 0), normals(k, 1), normals(k, 2)}, offsets(k)});
  return planes;
}

nb::tuple ToArrays(Rows<int32_t>&& rows) {
  const size_t count = rows.offsets.size(), total = rows.entries.size();
  return nb::make_tuple(ToArray(std::move(rows.offsets), {count}),
                        ToArray(std::move(rows.entries), {total}));
}

nb::tuple SearchPlanesArrays(Points3D points, Points3D tangents, Points3D rays, Doubles sigmas,
                             Doubles weights, Points3D normals, Doubles offsets, Points3D common,
                             double max_slope, Doubles options, int max_planes, bool with_ends) {
  const PlaneEvidence evidence = ToEvidence(points, tangents, rays, sigmas);
  Require(weights.size() == sigmas.size(), "points and weights differ in number");
  Require(options.size() == 5, "options are missing");
  const PlaneSearchOptions search{options(0), options(1), options(2),
                                  options(3), options(4), max_planes};
  const std::vector<Plane> planes = ToPlanes(normals, offsets);
  std::vector<Vec3> axes;
  for (size_t i = 0; i < common.shape(0); ++i)
    axes.push_back({common(i, 0), common(i, 1), common(i, 2)});
  std::vector<double> found_normals, found_offsets;
  size_t num_first;
  {
    nb::gil_scoped_release release;
    const PlanePoints tried(evidence, max_slope);
    const auto [found, count] =
        PlaneSearch(tried, weights.data(), axes, search).Run(planes, with_ends);
    for (const Plane& plane : found) {
      found_normals.insert(found_normals.end(), {plane.normal.x, plane.normal.y, plane.normal.z});
      found_offsets.push_back(plane.offset);
    }
    num_first = count;
  }
  const size_t count = found_offsets.size();
  return nb::make_tuple(ToArray(std::move(found_normals), {count, 3}),
                        ToArray(std::move(found_offsets), {count}), num_first);
}

nb::tuple PlanesOfPointsArrays(Points3D points, Points3D tangents, Points3D rays, Doubles sigmas,
                               Points3D normals, Doubles offsets, double tolerance,
                               double max_slope) {
  const PlaneEvidence evidence = ToEvidence(points, tangents, rays, sigmas);
  const std::vector<Plane> planes = ToPlanes(normals, offsets);
  Rows<int32_t> rows;
  {
    nb::gil_scoped_release release;
    rows = PlanesOfPoints(evidence, planes, tolerance, max_slope);
  }
  return ToArrays(std::move(rows));
}

nb::tuple NeighborsOfArrays(Longs offsets, Ints views, Longs observed_offsets, Ints observed,
                            int most) {
  CheckOffsets(offsets, views.size());
  CheckOffsets(observed_offsets, observed.size());
  CheckViews(views, observed_offsets.size() - 1);
  CheckViews(observed, offsets.size() - 1);
  Require(most >= 0, "the number of neighbours must not be negative");
  Rows<int32_t> rows;
  {
    nb::gil_scoped_release release;
    rows = NeighborsOf(offsets.data(), views.data(), ToVector(observed_offsets), observed.data(),
                       size_t(most));
  }
  return ToArrays(std::move(rows));
}

using Pairs3D = InArray<double, nb::shape<-1, 2, 3>>;
using Ends3D = InArray<double, nb::shape<-1, 2, 2, 3>>;

OutlinePairs ToPairs(const Translation& center, double focal_px, const Pairs3D& normals,
                     const Points3D& middles, const Points2D& turns, const Ends3D& rays) {
  const size_t count = normals.shape(0);
  Require(middles.shape(0) == count && turns.shape(0) == count && rays.shape(0) == count,
          "what is known of the pairs differs in number");
  return {{center(0), center(1), center(2)},
          focal_px,
          normals.data(),
          middles.data(),
          turns.data(),
          rays.data(),
          int64_t(count)};
}

OutArray<int64_t> PairsOfOneRadiusArrays(Translation center, double focal_px, Pairs3D normals,
                                         Points3D middles, Points2D turns, Ends3D rays,
                                         Translation other_center, double other_focal_px,
                                         Pairs3D other_normals, Points3D other_middles,
                                         Points2D other_turns, Ends3D other_rays, double min_sine,
                                         double slack_px) {
  const OutlinePairs one = ToPairs(center, focal_px, normals, middles, turns, rays);
  const OutlinePairs other =
      ToPairs(other_center, other_focal_px, other_normals, other_middles, other_turns, other_rays);
  std::vector<int64_t> found;
  {
    nb::gil_scoped_release release;
    found = PairsOfOneRadius(one, other, min_sine, slack_px);
  }
  const size_t count = found.size() / 2;
  return ToArray(std::move(found), {count, 2});
}

}  // namespace

void BindFaceHypotheses(nb::module_& m) {
  m.def("search_planes", &SearchPlanesArrays, "points"_a, "tangents"_a, "rays"_a, "sigmas"_a,
        "weights"_a, "normals"_a, "offsets"_a, "common"_a, "max_slope"_a, "options"_a,
        "max_planes"_a, "with_ends"_a,
        "Normals and offsets of the planes chosen among candidates, then, if wanted, of those at "
        "which others end, and the number of the first.");
  m.def("planes_of_points", &PlanesOfPointsArrays, "points"_a, "tangents"_a, "rays"_a, "sigmas"_a,
        "normals"_a, "offsets"_a, "tolerance"_a, "max_slope"_a,
        "Offsets and planes, row by row, that each point lies on.");
  m.def("neighbors_of", &NeighborsOfArrays, "offsets"_a, "views"_a, "observed_offsets"_a,
        "observed"_a, "most"_a,
        "Offsets and views, row by row, that see the most of the same points as each view.");
  m.def("pairs_of_one_radius", &PairsOfOneRadiusArrays, "center"_a, "focal_px"_a, "normals"_a,
        "middles"_a, "turns"_a, "rays"_a, "other_center"_a, "other_focal_px"_a, "other_normals"_a,
        "other_middles"_a, "other_turns"_a, "other_rays"_a, "min_sine"_a, "slack_px"_a,
        "Pairs of outlines, one of each of two views, that may be of one cylinder.");
}

}  // namespace colmap_edges
