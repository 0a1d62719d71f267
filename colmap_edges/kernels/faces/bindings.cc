// Python face of what finds planar faces: support of planes, labels of views, graph cuts.
#include "common/bindings.h"

#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/arrays.h"
#include "common/parallel.h"
#include "faces/enclosure.h"
#include "faces/labelling.h"

namespace colmap_edges {
namespace {

using namespace nb::literals;
using Pairs = InArray<int32_t, nb::shape<-1, 2>>;
using Table = InArray<float, nb::ndim<2>>;
using Bytes = InArray<uint8_t, nb::ndim<1>>;
using Bytes2D = InArray<uint8_t, nb::ndim<2>>;
using Labels2D = InArray<int32_t, nb::ndim<2>>;

std::vector<NodePair> ToPairs(const Pairs& edges, int64_t num_nodes) {
  std::vector<NodePair> pairs(edges.shape(0));
  for (size_t e = 0; e < pairs.size(); ++e) {
    pairs[e] = {edges(e, 0), edges(e, 1)};
    for (const int32_t node : pairs[e])
      Require(node >= 0 && node < num_nodes, "edges hold a node that does not exist");
  }
  return pairs;
}

nb::tuple MinimumCutArrays(Longs terminals, Pairs edges, Longs along, Longs against) {
  const size_t count = terminals.size();
  const std::vector<NodePair> pairs = ToPairs(edges, int64_t(count));
  Require(along.size() == pairs.size() && against.size() == pairs.size(),
          "edges and capacities differ in number");
  std::vector<uint8_t> sides(count);
  int64_t flow;
  {
    nb::gil_scoped_release release;
    MaxFlow solver(int32_t(count), pairs);
    std::vector<int32_t> nodes(count);
    std::iota(nodes.begin(), nodes.end(), 0);
    for (const int32_t i : nodes) solver.SetTerminal(i, terminals(i));
    for (size_t e = 0; e < pairs.size(); ++e) {
      Require(along(e) >= 0 && against(e) >= 0, "capacities must not be negative");
      solver.SetEdge(int64_t(e), along(e), against(e));
    }
    flow = solver.Solve(nodes);
    for (size_t i = 0; i < count; ++i) sides[i] = solver.IsSource(int32_t(i));
  }
  return nb::make_tuple(flow, ToArray(std::move(sides), {count}));
}

LabelProblem ToProblem(const Table& costs, const Table& depths, const Pairs& edges,
                       const Doubles& weights, double crossing_factor) {
  LabelProblem problem;
  problem.num_nodes = int32_t(costs.shape(0)), problem.num_labels = int32_t(costs.shape(1));
  Require(problem.num_labels > 0, "there are no labels");
  Require(depths.shape(0) == costs.shape(0) && depths.shape(1) == costs.shape(1),
          "costs and depths differ in shape");
  problem.edges = ToPairs(edges, problem.num_nodes);
  Require(weights.size() == problem.edges.size(), "edges and weights differ in number");
  problem.costs = {costs.data(), costs.data() + costs.size()};
  problem.depths = {depths.data(), depths.data() + depths.size()};
  problem.weights = {weights.data(), weights.data() + weights.size()};
  problem.crossing_factor = crossing_factor;
  return problem;
}

nb::tuple ToArrays(LabelProblem problem) {
  const size_t num_nodes = problem.num_nodes, num_labels = problem.num_labels;
  const size_t num_edges = problem.edges.size();
  std::vector<int32_t> ends;
  for (const NodePair& pair : problem.edges) ends.insert(ends.end(), pair.begin(), pair.end());
  return nb::make_tuple(ToArray(std::move(problem.costs), {num_nodes, num_labels}),
                        ToArray(std::move(problem.depths), {num_nodes, num_labels}),
                        ToArray(std::move(ends), {num_edges, 2}),
                        ToArray(std::move(problem.weights), {num_edges}));
}

nb::tuple ExpandLabelsArrays(Table costs, Table depths, Pairs edges, Doubles weights,
                             double crossing_factor, int max_sweeps) {
  const LabelProblem problem = ToProblem(costs, depths, edges, weights, crossing_factor);
  std::vector<int32_t> labels;
  double energy;
  {
    nb::gil_scoped_release release;
    labels = Expansion(problem).Run(max_sweeps);
    energy = problem.Energy(labels);
  }
  const size_t count = labels.size();
  return nb::make_tuple(ToArray(std::move(labels), {count}), energy);
}

std::vector<int32_t> ToInts(const Ints& values) {
  return {values.data(), values.data() + values.size()};
}

nb::tuple ContractedArrays(Table costs, Table depths, Pairs edges, Doubles weights, Ints blocks,
                           int num_blocks) {
  const LabelProblem problem = ToProblem(costs, depths, edges, weights, 1);
  Require(blocks.size() == costs.shape(0), "blocks and nodes differ in number");
  CheckViews(blocks, size_t(num_blocks));
  return ToArrays(Contracted(problem, ToInts(blocks), num_blocks));
}

nb::tuple RestrictedArrays(Table costs, Table depths, Pairs edges, Doubles weights, Ints nodes,
                           Ints labels) {
  const LabelProblem problem = ToProblem(costs, depths, edges, weights, 1);
  Require(labels.size() == costs.shape(0), "labels and nodes differ in number");
  CheckViews(nodes, costs.shape(0));
  return ToArrays(Restricted(problem, ToInts(nodes), ToInts(labels)));
}

EnclosureOptions ToOptions(const Pairs& directions, int max_open, double min_share, int side = 1) {
  Require(side > 0, "sides must have cells");
  EnclosureOptions options{{}, max_open, min_share, side};
  for (size_t i = 0; i < directions.shape(0); ++i) {
    Require(directions(i, 0) != 0 || directions(i, 1) != 0, "directions must not be 0");
    options.directions.push_back({directions(i, 0), directions(i, 1)});
  }
  return options;
}

// The grid of a view's cells. `others` is the further array of them; `inside` may be that or none.
CellGrid ToCellGrid(const Labels2D& shown, const InArray<uint8_t, nb::ndim<3>>& touched,
                    const Bytes2D& others, const uint8_t* inside) {
  const size_t rows = shown.shape(0), columns = shown.shape(1);
  Require(touched.shape(0) == rows && touched.shape(1) == columns && others.shape(0) == rows &&
              others.shape(1) == columns,
          "grids differ in shape");
  for (size_t i = 0; i < shown.size(); ++i)
    Require(shown.data()[i] < int64_t(touched.shape(2)), "labels hold an unknown plane");
  return {int32_t(columns), int32_t(rows),  int32_t(touched.shape(2)),
          shown.data(),     touched.data(), inside};
}

OutArray<uint8_t> EnclosedCellsArray(Labels2D shown, InArray<uint8_t, nb::ndim<3>> touched,
                                     Bytes2D inside, Pairs directions, int max_open) {
  const CellGrid grid = ToCellGrid(shown, touched, inside, inside.data());
  return ToArray(EnclosedCells(grid, ToOptions(directions, max_open, 0)),
                 {shown.shape(0), shown.shape(1)});
}

OutArray<uint8_t> WholePiecesArray(Labels2D shown, InArray<uint8_t, nb::ndim<3>> touched,
                                   Bytes2D enclosed, bool has_backdrop, double min_share) {
  const CellGrid grid = ToCellGrid(shown, touched, enclosed, nullptr);
  const std::vector<uint8_t> given(enclosed.data(), enclosed.data() + enclosed.size());
  return ToArray(WholePieces(grid, given, has_backdrop, min_share),
                 {shown.shape(0), shown.shape(1)});
}

using Gray2D = InArray<uint8_t, nb::ndim<2>>;
using Depths2D = InArray<float, nb::ndim<2>>;

// A view that shows a picture, with the depths of what its cells show that is no plane.
FaceView ToFaceView(const Gray2D& gray, const Depths2D& shown) {
  Require(gray.shape(0) % FaceView::kCellPx == 0 && gray.shape(1) % FaceView::kCellPx == 0 &&
              gray.size() > 0,
          "pictures must be of whole cells");
  FaceView view;
  view.columns = int32_t(gray.shape(1)) / FaceView::kCellPx;
  view.rows = int32_t(gray.shape(0)) / FaceView::kCellPx;
  view.gray = gray.data(), view.shown = shown.data();
  Require(int32_t(shown.shape(0)) == view.rows && int32_t(shown.shape(1)) == view.columns,
          "cells and pictures differ in size");
  return view;
}

class BoundFaceScene {
 public:
  BoundFaceScene(InArray<double, nb::shape<-1, 3, 3>> rotations, Points3D translations,
                 Doubles focals, Points2D principals, std::vector<Gray2D> grays,
                 std::vector<Depths2D> shown, Points3D normals, Doubles offsets, Points3D points,
                 Longs plane_offsets, Ints planes_of_points, Longs observed_offsets, Ints observed,
                 Longs neighbor_offsets, Ints neighbors, Points3D bounds, Points3D directions,
                 Points2D extents, int num_threads)
      : grays_(std::move(grays)), shown_(std::move(shown)) {
    const size_t num_views = rotations.shape(0);
    Require(translations.shape(0) == num_views && focals.size() == num_views &&
                principals.shape(0) == num_views && grays_.size() == num_views &&
                shown_.size() == num_views,
            "what is known of the views differs in number");
    Require(offsets.size() == normals.shape(0), "normals and offsets differ in number");
    for (size_t v = 0; v < num_views; ++v) {
      FaceView view = ToFaceView(grays_[v], shown_[v]);
      view.pose = MakePinholeView(rotations.data() + 9 * v, translations.data() + 3 * v, focals(v));
      view.principal = {principals(v, 0), principals(v, 1)};
      scene_.views.push_back(view);
    }
    for (size_t k = 0; k < offsets.size(); ++k)
      scene_.planes.push_back({{normals(k, 0), normals(k, 1), normals(k, 2)}, offsets(k)});
    for (size_t i = 0; i < points.shape(0); ++i)
      scene_.points.points.push_back({points(i, 0), points(i, 1), points(i, 2)});
    CheckOffsets(plane_offsets, points.shape(0), planes_of_points.size());
    CheckViews(planes_of_points, scene_.planes.size());
    scene_.points.plane_offsets = ToVector(plane_offsets);
    scene_.points.planes = {planes_of_points.data(),
                            planes_of_points.data() + planes_of_points.size()};
    CheckOffsets(observed_offsets, num_views, observed.size());
    CheckViews(observed, points.shape(0));
    CheckOffsets(neighbor_offsets, num_views, neighbors.size());
    CheckViews(neighbors, num_views);
    for (size_t v = 0; v < num_views; ++v) {
      scene_.observed.emplace_back(observed.data() + observed_offsets(v),
                                   observed.data() + observed_offsets(v + 1));
      scene_.neighbors.emplace_back(neighbors.data() + neighbor_offsets(v),
                                    neighbors.data() + neighbor_offsets(v + 1));
    }
    Require(bounds.shape(0) == 2, "bounds are a centre and a reach");
    scene_.center = {bounds(0, 0), bounds(0, 1), bounds(0, 2)};
    scene_.reach = bounds(1, 0);
    const size_t num_planes = scene_.planes.size(), num_sides = extents.shape(0);
    Require(directions.shape(0) == num_sides && (num_planes == 0 || num_sides % num_planes == 0),
            "extents must have as many directions on every plane");
    scene_.extents.resize(num_planes);
    for (size_t i = 0; i < num_sides; ++i) {
      Extent& extent = scene_.extents[i / (num_sides / num_planes)];
      extent.directions.push_back({directions(i, 0), directions(i, 1), directions(i, 2)});
      extent.low.push_back(extents(i, 0)), extent.high.push_back(extents(i, 1));
    }
    nb::gil_scoped_release release;
    scene_.Allocate();
    ParallelFor(int64_t(num_views), num_threads,
                [&](int64_t v, int) { scene_.Prepare(int32_t(v)); });
  }

