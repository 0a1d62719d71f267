// Bindings of the processing of one image: sub-pixel positions, side intensities and colours of
// edge points, corners and junctions of chains.
#include "common/bindings.h"

#include <algorithm>

#include "common/arrays.h"
#include "image/corners.h"
#include "image/displacement.h"
#include "image/junctions.h"
#include "image/pixel_chains.h"
#include "image/subpixel.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;
using GrayImage = InArray<float, nb::ndim<2>>;

void CheckImage(size_t size, size_t num_points) {
  if (num_points > 0 && size == 0) throw std::invalid_argument("the image is empty");
}

void CheckNormals(const Points2D& points, const Points2D& normals) {
  if (normals.shape(0) != points.shape(0)) {
    throw std::invalid_argument("points and normals differ in number");
  }
}

Image ToImage(const GrayImage& image) {
  return {image.data(), int64_t(image.shape(1)), int64_t(image.shape(0))};
}

nb::tuple RefineSubpixelArrays(GrayImage image, Points2D pixels) {
  const size_t count = pixels.shape(0);
  CheckImage(image.size(), count);
  std::vector<double> points(2 * count), normals(2 * count);
  {
    nb::gil_scoped_release release;
    RefineSubpixel(ToImage(image), pixels.data(), count, points.data(), normals.data());
  }
  return nb::make_tuple(ToArray(std::move(points), {count, 2}),
                        ToArray(std::move(normals), {count, 2}));
}

OutArray<double> UndoDisplacementArrays(GrayImage image, Points2D points, Points2D normals,
                                        double blur) {
  const size_t count = points.shape(0);
  CheckImage(image.size(), count);
  CheckNormals(points, normals);
  if (!(blur > 0)) throw std::invalid_argument("the blur must be greater than 0");
  std::vector<double> moved(2 * count);
  {
    nb::gil_scoped_release release;
    UndoDisplacement(ToImage(image), blur, points.data(), normals.data(), count, moved.data());
  }
  return ToArray(std::move(moved), {count, 2});
}

OutArray<uint8_t> SampleSidesArrays(GrayImage image, Points2D points, Points2D normals,
                                    double distance, InArray<uint8_t, nb::ndim<1>> table) {
  const size_t count = points.shape(0);
  CheckImage(image.size(), count);
  CheckNormals(points, normals);
  if (table.size() == 0) throw std::invalid_argument("the table is empty");
  std::vector<uint8_t> sides(2 * count);
  {
    nb::gil_scoped_release release;
    const Image values = ToImage(image);
    const double steps = double(table.size() - 1);
    for (size_t i = 0; i < count; ++i) {
      const Vec2 point = {points(i, 0), points(i, 1)}, normal = {normals(i, 0), normals(i, 1)};
      for (int side = 0; side < 2; ++side) {
        const double away = side == 0 ? -distance : distance;
        const double value = std::clamp(values.At(point + away * normal), 0.0, 1.0);
        sides[2 * i + side] = table(size_t(value * steps + 0.5));
      }
    }
  }
  return ToArray(std::move(sides), {count, 2});
}

using Colors = InArray<uint8_t, nb::shape<-1, -1, 3>>;

OutArray<double> BilinearArrays(Colors image, Points2D points) {
  const size_t count = points.shape(0);
  CheckImage(image.size(), count);
  std::vector<double> values(3 * count);
  {
    nb::gil_scoped_release release;
    const int64_t height = image.shape(0), width = image.shape(1);
    for (size_t i = 0; i < count; ++i) {
      const PixelCell cell(width, height, points(i, 0), points(i, 1));
      for (int c = 0; c < 3; ++c) values[3 * i + c] = cell.In(image.data() + c, 3);
    }
  }
  return ToArray(std::move(values), {count, 3});
}

