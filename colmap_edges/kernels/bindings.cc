// Python face of the kernels: converts arrays, releases the GIL, calls the core, converts back.
#include <stdexcept>

#include "arrays.h"
#include "polyline.h"
#include "subpixel.h"

namespace colmap_edges {
namespace {

using Image = InArray<float, nb::ndim<2>>;
using Points2D = InArray<double, nb::shape<-1, 2>>;
using Offsets = InArray<int64_t, nb::ndim<1>>;

nb::tuple RefineSubpixelArrays(Image gradient_x, Image gradient_y, Points2D pixels) {
  if (gradient_x.shape(0) != gradient_y.shape(0) || gradient_x.shape(1) != gradient_y.shape(1)) {
    throw std::invalid_argument("gradient_x and gradient_y differ in shape");
  }
  const size_t count = pixels.shape(0);
  if (count > 0 && gradient_x.size() == 0) throw std::invalid_argument("the image is empty");
  std::vector<double> points(2 * count), normals(2 * count);
  {
    nb::gil_scoped_release release;
    const int64_t height = gradient_x.shape(0), width = gradient_x.shape(1);
    RefineSubpixel({gradient_x.data(), height, width}, {gradient_y.data(), height, width},
                   pixels.data(), count, points.data(), normals.data());
  }
  return nb::make_tuple(ToArray(std::move(points), {count, 2}),
                        ToArray(std::move(normals), {count, 2}));
}

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
    for (size_t p = 0; p + 1 < offsets.size(); ++p) {
      if (offsets(p) < offsets(p + 1)) {
        DouglasPeucker(points.data(), offsets(p), offsets(p + 1) - 1, distance, &kept);
      }
      kept_offsets.push_back(int64_t(kept.size()));
    }
  }
  const size_t num_kept = kept.size(), num_offsets = kept_offsets.size();
  return nb::make_tuple(ToArray(std::move(kept), {num_kept}),
                        ToArray(std::move(kept_offsets), {num_offsets}));
}

}  // namespace
}  // namespace colmap_edges

NB_MODULE(_kernels, m) {
  namespace nb = nanobind;
  using namespace nb::literals;
  m.doc() = "Hot loops of colmap_edges";
  m.def("refine_subpixel", &colmap_edges::RefineSubpixelArrays, "gradient_x"_a, "gradient_y"_a,
        "pixels"_a,
        "(N, 2) pixels moved to the gradient maximum along the normal, and (N, 2) unit normals.");
  m.def("douglas_peucker", &colmap_edges::DouglasPeuckerArrays, "points"_a, "offsets"_a,
        "distance"_a,
        "Indices that Douglas-Peucker keeps of each polyline, and their CSR offsets.");
}