  OutArray<int32_t> Label(Doubles weights, Doubles borders, int num_rounds, int max_sweeps,
                          int num_threads) {
    SetWeights(weights);
    const BorderCosts costs = ToBorderCosts(borders);
    ViewLabels labels;
    {
      nb::gil_scoped_release release;
      labels = LabelViews(scene_, costs, num_rounds, max_sweeps, num_threads);
    }
    return Joined(labels);
  }

  OutArray<int32_t> Refine(Doubles weights, Doubles borders, Ints start, int reach, int max_sweeps,
                           int num_threads) {
    SetWeights(weights);
    const BorderCosts costs = ToBorderCosts(borders);
    const ViewLabels labels = ByView(start);
    ViewLabels refined;
    {
      nb::gil_scoped_release release;
      refined = RefineLabels(scene_, costs, labels, reach, max_sweeps, num_threads);
    }
    return Joined(refined);
  }

  nb::tuple Support(Ints all, double tolerance, int num_threads) {
    const ViewLabels labels = ByView(all);
    std::vector<double> points;
    std::vector<int32_t> rows, views;
    std::vector<int64_t> offsets{0};
    const size_t most = size_t(std::count_if(all.data(), all.data() + all.size(),
                                             [](int32_t label) { return label >= 0; }));
    points.reserve(3 * most), rows.reserve(7 * most), offsets.reserve(most + 1);
    {
      nb::gil_scoped_release release;
      for (size_t begin = 0; begin < scene_.views.size(); begin += kViewsAtOnce) {
        std::vector<std::vector<CellSupport>> found(
            std::min(kViewsAtOnce, scene_.views.size() - begin));
        ParallelFor(int64_t(found.size()), num_threads, [&](int64_t i, int) {
          found[i] = SupportOf(scene_, labels, int32_t(begin + i), tolerance);
        });
        for (const auto& of_view : found) {
          for (const CellSupport& s : of_view) {
            points.insert(points.end(), {s.point.x, s.point.y, s.point.z});
            rows.insert(rows.end(),
                        {s.view, s.cell, s.plane, s.agreeing, s.through, s.hidden, s.holding});
            views.insert(views.end(), s.views.begin(), s.views.end());
            offsets.push_back(int64_t(views.size()));
          }
        }
      }
    }
    const size_t count = points.size() / 3, total = views.size(), size = offsets.size();
    return nb::make_tuple(ToArray(std::move(points), {count, 3}),
                          ToArray(std::move(rows), {count, 7}), ToArray(std::move(offsets), {size}),
                          ToArray(std::move(views), {total}));
  }

