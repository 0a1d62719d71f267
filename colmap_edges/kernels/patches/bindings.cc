// Bindings of the search of patches and of their agreement.
#include "common/bindings.h"

#include <nanobind/stl/vector.h>

#include "common/arrays.h"
#include "common/parallel.h"
#include "patches/agreement.h"
#include "patches/mesh_depths.h"
#include "patches/search.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;

using Picture8 = InArray<uint8_t, nb::ndim<2>>;
using Hypotheses = InArray<float, nb::shape<-1, -1, -1, 3>>;

// The views and what was found in them, between calls.
class PatchScene {
 public:
  PatchScene(InArray<double, nb::shape<-1, 3, 3>> rotations, Points3D translations, Doubles focals,
             Points2D principals, std::vector<Picture8> grays, Longs neighbor_offsets,
             Ints neighbors, int step)
      : grays_(std::move(grays)), step_(step) {
    const size_t count = focals.size();
    Require(rotations.shape(0) == count && translations.shape(0) == count &&
                principals.shape(0) == count && grays_.size() == count,
            "views differ in number");
    CheckOffsets(neighbor_offsets, count, neighbors.size());
    CheckViews(neighbors, count);
    Require(step > 0, "the step must not be 0");
    for (size_t v = 0; v < count; ++v) {
      PatchView view;
      view.pose = MakePinholeView(rotations.data() + 9 * v, translations.data() + 3 * v, focals(v));
      view.principal = {principals(v, 0), principals(v, 1)};
      view.height = int32_t(grays_[v].shape(0)), view.width = int32_t(grays_[v].shape(1));
      Require(std::min(view.height, view.width) >= kWindowSide, "pictures must hold a window");
      view.gray = grays_[v].data();
      views_.push_back(view);
      neighbors_.emplace_back(neighbors.data() + neighbor_offsets(v),
                              neighbors.data() + neighbor_offsets(v + 1));
      Require(neighbors_.back().size() <= 32, "a view may have 32 neighbours");
      PatchSites sites;
      sites.rows = (view.height - kWindowSide) / step + 1;
      sites.columns = (view.width - kWindowSide) / step + 1;
      sites_.push_back(sites);
    }
    patches_.resize(count);
  }

  // Searches the patches of a view; returns how many there are. Several threads may search, each
  // in a view of its own.
  int64_t Search(int v, Picture8 active, Hypotheses hypotheses, double low, double high,
                 double flat, double min_cosine, int num_sweeps, double believed, uint64_t seed) {
    Require(v >= 0 && size_t(v) < views_.size(), "view index out of range");
    PatchSites sites = sites_[v];
    Require(int(active.shape(0)) == sites.rows && int(active.shape(1)) == sites.columns &&
                int(hypotheses.shape(0)) == sites.rows && int(hypotheses.shape(1)) == sites.columns,
            "sites differ from those of the pictures");
    sites.active = active.data(), sites.hypotheses = hypotheses.data();
    sites.num_hypotheses = int(hypotheses.shape(2)), sites.low = low, sites.high = high;
    const PatchOptions options{step_, flat, min_cosine, num_sweeps, believed};
    nb::gil_scoped_release release;
    patches_[v] = PatchSearch(views_, v, neighbors_[v], sites, options, seed).Run();
    return CountFound(v);
  }

  // Patches of a view, a row each: x, y, inverse depth, slopes, standard deviation, pixel, score.
  OutArray<double> Found(int v) const {
    Require(v >= 0 && size_t(v) < views_.size(), "view index out of range");
    std::vector<double> rows;
    for (size_t i = 0; i < patches_[v].size(); ++i) {
      const FoundPatch& patch = patches_[v][i];
      if (!(patch.unit > 0)) continue;
      const double x = kWindowRadius + double(i % sites_[v].columns) * step_,
                   y = kWindowRadius + double(i / sites_[v].columns) * step_;
      rows.insert(rows.end(), {x, y, patch.plane.inverse, patch.plane.slope_x, patch.plane.slope_y,
                               patch.sigma, patch.unit, patch.score});
    }
    const size_t count = rows.size() / 8;
    return ToArray(std::move(rows), {count, 8});
  }