nb::tuple FindCornersArrays(Points2D points, Longs offsets, Bools closed, int64_t rounded,
                            int64_t arm, double bent_cosine, double max_cosine, double max_scatter,
                            double slack, double max_radius, double max_cut) {
  CheckOffsets(offsets, points.shape(0));
  if (closed.size() + 1 != offsets.size()) {
    throw std::invalid_argument("closed and offsets are not of as many chains");
  }
  if (rounded < 1 || arm < 2) throw std::invalid_argument("rounded or arm is too short");
  const CornerLimits limits = {rounded,     arm,   bent_cosine, max_cosine,
                               max_scatter, slack, max_radius,  max_cut};
  std::vector<Corner> corners;
  {
    nb::gil_scoped_release release;
    for (size_t c = 0; c < closed.size(); ++c) {
      const int64_t length = offsets(c + 1) - offsets(c);
      FindCorners({points.data(), offsets(c), length, closed(c)}, limits, &corners);
    }
  }
  const size_t count = corners.size();
  std::vector<int64_t> indices(count);
  std::vector<double> crossings(2 * count);
  for (size_t i = 0; i < count; ++i) {
    indices[i] = corners[i].point;
    crossings[2 * i] = corners[i].crossing.x, crossings[2 * i + 1] = corners[i].crossing.y;
  }
  return nb::make_tuple(ToArray(std::move(indices), {count}),
                        ToArray(std::move(crossings), {count, 2}));
}

OutArray<int32_t> TouchedChainsArrays(Points2D points, Longs offsets, int64_t width,
                                      int64_t height) {
  CheckOffsets(offsets, points.shape(0));
  if (width < 1 || height < 1) throw std::invalid_argument("the image is empty");
  std::vector<int32_t> touched;
  {
    nb::gil_scoped_release release;
    const auto point = [&](int64_t i) { return Vec2{points(i, 0), points(i, 1)}; };
    touched =
        TouchedChains(point, {offsets.data(), offsets.data() + offsets.size()}, width, height);
  }
  const size_t count = touched.size();
  return ToArray(std::move(touched), {count});
}

nb::tuple LinkPixelsArrays(InArray<uint8_t, nb::ndim<2>> map, int64_t reach) {
  if (reach < 1) throw std::invalid_argument("reach is less than a pixel");
  std::vector<double> places;
  std::vector<int64_t> offsets;
  {
    nb::gil_scoped_release release;
    LinkPixels(map.data(), map.shape(1), map.shape(0), int(reach), &places, &offsets);
  }
  const size_t count = places.size() / 2, num_offsets = offsets.size();
  return nb::make_tuple(ToArray(std::move(places), {count, 2}),
                        ToArray(std::move(offsets), {num_offsets}));
}

}  // namespace

void BindImage(nb::module_& m) {
  m.def(
      "find_corners", &FindCornersArrays, "points"_a, "offsets"_a, "closed"_a, "rounded"_a, "arm"_a,
      "bent_cosine"_a, "max_cosine"_a, "max_scatter"_a, "slack"_a, "max_radius"_a, "max_cut"_a,
      "(K,) points of chains at corners, ascending, and (K, 2) intersections of the lines there.");
  m.def("touched_chains", &TouchedChainsArrays, "points"_a, "offsets"_a, "width"_a, "height"_a,
        "(2C,) another chain whose inner points each end touches, or -1.");
  m.def("link_pixels", &LinkPixelsArrays, "map"_a, "reach"_a,
        "(N, 2) pixels (x, y) of a thinned edge image, linked to chains, and their (C + 1,) "
        "offsets.");
  m.def("refine_subpixel", &RefineSubpixelArrays, "image"_a, "pixels"_a,
        "(N, 2) pixels moved along the gradient to the maximum of its magnitude, and (N, 2) unit "
        "gradient directions.");
  m.def("undo_displacement", &UndoDisplacementArrays, "image"_a, "points"_a, "normals"_a, "blur"_a,
        "(N, 2) edge points moved along their normals to undo the displacement of neighbouring "
        "edges by blur.");
  m.def("sample_sides", &SampleSidesArrays, "image"_a, "points"_a, "normals"_a, "distance"_a,
        "table"_a,
        "(N, 2) values of an image, 0 to 1, mapped by a table, at a distance against and along the "
        "normals.");
  m.def("bilinear", &BilinearArrays, "image"_a, "points"_a,
        "(N, 3) values of an image at points; its first pixel is centred at (0, 0).");
}

}  // namespace colmap_edges