  OutArray<int64_t> CountEnclosing(Ints all, Bytes plain, Points3D points, Ints planes,
                                   Longs offsets, Ints views, Pairs steps, int max_open,
                                   double min_share, int side, int num_threads) {
    const ViewLabels labels = ByView(all);
    Require(plain.size() == all.size(), "labels and plain cells differ in number");
    std::vector<const uint8_t*> plain_cells{plain.data()};
    for (const auto& of_view : labels) plain_cells.push_back(plain_cells.back() + of_view.size());
    const size_t count = points.shape(0);
    Require(planes.size() == count, "samples differ in number");
    CheckOffsets(offsets, count, views.size());
    CheckViews(views, scene_.views.size());
    const PlaneSamples samples{points.data(), planes.data(), offsets.data(), views.data(),
                               int64_t(count)};
    const EnclosureOptions options = ToOptions(steps, max_open, min_share, side);
    std::vector<int64_t> counts;
    {
      nb::gil_scoped_release release;
      counts =
          colmap_edges::CountEnclosing(scene_, labels, plain_cells, samples, options, num_threads);
    }
    return ToArray(std::move(counts), {count});
  }

 private:
  void SetWeights(const Doubles& w) {
    Require(w.size() == 11, "weights are missing");
    scene_.weights = {w(0), w(1), w(2), w(3), w(4), w(5), w(6), w(7), w(8), w(9), w(10)};
  }

