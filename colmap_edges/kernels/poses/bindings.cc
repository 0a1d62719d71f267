// Bindings of the adjustment of poses and points.
#include "common/bindings.h"

#include <nanobind/stl/array.h>

#include <array>

#include "common/arrays.h"
#include "poses/adjustment.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;
using Rotations = InArray<double, nb::shape<-1, 3, 3>>;

// The measurements and the point of linearisation; keeps the given arrays alive.
class BoundAdjustment {
 public:
  BoundAdjustment(Longs offsets, Ints views, Points2D pixels, Points2D normals, Points3D tangents,
                  Ints frames, Doubles focals_px, Rotations rotations, Points3D translations,
                  Points3D centers, Points3D points)
      : offsets_(offsets),
        views_(views),
        pixels_(pixels),
        normals_(normals),
        tangents_(tangents),
        frames_(frames),
        focals_(focals_px),
        rotations_(rotations),
        translations_(translations),
        centers_(centers),
        points_(points) {
    const size_t num_points = points.shape(0), num_views = frames.size();
    CheckOffsets(offsets, num_points, views.size());
    CheckViews(views, num_views);
    Require(pixels.shape(0) == views.size() && normals.shape(0) == views.size(),
            "observations differ in number");
    Require(tangents.shape(0) == num_points, "points and tangents differ in number");
    Require(focals_px.size() == num_views && rotations.shape(0) == num_views &&
                translations.shape(0) == num_views,
            "views differ in number");
    for (size_t v = 0; v < num_views; ++v)
      Require(frames(v) >= 0 && size_t(frames(v)) < centers.shape(0), "frame out of range");
    core_.num_points = int64_t(num_points);
    core_.offsets = offsets.data(), core_.views = views.data(), core_.pixels = pixels.data();
    core_.normals = normals.data(), core_.tangents = tangents.data();
    core_.frames = frames.data(), core_.focals_px = focals_px.data();
    core_.rotations = rotations.data(), core_.translations = translations.data();
    core_.centers = centers.data(), core_.points = points.data();
  }

  OutArray<double> Residuals() const {
    std::vector<double> result;
    {
      nb::gil_scoped_release release;
      result = colmap_edges::Residuals(core_);
    }
    return ToArray(std::move(result), {views_.size(), 2});
  }

  nb::tuple Reduce(std::array<double, 2> sigmas_px, double robust_factor, double damping,
                   Longs block_offsets, Ints block_columns) const {
    const size_t count = centers_.shape(0);
    CheckOffsets(block_offsets, count, block_columns.size());
    CheckViews(block_columns, count);
    PoseSystem system;
    system.offsets = block_offsets.data(), system.columns = block_columns.data();
    system.num_frames = int64_t(count);
    {
      nb::gil_scoped_release release;
      ReducePoints(With(sigmas_px, robust_factor), damping, &system);
    }
    return nb::make_tuple(Blocks(std::move(system.information)), Blocks(std::move(system.shared)),
                          Vectors(std::move(system.right)));
  }

  OutArray<double> PointSteps(std::array<double, 2> sigmas_px, double robust_factor, double damping,
                              InArray<double, nb::shape<-1, 6>> steps) const {
    Require(steps.shape(0) == centers_.shape(0), "steps and frames differ in number");
    std::vector<double> result;
    {
      nb::gil_scoped_release release;
      result = colmap_edges::PointSteps(With(sigmas_px, robust_factor), damping, steps.data());
    }
    return ToArray(std::move(result), {size_t(core_.num_points), 3});
  }

 private:
  Adjustment With(const std::array<double, 2>& sigmas_px, double robust_factor) const {
    Adjustment result = core_;
    result.sigmas_px[0] = sigmas_px[0], result.sigmas_px[1] = sigmas_px[1];
    result.robust_factor = robust_factor;
    return result;
  }

  template <typename T>
  static OutArray<double> Owned(std::vector<T>&& values, std::initializer_list<size_t> shape) {
    auto* owned = new std::vector<T>(std::move(values));
    nb::capsule owner(owned, [](void* p) noexcept { delete static_cast<std::vector<T>*>(p); });
    return OutArray<double>(reinterpret_cast<double*>(owned->data()), shape, owner);
  }
  static OutArray<double> Blocks(std::vector<Block>&& values) {
    const size_t count = values.size();
    return Owned(std::move(values), {count, 6, 6});
  }
  static OutArray<double> Vectors(std::vector<Vec6>&& values) {
    const size_t count = values.size();
    return Owned(std::move(values), {count, 6});
  }

  Longs offsets_;
  Ints views_;
  Points2D pixels_, normals_;
  Points3D tangents_;
  Ints frames_;
  Doubles focals_;
  Rotations rotations_;
  Points3D translations_, centers_, points_;
  Adjustment core_;
};

}  // namespace

void BindPoses(nb::module_& m) {
  nb::class_<BoundAdjustment>(
      m, "Adjustment",
      "Measurements of points in views, and the poses and points at which they are linearised.\n\n"
      "Observations are in CSR arrays by point: `views` (N,) int32, undistorted `pixels` (N, 2),\n"
      "`normals` (N, 2) the only measured directions, or 0. Points (P, 3) are fixed along\n"
      "`tangents` (P, 3). Views have `frames` (V,) int32 that rotate about `centers` (F, 3).\n"
      "Raises ValueError for inconsistent arrays.")
      .def(nb::init<Longs, Ints, Points2D, Points2D, Points3D, Ints, Doubles, Rotations, Points3D,
                    Points3D, Points3D>(),
           "offsets"_a, "views"_a, "pixels"_a, "normals"_a, "tangents"_a, "frames"_a, "focals_px"_a,
           "rotations"_a, "translations"_a, "centers"_a, "points"_a)
      .def("residuals", &BoundAdjustment::Residuals,
           "(N, 2) residuals in pixels, infinite behind the view; the second is 0 if only one\n"
           "direction is measured.")
      .def("reduce", &BoundAdjustment::Reduce, "sigmas_px"_a, "robust_factor"_a, "damping"_a,
           "block_offsets"_a, "block_columns"_a,
           "Damped normal equations of the poses, with points eliminated.\n\n"
           "Returns (F, 6, 6) undamped information of each frame for fixed points, (B, 6, 6)\n"
           "blocks to be added for frames that share points, in the order of the CSR arrays, and\n"
           "(F, 6) right side. Raises ValueError for a pair of frames without a block and for an\n"
           "undetermined point.")
      .def("point_steps", &BoundAdjustment::PointSteps, "sigmas_px"_a, "robust_factor"_a,
           "damping"_a, "steps"_a, "(P, 3) steps of the points, given (F, 6) steps of the frames.");
}

}  // namespace colmap_edges
