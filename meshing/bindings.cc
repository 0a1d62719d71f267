// SPDX-License-Identifier: GPL-3.0-or-later
// Python bindings of the mesher: convert arrays, release the GIL, call the core, convert back.
#include <CGAL/version.h>
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/array.h>
#include <nanobind/stl/map.h>
#include <nanobind/stl/string.h>

#include <cstring>

#include "intersections.h"
#include "mesher.h"
#include "refinement.h"
#include "shaping.h"
#include "simplification.h"

namespace nb = nanobind;
using namespace nb::literals;

namespace {

using mesher::Index;

template <typename T, int Columns>
using Matrix = nb::ndarray<const T, nb::shape<-1, Columns>, nb::c_contig, nb::device::cpu>;
template <typename T>
using Vector = nb::ndarray<const T, nb::shape<-1>, nb::c_contig, nb::device::cpu>;

std::vector<mesher::Vec3> ToPoints(const Matrix<double, 3>& array) {
  std::vector<mesher::Vec3> points(array.shape(0));
  for (std::size_t i = 0; i < points.size(); ++i)
    points[i] = {array(i, 0), array(i, 1), array(i, 2)};
  return points;
}

std::vector<Index> ToIndices(const Vector<Index>& values) {
  return {values.data(), values.data() + values.size()};
}

mesher::Rows ToRows(const Vector<std::int64_t>& offsets, const Vector<Index>& values) {
  return {{offsets.data(), offsets.data() + offsets.size()}, ToIndices(values)};
}

// A numpy array that owns a copy of `values`, with `Columns` numbers per item.
template <typename T, std::size_t Columns, typename Item>
nb::ndarray<nb::numpy, T> ToArray(const std::vector<Item>& values) {
  static_assert(sizeof(Item) == Columns * sizeof(T));
  T* data = new T[std::max<std::size_t>(values.size() * Columns, 1)];
  if (!values.empty()) std::memcpy(data, values.data(), values.size() * sizeof(Item));
  nb::capsule owner(data, [](void* p) noexcept { delete[] static_cast<T*>(p); });
  return nb::ndarray<nb::numpy, T>(data, {values.size(), Columns}, owner);
}

nb::tuple MeshPoints(const Matrix<double, 3>& points, const Vector<std::int64_t>& offsets,
                     const Vector<Index>& cameras, const Matrix<double, 3>& centers,
                     const Vector<std::int64_t>& polyline_offsets, const Vector<Index>& polylines,
                     const Vector<Index>& background_cameras,
                     const Matrix<double, 3>& background_directions, const std::string& method,
                     double sigma_factor, double quality_weight, double edge_solid_weight,
                     double background_weight, const std::array<double, 3>& vote_weights,
                     double vote_behind, double vote_threshold, double merge_factor,
                     double min_segment_factor, double long_facet_factor, int min_component_faces,
                     int num_threads) {
  const mesher::MesherInput input{ToPoints(points),
                                  ToRows(offsets, cameras),
                                  ToPoints(centers),
                                  ToRows(polyline_offsets, polylines),
                                  ToIndices(background_cameras),
                                  ToPoints(background_directions)};
  mesher::MesherOptions options;
  options.method = method;
  options.merge_factor = merge_factor;
  options.min_segment_factor = min_segment_factor;
  options.visibility = {sigma_factor, quality_weight, edge_solid_weight, background_weight,
                        num_threads};
  options.votes = {vote_weights, vote_behind, vote_threshold, background_weight, num_threads};
  options.surface = {long_facet_factor, min_component_faces};
  mesher::MesherResult result;
  {
    nb::gil_scoped_release release;
    result = mesher::MeshPoints(input, options);
  }
  return nb::make_tuple(ToArray<double, 3>(result.vertices), ToArray<Index, 3>(result.faces),
                        ToArray<Index, 1>(result.sources), ToArray<Index, 3>(result.edges),
                        result.stats);
}

// The rows of an array as items of the core.
template <typename Item, typename Array>
std::vector<Item> ToItems(const Array& array) {
  static_assert(sizeof(Item) % sizeof(*array.data()) == 0);
  std::vector<Item> items(array.shape(0));
  if (!items.empty()) std::memcpy(items.data(), array.data(), items.size() * sizeof(Item));
  return items;
}

// Keeps what all refinements of a mesh share.
class BoundRefiner {
 public:
  BoundRefiner(const Matrix<double, 3>& vertices, const Matrix<Index, 3>& faces,
               const Matrix<Index, 2>& creases, const Matrix<double, 6>& information,
               int num_threads)
      : core_({ToPoints(vertices), ToItems<std::array<Index, 3>>(faces),
               ToItems<std::array<Index, 2>>(creases), ToItems<mesher::Symmetric>(information)},
              num_threads) {}

  nb::ndarray<nb::numpy, double> Refine(double strength, double angle, int num_rounds) const {
    std::vector<mesher::Vec3> result;
    {
      nb::gil_scoped_release release;
      result = core_.Refine({strength, angle}, num_rounds);
    }
    return ToArray<double, 3>(result);
  }

  nb::ndarray<nb::numpy, double> HeldOutErrors(const Vector<Index>& held_out, double strength,
                                               double angle, int num_rounds) const {
    const std::vector<Index> vertices = ToIndices(held_out);
    std::vector<double> result;
    {
      nb::gil_scoped_release release;
      result = core_.HeldOutErrors(vertices, {strength, angle}, num_rounds);
    }
    return ToArray<double, 1>(result);
  }

