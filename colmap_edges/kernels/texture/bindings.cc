// Bindings of the kernels for textures.
#include "common/bindings.h"

#include "common/arrays.h"
#include "texture/raster.h"
#include "texture/view_labels.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;

using Corners = InArray<int32_t, nb::shape<-1, 3>>;

SeenMesh MeshOf(const Points2D& pixels, const Doubles& inverses, const Corners& faces) {
  Require(inverses.size() == pixels.shape(0), "pixels and inverse depths differ in number");
  for (size_t i = 0; i < faces.size(); ++i)
    Require(faces.data()[i] >= 0 && faces.data()[i] < int64_t(pixels.shape(0)),
            "faces hold a vertex that does not exist");
  return {pixels.data(), inverses.data(), faces.data(), int64_t(faces.shape(0))};
}

OutArray<float> DepthsArray(Points2D pixels, Doubles inverses, Corners faces, int rows,
                            int columns) {
  const SeenMesh mesh = MeshOf(pixels, inverses, faces);
  Require(rows > 0 && columns > 0, "pictures must have pixels");
  std::vector<float> nearest(size_t(rows) * columns);
  {
    nb::gil_scoped_release release;
    DrawDepths(mesh, rows, columns, nearest.data());
  }
  return ToArray(std::move(nearest), {size_t(rows), size_t(columns)});
}

using Floats2D = InArray<float, nb::ndim<2>>;

nb::tuple TallyArrays(Points2D pixels, Doubles inverses, Corners faces, Floats2D nearest,
                      Floats2D around, InArray<float, nb::shape<-1, -1, Tally::kChannels>> picture,
                      InArray<uint8_t, nb::ndim<2>> usable, double tolerance, double reach) {
  const SeenMesh mesh = MeshOf(pixels, inverses, faces);
  const size_t rows = nearest.shape(0), columns = nearest.shape(1), count = faces.shape(0);
  const auto fits = [&](const auto& each) {
    return each.shape(0) == rows && each.shape(1) == columns;
  };
  Require(fits(around) && fits(picture) && fits(usable), "pictures differ in size");
  Require(rows > 0 && columns > 0, "pictures must have pixels");
  const ViewPicture view{int(rows),      int(columns),  nearest.data(), around.data(),
                         picture.data(), usable.data(), tolerance,      reach};
  Tally tally(0);
  {
    nb::gil_scoped_release release;
    tally = TallyOf(mesh, view);
  }
  return nb::make_tuple(ToArray(std::move(tally.areas), {count}),
                        ToArray(std::move(tally.shares), {count, 2}),
                        ToArray(std::move(tally.means), {count, Tally::kChannels}));
}

void AddColorsArrays(InArray<double, nb::shape<-1, 3, 2>> corners,
                     InArray<float, nb::shape<-1, 3, 3>> colors, double margin,
                     nb::ndarray<uint8_t, nb::shape<-1, -1, 3>, nb::c_contig> picture,
                     nb::ndarray<uint8_t, nb::ndim<2>, nb::c_contig> covered) {
  Require(corners.shape(0) == colors.shape(0), "corners and colours differ in number");
  Require(picture.shape(0) == covered.shape(0) && picture.shape(1) == covered.shape(1),
          "pictures differ in size");
  nb::gil_scoped_release release;
  AddColors(corners.data(), colors.data(), int64_t(corners.shape(0)), int(picture.shape(0)),
            int(picture.shape(1)), margin, picture.data(), covered.data());
}

nb::tuple PixelsArrays(InArray<double, nb::shape<-1, 3, 2>> corners, int rows, int columns,
                       double margin) {
  std::vector<int64_t> places;
  std::vector<int32_t> owners;
  std::vector<double> all;
  {
    nb::gil_scoped_release release;
    for (size_t face = 0; face < corners.shape(0); ++face) {
      std::array<Corner, 3> at;
      for (int k = 0; k < 3; ++k) at[k] = {corners(face, k, 0), corners(face, k, 1)};
      ForPixels(at, rows, columns, margin, [&](int row, int column, const auto& weights) {
        places.push_back(int64_t(row) * columns + column), owners.push_back(int32_t(face));
        all.insert(all.end(), weights.begin(), weights.end());
      });
    }
  }
  const size_t count = places.size();
  return nb::make_tuple(ToArray(std::move(places), {count}), ToArray(std::move(owners), {count}),
                        ToArray(std::move(all), {count, 3}));
}

OutArray<int32_t> LabelsArray(Longs offsets, Ints labels, Doubles costs,
                              InArray<int32_t, nb::shape<-1, 2>> pairs, double weight,
                              int num_sweeps) {
  CheckOffsets(offsets, labels.size());
  Require(costs.size() == labels.size(), "labels and costs differ in number");
  const int64_t num_nodes = int64_t(offsets.size()) - 1;
  for (size_t i = 0; i < pairs.size(); ++i)
    Require(pairs.data()[i] >= 0 && pairs.data()[i] < num_nodes, "pairs hold an unknown node");
  std::vector<int32_t> chosen;
  {
    nb::gil_scoped_release release;
    const LabelCandidates given{offsets.data(), labels.data(), costs.data(),
                                num_nodes,      pairs.data(),  int64_t(pairs.shape(0))};
    chosen = ViewLabelling(given, weight).Run(num_sweeps);
  }
  return ToArray(std::move(chosen), {size_t(num_nodes)});
}

}  // namespace

void BindTexture(nb::module_& m) {
  m.def("draw_depths", &DepthsArray, "pixels"_a, "inverses"_a, "faces"_a, "rows"_a, "columns"_a,
        "Inverse depths of the nearest triangle at each pixel; 0 without one.");
  m.def("tally_faces", &TallyArrays, "pixels"_a, "inverses"_a, "faces"_a, "nearest"_a, "around"_a,
        "picture"_a, "usable"_a, "tolerance"_a, "reach"_a,
        "Areas of triangles in a picture, visible shares, and means of the picture's channels.");
  m.def("add_colors", &AddColorsArrays, "corners"_a, "colors"_a, "margin"_a, "picture"_a,
        "covered"_a, "Adds linear colours over triangles to a picture, and marks covered pixels.");
  m.def("pixels_of_triangles", &PixelsArrays, "corners"_a, "rows"_a, "columns"_a, "margin"_a,
        "Flat indices of the pixels in triangles, their triangles and barycentric coordinates.");
  m.def("label_views", &LabelsArray, "offsets"_a, "labels"_a, "costs"_a, "pairs"_a, "weight"_a,
        "num_sweeps"_a, "Index of the candidate of each node, -1 without candidates.");
}

}  // namespace colmap_edges
