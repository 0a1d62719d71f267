// Bindings of the test of whether cells are enclosed by observed points.
#include "common/arrays.h"
#include "common/bindings.h"
#include "faces/enclosure.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;
using Bytes2D = InArray<uint8_t, nb::ndim<2>>;
using Labels2D = InArray<int32_t, nb::ndim<2>>;
using Steps = InArray<int32_t, nb::shape<-1, 2>>;

EnclosureOptions ToOptions(const Steps& directions, int max_open, double min_share) {
  EnclosureOptions options{{}, max_open, min_share};
  for (size_t i = 0; i < directions.shape(0); ++i) {
    Require(directions(i, 0) != 0 || directions(i, 1) != 0, "directions must not be 0");
    options.directions.push_back({directions(i, 0), directions(i, 1)});
  }
  return options;
}

std::vector<Extent> ToExtents(const Points3D& directions, const Points2D& extents,
                              size_t num_planes) {
  const size_t num_sides = extents.shape(0);
  Require(directions.shape(0) == num_sides &&
              (num_planes == 0 ? num_sides == 0 : num_sides % num_planes == 0),
          "extents must have as many directions on every plane");
  std::vector<Extent> result(num_planes);
  for (size_t i = 0; i < num_sides; ++i) {
    Extent& extent = result[i / (num_sides / num_planes)];
    extent.directions.push_back({directions(i, 0), directions(i, 1), directions(i, 2)});
    extent.low.push_back(extents(i, 0)), extent.high.push_back(extents(i, 1));
  }
  return result;
}

OutArray<uint8_t> EnclosedCellsArray(Labels2D shown, InArray<uint8_t, nb::ndim<3>> touched,
                                     Bytes2D inside, Steps directions, int max_open) {
  const size_t rows = shown.shape(0), columns = shown.shape(1);
  Require(touched.shape(0) == rows && touched.shape(1) == columns && inside.shape(0) == rows &&
              inside.shape(1) == columns,
          "grids differ in shape");
  for (size_t i = 0; i < shown.size(); ++i)
    Require(shown.data()[i] < int64_t(touched.shape(2)), "labels hold an unknown plane");
  const CellGrid grid{int32_t(columns), int32_t(rows),  int32_t(touched.shape(2)),
                      shown.data(),     touched.data(), inside.data()};
  return ToArray(EnclosedCells(grid, ToOptions(directions, max_open, 0)), {rows, columns});
}

OutArray<uint8_t> WholePiecesArray(Labels2D shown, Bytes2D enclosed, double min_share) {
  const size_t rows = shown.shape(0), columns = shown.shape(1);
  Require(enclosed.shape(0) == rows && enclosed.shape(1) == columns, "grids differ in shape");
  const CellGrid grid{int32_t(columns), int32_t(rows), 0, shown.data(), nullptr, nullptr};
  const std::vector<uint8_t> given(enclosed.data(), enclosed.data() + enclosed.size());
  return ToArray(WholePieces(grid, given, min_share), {rows, columns});
}

OutArray<int64_t> CountEnclosingArray(InArray<double, nb::shape<-1, 3, 3>> rotations,
                                      Points3D translations, Doubles focals, Points2D principals,
                                      Steps shapes, Ints labels, Points3D normals, Doubles offsets,
                                      Points3D points, Longs plane_offsets, Ints planes_of_points,
                                      Longs observed_offsets, Ints observed, Points3D directions,
                                      Points2D extents, Points3D sample_points, Ints sample_planes,
                                      Longs sample_offsets, Ints sample_views, Steps steps,
                                      int max_open, double min_share, int num_threads) {
  EnclosureScene scene;
  const size_t num_views = rotations.shape(0), num_planes = offsets.size();
  Require(translations.shape(0) == num_views && focals.size() == num_views &&
              principals.shape(0) == num_views && shapes.shape(0) == num_views,
          "what is known of the views differs in number");
  CheckOffsets(observed_offsets, num_views, observed.size());
  CheckViews(observed, points.shape(0));
  size_t first = 0;
  for (size_t v = 0; v < num_views; ++v) {
    FaceView view;
    view.pose = MakePinholeView(rotations.data() + 9 * v, translations.data() + 3 * v, focals(v));
    view.principal = {principals(v, 0), principals(v, 1)};
    view.rows = shapes(v, 0), view.columns = shapes(v, 1);
    Require(view.rows > 0 && view.columns > 0 && first + view.num_cells() <= labels.size(),
            "labels are missing");
    scene.views.push_back(view), scene.labels.push_back(labels.data() + first);
    first += view.num_cells();
    scene.observed.emplace_back(observed.data() + observed_offsets(v),
                                observed.data() + observed_offsets(v + 1));
  }
  for (size_t i = 0; i < labels.size(); ++i)
    Require(labels(i) < int64_t(num_planes), "labels hold an unknown plane");
  Require(normals.shape(0) == num_planes, "normals and offsets differ in number");
  for (size_t k = 0; k < num_planes; ++k)
    scene.planes.push_back({{normals(k, 0), normals(k, 1), normals(k, 2)}, offsets(k)});
  scene.extents = ToExtents(directions, extents, num_planes);
  for (size_t i = 0; i < points.shape(0); ++i)
    scene.points.points.push_back({points(i, 0), points(i, 1), points(i, 2)});
  CheckOffsets(plane_offsets, points.shape(0), planes_of_points.size());
  CheckViews(planes_of_points, num_planes);
  scene.points.plane_offsets = ToVector(plane_offsets);
  scene.points.planes = {planes_of_points.data(),
                         planes_of_points.data() + planes_of_points.size()};
  const size_t count = sample_points.shape(0);
  Require(sample_planes.size() == count, "samples differ in number");
  CheckOffsets(sample_offsets, count, sample_views.size());
  CheckViews(sample_views, num_views);
  const PlaneSamples samples{sample_points.data(), sample_planes.data(), sample_offsets.data(),
                             sample_views.data(), int64_t(count)};
  std::vector<int64_t> counts;
  {
    nb::gil_scoped_release release;
    counts = CountEnclosing(scene, samples, ToOptions(steps, max_open, min_share), num_threads);
  }
  return ToArray(std::move(counts), {count});
}

}  // namespace

void BindEnclosure(nb::module_& m) {
  m.def("enclosed_cells", &EnclosedCellsArray, "shown"_a, "touched"_a, "inside"_a, "directions"_a,
        "max_open"_a,
        "(h, w) uint8 whether going straight on within a cell's label meets its plane's points.");
  m.def("whole_pieces", &WholePiecesArray, "shown"_a, "enclosed"_a, "min_share"_a,
        "(h, w) uint8 cells that are enclosed, and all of pieces most of whose cells are.");
  m.def("count_enclosing", &CountEnclosingArray, "rotations"_a, "translations"_a, "focals"_a,
        "principals"_a, "shapes"_a, "labels"_a, "normals"_a, "offsets"_a, "points"_a,
        "plane_offsets"_a, "planes_of_points"_a, "observed_offsets"_a, "observed"_a, "directions"_a,
        "extents"_a, "sample_points"_a, "sample_planes"_a, "sample_offsets"_a, "sample_views"_a,
        "steps"_a, "max_open"_a, "min_share"_a, "num_threads"_a,
        "(S,) number of agreeing views that show a sample in an enclosed cell of its plane.");
}

}  // namespace colmap_edges