  // Patches with what other views say of them: rows of integers (view, row and column of the site,
  // whether no other view sees it better, views that see through it), of numbers (x, y, inverse
  // depth, slopes, standard deviation, pixel), offsets and agreeing views.
  nb::tuple Agreed(Longs other_offsets, Ints others, double max_off_px, int num_threads) const {
    CheckOffsets(other_offsets, views_.size(), others.size());
    CheckViews(others, views_.size());
    const AgreementOptions options{step_, max_off_px};
    std::vector<std::vector<AgreedPatch>> agreed(views_.size());
    std::vector<int32_t> rows, views;
    std::vector<double> values;
    std::vector<int64_t> offsets{0};
    {
      nb::gil_scoped_release release;
      const Agreement agreement(views_, sites_, patches_, options);
      ParallelFor(int64_t(views_.size()), num_threads, [&](int64_t v, int) {
        agreed[v].reserve(CountFound(int(v)));
        const std::vector<int> around(others.data() + other_offsets(v),
                                      others.data() + other_offsets(v + 1));
        for (size_t i = 0; i < patches_[v].size(); ++i)
          if (patches_[v][i].unit > 0) agreed[v].push_back(agreement.Of(int(v), int(i), around));
      });
      size_t total = 0;
      for (const auto& of : agreed) total += of.size();
      rows.reserve(5 * total), values.reserve(7 * total), offsets.reserve(total + 1);
      for (size_t v = 0; v < views_.size(); ++v) {
        size_t at = 0;
        for (size_t i = 0; i < patches_[v].size(); ++i) {
          const FoundPatch& patch = patches_[v][i];
          if (!(patch.unit > 0)) continue;
          const AgreedPatch& of = agreed[v][at++];
          const int columns = sites_[v].columns;
          const Vec2 pixel = agreement.PixelOf(int(v), int(i));
          rows.insert(rows.end(), {int32_t(v), int32_t(i) / columns, int32_t(i) % columns,
                                   of.is_best, of.through});
          values.insert(values.end(), {pixel.x, pixel.y, of.inverse, patch.plane.slope_x,
                                       patch.plane.slope_y, of.sigma, patch.unit});
          views.insert(views.end(), of.views.begin(), of.views.end());
          offsets.push_back(int64_t(views.size()));
        }
        agreed[v] = {};
      }
    }
    const size_t count = offsets.size() - 1, total = views.size();
    return nb::make_tuple(
        ToArray(std::move(rows), {count, 5}), ToArray(std::move(values), {count, 7}),
        ToArray(std::move(offsets), {count + 1}), ToArray(std::move(views), {total}));
  }

  // Correlation of windows of a view with a neighbour: sites (x, y), planes (inverse, slopes).
  OutArray<double> Correlations(int view, int other, InArray<int32_t, nb::shape<-1, 2>> pixels,
                                Points3D planes, double flat) const {
    Require(pixels.shape(0) == planes.shape(0), "pixels and planes differ in number");
    Require(
        view >= 0 && other >= 0 && size_t(view) < views_.size() && size_t(other) < views_.size(),
        "view index out of range");
    const PatchView& from = views_[view];
    const RelativeView relative(from, views_[other]);
    std::vector<double> found;
    for (size_t i = 0; i < pixels.shape(0); ++i) {
      const int x = pixels(i, 0), y = pixels(i, 1);
      Require(x >= kWindowRadius && y >= kWindowRadius && x < from.width - kWindowRadius &&
                  y < from.height - kWindowRadius,
              "windows must lie in the picture");
      WindowPlaces<kWindowCount> places;
      const PatchPlane plane{planes(i, 0), planes(i, 1), planes(i, 2)};
      found.push_back(places.Set(relative, x, y, plane, views_[other])
                          ? Window(from, x, y).Correlation(places, views_[other], float(flat))
                          : -1);
    }
    const size_t count = found.size();
    return ToArray(std::move(found), {count});
  }

