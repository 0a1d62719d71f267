// Bindings of faint lines on planes.
#include "common/arrays.h"
#include "common/bindings.h"
#include "faces/faint_lines.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;

nb::tuple MarksOfArrays(Rotation rotation, Translation translation, double focal_px,
                        InArray<double, nb::shape<2>> principal,
                        InArray<double, nb::ndim<2>> smooth, InArray<int32_t, nb::ndim<2>> labels,
                        Points3D normals, Doubles offsets, double min_slope) {
  Require(smooth.shape(0) == labels.shape(0) * FaceView::kCellPx &&
              smooth.shape(1) == labels.shape(1) * FaceView::kCellPx,
          "pictures must be of whole cells");
  Require(normals.shape(0) == offsets.size(), "normals and offsets differ in number");
  std::vector<Plane> planes;
  for (size_t k = 0; k < offsets.size(); ++k)
    planes.push_back({{normals(k, 0), normals(k, 1), normals(k, 2)}, offsets(k)});
  for (size_t i = 0; i < labels.size(); ++i)
    Require(labels.data()[i] < int64_t(planes.size()), "labels hold a plane that does not exist");
  FaceView view;
  view.pose = MakePinholeView(rotation.data(), translation.data(), focal_px);
  view.principal = {principal(0), principal(1)};
  view.rows = int32_t(labels.shape(0)), view.columns = int32_t(labels.shape(1));
  std::vector<double> points, directions, sizes;
  std::vector<int64_t> on;
  {
    nb::gil_scoped_release release;
    for (const Mark& mark : MarksOf(view, smooth.data(), labels.data(), planes, min_slope)) {
      points.insert(points.end(), {mark.point.x, mark.point.y, mark.point.z});
      directions.insert(directions.end(), {mark.direction.x, mark.direction.y, mark.direction.z});
      sizes.push_back(mark.size), on.push_back(mark.plane);
    }
  }
  const size_t count = sizes.size();
  return nb::make_tuple(ToArray(std::move(points), {count, 3}),
                        ToArray(std::move(directions), {count, 3}),
                        ToArray(std::move(sizes), {count}), ToArray(std::move(on), {count}));
}

nb::tuple FaintLinesArrays(Points2D at, Points2D along, Longs views, double size, int num_angles,
                           double width, int64_t max_places, double max_turn, Longs least,
                           double step, int64_t max_tried) {
  const size_t count = at.shape(0);
  Require(along.shape(0) == count && views.size() == count, "marks differ in number");
  Require(count > 0 && size > 0 && num_angles > 0 && width > 0 && step > 0, "sizes must not be 0");
  Require(least.size() == 3, "minimum numbers are of marks, views and steps");
  const FaintLineOptions options{num_angles, width,    max_places, max_turn, least(0),
                                 least(1),   least(2), step,       max_tried};
  std::vector<int64_t> offsets{0}, marks, steps;
  {
    nb::gil_scoped_release release;
    const FlatMarks flat{at.data(), along.data(), views.data(), int64_t(count), size};
    for (const FaintLine& line : FaintLines(flat, options).Run()) {
      marks.insert(marks.end(), line.marks.begin(), line.marks.end());
      steps.insert(steps.end(), line.steps.begin(), line.steps.end());
      offsets.push_back(int64_t(marks.size()));
    }
  }
  const size_t size_of_offsets = offsets.size(), total = marks.size();
  return nb::make_tuple(ToArray(std::move(offsets), {size_of_offsets}),
                        ToArray(std::move(marks), {total}), ToArray(std::move(steps), {total}));
}

}  // namespace

void BindFaintLines(nb::module_& m) {
  m.def("marks_of", &MarksOfArrays, "rotation"_a, "translation"_a, "focal_px"_a, "principal"_a,
        "smooth"_a, "labels"_a, "normals"_a, "offsets"_a, "min_slope"_a,
        "Points, directions, sizes and planes of the changes of gray that a view sees on planes.");
  m.def("faint_lines", &FaintLinesArrays, "at"_a, "along"_a, "views"_a, "size"_a, "num_angles"_a,
        "width"_a, "max_places"_a, "max_turn"_a, "least"_a, "step"_a, "max_tried"_a,
        "Offsets of lines on a plane, the marks on each and their stretches.");
}

}  // namespace colmap_edges