  static BorderCosts ToBorderCosts(const Doubles& b) {
    Require(b.size() == 4, "costs of borders are missing");
    return {b(0), b(1), b(2), b(3)};
  }

  static OutArray<int32_t> Joined(const ViewLabels& labels) {
    std::vector<int32_t> all;
    for (const auto& of_view : labels) all.insert(all.end(), of_view.begin(), of_view.end());
    const size_t count = all.size();
    return ToArray(std::move(all), {count});
  }

  ViewLabels ByView(const Ints& all) const {
    ViewLabels labels;
    size_t first = 0;
    for (const FaceView& view : scene_.views) {
      Require(first + view.num_cells() <= all.size(), "labels are missing");
      labels.emplace_back(all.data() + first, all.data() + first + view.num_cells());
      first += view.num_cells();
    }
    for (size_t i = 0; i < all.size(); ++i)
      Require(all(i) < int64_t(scene_.planes.size()), "labels hold an unknown plane");
    return labels;
  }

  static constexpr size_t kViewsAtOnce = 64;  // whose support is held twice

  std::vector<Gray2D> grays_;  // kept alive, as are the depths
  std::vector<Depths2D> shown_;
  FaceScene scene_;
};

}  // namespace

void BindFaces(nb::module_& m) {
  m.def("minimum_cut", &MinimumCutArrays, "terminals"_a, "edges"_a, "along"_a, "against"_a,
        "Value of a minimum cut, and (N,) uint8 1 for nodes on the source's side.");
  m.def("expand_labels", &ExpandLabelsArrays, "costs"_a, "depths"_a, "edges"_a, "weights"_a,
        "crossing_factor"_a, "max_sweeps"_a,
        "(N,) labels that alpha expansion finds, and what they cost.");
  m.def("contracted", &ContractedArrays, "costs"_a, "depths"_a, "edges"_a, "weights"_a, "blocks"_a,
        "num_blocks"_a, "Costs, depths, edges and weights of blocks of nodes with one label each.");
  m.def("restricted", &RestrictedArrays, "costs"_a, "depths"_a, "edges"_a, "weights"_a, "nodes"_a,
        "labels"_a, "The same of some nodes, while the others keep their labels.");
  m.def("enclosed_cells", &EnclosedCellsArray, "shown"_a, "touched"_a, "inside"_a, "directions"_a,
        "max_open"_a,
        "(h, w) uint8 whether going straight on within a cell's label meets its plane's points.");
  m.def("whole_pieces", &WholePiecesArray, "shown"_a, "touched"_a, "enclosed"_a, "has_backdrop"_a,
        "min_share"_a,
        "(h, w) uint8 cells that are enclosed, and all of pieces most of whose cells are.");
  nb::class_<BoundFaceScene>(m, "FaceScene")
      .def(nb::init<InArray<double, nb::shape<-1, 3, 3>>, Points3D, Doubles, Points2D,
                    std::vector<Gray2D>, std::vector<Depths2D>, Points3D, Doubles, Points3D, Longs,
                    Ints, Longs, Ints, Longs, Ints, Points3D, Points3D, Points2D, int>(),
           "rotations"_a, "translations"_a, "focals"_a, "principals"_a, "grays"_a, "shown"_a,
           "normals"_a, "offsets"_a, "points"_a, "plane_offsets"_a, "planes_of_points"_a,
           "observed_offsets"_a, "observed"_a, "neighbor_offsets"_a, "neighbors"_a, "bounds"_a,
           "directions"_a, "extents"_a, "num_threads"_a)
      .def("label", &BoundFaceScene::Label, "weights"_a, "borders"_a, "num_rounds"_a,
           "max_sweeps"_a, "num_threads"_a, "Labels of the cells of all views; -1 is no plane.")
      .def("refine", &BoundFaceScene::Refine, "weights"_a, "borders"_a, "start"_a, "reach"_a,
           "max_sweeps"_a, "num_threads"_a,
           "Labels near the borders of given ones, each from those within the reach.")
      .def("support", &BoundFaceScene::Support, "labels"_a, "tolerance"_a, "num_threads"_a,
           "Points of labelled cells; view, cell, plane, views that agree, that see through, that "
           "are hidden from; the agreeing views in rows.")
      .def("count_enclosing", &BoundFaceScene::CountEnclosing, "labels"_a, "plain"_a, "points"_a,
           "planes"_a, "offsets"_a, "views"_a, "steps"_a, "max_open"_a, "min_share"_a, "side"_a,
           "num_threads"_a,
           "(S,) number of agreeing views that show a sample in an enclosed cell of its plane.");
}

}  // namespace colmap_edges