 private:
  int64_t CountFound(int v) const {
    return std::count_if(patches_[v].begin(), patches_[v].end(),
                         [](const FoundPatch& patch) { return patch.unit > 0; });
  }

  std::vector<Picture8> grays_;
  int step_;
  std::vector<PatchView> views_;
  std::vector<std::vector<int>> neighbors_;
  std::vector<PatchSites> sites_;
  std::vector<std::vector<FoundPatch>> patches_;
};

// Inverse depths of a mesh along rays (x, y, 1) of all views, in rows by view, and the faces there;
// 0 and -1 where there is none.
nb::tuple MeshDepthsAt(InArray<double, nb::shape<-1, 3, 3>> rotations, Points3D translations,
                       Points3D vertices, InArray<int32_t, nb::shape<-1, 3>> faces, Longs offsets,
                       Points2D rays, int num_threads) {
  const size_t count = rotations.shape(0), total = rays.shape(0);
  Require(translations.shape(0) == count, "views differ in number");
  CheckOffsets(offsets, count, total);
  for (size_t i = 0; i < faces.size(); ++i)
    Require(faces.data()[i] >= 0 && size_t(faces.data()[i]) < vertices.shape(0),
            "a face has a vertex that does not exist");
  std::vector<double> found(total);
  std::vector<int32_t> hit(total);
  {
    nb::gil_scoped_release release;
    ParallelFor(int64_t(count), num_threads, [&](int64_t v, int) {
      std::vector<Vec2> at;
      for (int64_t i = offsets(v); i < offsets(v + 1); ++i) at.push_back({rays(i, 0), rays(i, 1)});
      if (at.empty()) return;
      const PinholeView view =
          MakePinholeView(rotations.data() + 9 * v, translations.data() + 3 * v, 1);
      std::vector<Vec3> local(vertices.shape(0));
      for (size_t i = 0; i < local.size(); ++i)
        local[i] = view.FromWorld({vertices(i, 0), vertices(i, 1), vertices(i, 2)});
      MeshDepths depths(at);
      depths.Add(local, faces.data(), faces.shape(0));
      std::copy(depths.inverse().begin(), depths.inverse().end(), found.begin() + offsets(v));
      std::copy(depths.faces().begin(), depths.faces().end(), hit.begin() + offsets(v));
    });
  }
  return nb::make_tuple(ToArray(std::move(found), {total}), ToArray(std::move(hit), {total}));
}

}  // namespace

void BindPatches(nb::module_& m) {
  nb::class_<PatchScene>(m, "PatchScene")
      .def(nb::init<InArray<double, nb::shape<-1, 3, 3>>, Points3D, Doubles, Points2D,
                    std::vector<Picture8>, Longs, Ints, int>(),
           "rotations"_a, "translations"_a, "focals"_a, "principals"_a, "grays"_a,
           "neighbor_offsets"_a, "neighbors"_a, "step"_a)
      .def("search", &PatchScene::Search, "view"_a, "active"_a, "hypotheses"_a, "low"_a, "high"_a,
           "flat"_a, "min_cosine"_a, "num_sweeps"_a, "believed"_a, "seed"_a)
      .def("found", &PatchScene::Found, "view"_a)
      .def("agreed", &PatchScene::Agreed, "other_offsets"_a, "others"_a, "max_off_px"_a,
           "num_threads"_a)
      .def("correlations", &PatchScene::Correlations, "view"_a, "other"_a, "pixels"_a, "planes"_a,
           "flat"_a);
  m.def(
      "mesh_depths", &MeshDepthsAt, "rotations"_a, "translations"_a, "vertices"_a, "faces"_a,
      "offsets"_a, "rays"_a, "num_threads"_a,
      "Inverse depths of a mesh along rays of views, and the faces; 0 and -1 where there is none.");
}

}  // namespace colmap_edges