 private:
  mesher::Refiner core_;
};

// Vertices, their indices in the given ones, faces and creases.
nb::tuple ToTuple(const mesher::EditedMesh& mesh) {
  return nb::make_tuple(ToArray<double, 3>(mesh.vertices), ToArray<Index, 1>(mesh.sources),
                        ToArray<Index, 3>(mesh.faces), ToArray<Index, 2>(mesh.creases));
}

nb::tuple Shape(const Matrix<double, 3>& vertices, const Matrix<Index, 3>& faces,
                const Matrix<Index, 2>& creases, const Matrix<double, 6>& information,
                double min_angle, double max_sigmas, double max_turn, double turn_sigmas,
                int num_threads) {
  const mesher::RefinementInput input{ToPoints(vertices), ToItems<std::array<Index, 3>>(faces),
                                      ToItems<std::array<Index, 2>>(creases),
                                      ToItems<mesher::Symmetric>(information)};
  mesher::EditedMesh result;
  {
    nb::gil_scoped_release release;
    result = mesher::Shape(input, {min_angle, max_sigmas, max_turn, turn_sigmas}, num_threads);
  }
  return ToTuple(result);
}

nb::tuple Simplify(const Matrix<double, 3>& vertices, const Matrix<Index, 3>& faces,
                   const Matrix<Index, 2>& creases, std::size_t max_faces, int num_threads) {
  const std::vector<mesher::Vec3> points = ToPoints(vertices);
  const auto corners = ToItems<mesher::Face>(faces);
  const auto lines = ToItems<std::array<Index, 2>>(creases);
  mesher::EditedMesh result;
  {
    nb::gil_scoped_release release;
    result = mesher::Simplify(points, corners, lines, max_faces, num_threads);
  }
  return ToTuple(result);
}

// Moved vertices without motions that turn faces over or make them intersect.
nb::ndarray<nb::numpy, double> TakenBack(const Matrix<double, 3>& vertices,
                                         const Matrix<double, 3>& moved,
                                         const Matrix<Index, 3>& faces, int num_threads) {
  const std::vector<mesher::Vec3> before = ToPoints(vertices);
  std::vector<mesher::Vec3> after = ToPoints(moved);
  const auto corners = ToItems<std::array<Index, 3>>(faces);
  if (before.size() != after.size())
    throw std::invalid_argument("vertices and moved ones differ in number");
  mesher::CheckFaces(corners, {}, before.size());
  {
    nb::gil_scoped_release release;
    mesher::TakeBack(corners, before, num_threads, after);
  }
  return ToArray<double, 3>(after);
}

// Pairs of faces that intersect, beyond common vertices and sides.
nb::ndarray<nb::numpy, Index> Intersections(const Matrix<double, 3>& vertices,
                                            const Matrix<Index, 3>& faces, int num_threads) {
  const std::vector<mesher::Vec3> points = ToPoints(vertices);
  const auto corners = ToItems<std::array<Index, 3>>(faces);
  std::vector<std::pair<Index, Index>> pairs;
  {
    nb::gil_scoped_release release;
    pairs = mesher::Intersections(corners, points, num_threads);
  }
  return ToArray<Index, 2>(pairs);
}

}  // namespace

NB_MODULE(_mesher, m) {
  m.doc() = "Delaunay meshing of sparse points with visibility";
  m.attr("cgal_version") = CGAL_VERSION_STR;
  nb::class_<BoundRefiner>(m, "Refiner")
      .def(nb::init<const Matrix<double, 3>&, const Matrix<Index, 3>&, const Matrix<Index, 2>&,
                    const Matrix<double, 6>&, int>(),
           "vertices"_a, "faces"_a, "creases"_a, "information"_a, "num_threads"_a)
      .def("refine", &BoundRefiner::Refine, "strength"_a, "angle"_a, "num_rounds"_a)
      .def("held_out_errors", &BoundRefiner::HeldOutErrors, "held_out"_a, "strength"_a, "angle"_a,
           "num_rounds"_a);
  m.def("shape", &Shape, "vertices"_a, "faces"_a, "creases"_a, "information"_a, nb::kw_only(),
        "min_angle"_a, "max_sigmas"_a, "max_turn"_a, "turn_sigmas"_a, "num_threads"_a);
  m.def("simplify", &Simplify, "vertices"_a, "faces"_a, "creases"_a, "max_faces"_a,
        "num_threads"_a);
  m.def("taken_back", &TakenBack, "vertices"_a, "moved"_a, "faces"_a, "num_threads"_a);
  m.def("intersections", &Intersections, "vertices"_a, "faces"_a, "num_threads"_a);
  m.def("mesh_points", &MeshPoints, "points"_a, "visibility_offsets"_a, "visibility_cameras"_a,
        "camera_centers"_a, "polyline_offsets"_a, "polylines"_a, "background_cameras"_a,
        "background_directions"_a, nb::kw_only(), "method"_a, "sigma_factor"_a, "quality_weight"_a,
        "edge_solid_weight"_a, "background_weight"_a, "vote_weights"_a, "vote_behind"_a,
        "vote_threshold"_a, "merge_factor"_a, "min_segment_factor"_a, "long_facet_factor"_a,
        "min_component_faces"_a, "num_threads"_a);
}
