// SPDX-License-Identifier: GPL-3.0-or-later
#include "mesher.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <stdexcept>

#include "conforming.h"
#include "manifold_sweep.h"
#include "merging.h"
#include "min_cut.h"

namespace mesher {
namespace {

// Records the seconds since the last call under a name.
class Stopwatch {
 public:
  explicit Stopwatch(std::map<std::string, double>& stats) : stats_(stats) {}
  void Lap(const std::string& name) {
    const auto now = std::chrono::steady_clock::now();
    stats_["seconds_" + name] += std::chrono::duration<double>(now - last_).count();
    last_ = now;
  }

 private:
  std::map<std::string, double>& stats_;
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

void CheckIndices(const std::vector<Index>& values, std::size_t limit, const std::string& name) {
  for (Index value : values)
    if (value < 0 || value >= static_cast<Index>(limit))
      throw std::invalid_argument(name + " holds index " + std::to_string(value) + " of " +
                                  std::to_string(limit));
}

void CheckRows(const Rows& rows, std::size_t limit, const std::string& name) {
  const auto& offsets = rows.offsets;
  if (offsets.empty() || offsets.front() != 0 ||
      offsets.back() != static_cast<std::int64_t>(rows.values.size()) ||
      !std::is_sorted(offsets.begin(), offsets.end()))
    throw std::invalid_argument(name + " offsets must rise from 0 to the number of values, " +
                                std::to_string(rows.values.size()));
  CheckIndices(rows.values, limit, name);
}

void CheckInput(const MesherInput& input) {
  CheckRows(input.visibility, input.cameras.size(), "visibility");
  CheckRows(input.polylines, input.points.size(), "polylines");
  if (input.visibility.offsets.size() != input.points.size() + 1)
    throw std::invalid_argument("visibility has " + std::to_string(input.visibility.size()) +
                                " rows for " + std::to_string(input.points.size()) + " points");
  if (!std::all_of(input.cameras.begin(), input.cameras.end(), IsFinite))
    throw std::invalid_argument("camera centers must be finite");
  if (input.background_cameras.size() != input.background_directions.size())
    throw std::invalid_argument("background rays have " +
                                std::to_string(input.background_cameras.size()) + " cameras and " +
                                std::to_string(input.background_directions.size()) + " directions");
  CheckIndices(input.background_cameras, input.cameras.size(), "background");
  for (const Vec3& direction : input.background_directions)
    if (!(Norm(direction) > 0) || !IsFinite(direction))
      throw std::invalid_argument("directions of background rays must be finite and not 0");
}

struct Bounds {
  Vec3 low, high;
};

// Bounding box of at least one point.
Bounds BoundsOf(const std::vector<Vec3>& points) {
  Bounds bounds{points[0], points[0]};
  for (const Vec3& p : points)
    for (int axis = 0; axis < 3; ++axis) {
      bounds.low[axis] = std::min(bounds.low[axis], p[axis]);
      bounds.high[axis] = std::max(bounds.high[axis], p[axis]);
    }
  return bounds;
}

// Shift and power-of-two scale that map the points to the unit cube around the origin, to avoid
// loss of precision by large offsets. Scaling by a power of two is exact.
class UnitFrame {
 public:
  explicit UnitFrame(const std::vector<Vec3>& points) {
    if (points.empty()) return;
    const auto [low, high] = BoundsOf(points);
    const Vec3 size = high - low;
    center_ = 0.5 * low + 0.5 * high;
    const double largest = std::max({size.x, size.y, size.z});
    if (largest > 0 && std::isfinite(largest)) exponent_ = std::ilogb(largest);
  }
  Vec3 operator()(const Vec3& p) const { return Scaled(p - center_, -exponent_); }
  Vec3 Inverse(const Vec3& p) const { return Scaled(p, exponent_) + center_; }

 private:
  // The factor itself would overflow for the smallest coordinates.
  static Vec3 Scaled(const Vec3& p, int exponent) {
    return {std::ldexp(p.x, exponent), std::ldexp(p.y, exponent), std::ldexp(p.z, exponent)};
  }

  Vec3 center_;
  int exponent_ = 0;
};

// The input of the triangulation: distinct points in canonical order, each with the cameras of all
// its duplicates.
struct Scene {
  UnitFrame frame;
  std::vector<Vec3> points;
  std::vector<Index> sources;  // index of an input point at this position
  Rows rays;
  std::vector<Vec3> cameras;
  Rows polylines;
  std::vector<Index>
      polyline_rows;          // the input's polyline of each, which are split at dropped points
  std::vector<double> radii;  // merging radii of points of polylines
  std::vector<BackgroundRay> background;
};

// Adds the polylines of vertices, split at dropped points.
void MapPolylines(const Rows& polylines, const std::vector<Index>& vertex_of, Scene& scene) {
  for (Index row = 0; row < polylines.size(); ++row) {
    const auto finish = [&] {
      scene.polylines.offsets.push_back(static_cast<std::int64_t>(scene.polylines.values.size()));
      scene.polyline_rows.push_back(row);
    };
    for (const Index* point = polylines.begin(row); point != polylines.end(row); ++point) {
      if (vertex_of[*point] == kNone)
        finish();
      else
        scene.polylines.values.push_back(vertex_of[*point]);
    }
    finish();
  }
}

Scene MakeScene(const MesherInput& input, std::map<std::string, double>& stats) {
  std::vector<Index> finite;
  std::vector<Vec3> points;
  for (std::size_t i = 0; i < input.points.size(); ++i) {
    if (!IsFinite(input.points[i])) continue;
    finite.push_back(static_cast<Index>(i));
    points.push_back(input.points[i]);
  }
  const UnitFrame frame(points);
  for (Vec3& p : points) p = frame(p);
  Scene scene{frame, {}, {}, {}, {}, {}, {}, {}, {}};
  std::vector<Index> vertex_of(input.points.size(), kNone);
  for (const Vec3& camera : input.cameras) scene.cameras.push_back(frame(camera));

  const Rows places = SortDistinctPoints(points);
  std::int64_t on_camera = 0;
  std::vector<Index> cameras;
  for (std::int64_t place = 0; place < places.size(); ++place) {
    const Vec3& point = points[*places.begin(place)];
    cameras.clear();
    for (const Index* i = places.begin(place); i != places.end(place); ++i) {
      vertex_of[finite[*i]] = static_cast<Index>(place);
      cameras.insert(cameras.end(), input.visibility.begin(finite[*i]),
                     input.visibility.end(finite[*i]));
    }
    std::sort(cameras.begin(), cameras.end());
    cameras.erase(std::unique(cameras.begin(), cameras.end()), cameras.end());
    for (Index camera : cameras) {
      const bool coincides = scene.cameras[camera] == point;
      on_camera += coincides;
      if (!coincides) scene.rays.values.push_back(camera);
    }
    scene.rays.offsets.push_back(static_cast<std::int64_t>(scene.rays.values.size()));
    scene.points.push_back(point);
    scene.sources.push_back(finite[*places.begin(place)]);
  }
  MapPolylines(input.polylines, vertex_of, scene);
  stats["points"] = static_cast<double>(input.points.size());
  stats["points_not_finite"] = static_cast<double>(input.points.size() - points.size());
  stats["points_duplicate"] = static_cast<double>(points.size() - scene.points.size());
  stats["rays"] = static_cast<double>(scene.rays.values.size());
  stats["rays_of_zero_length"] = static_cast<double>(on_camera);
  return scene;
}

// Sorted union of rows.
std::vector<Index> United(const Rows& rows, const std::vector<Index>& chosen) {
  std::vector<Index> values;
  for (const Index row : chosen) values.insert(values.end(), rows.begin(row), rows.end(row));
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
  return values;
}

// The scene with nearly coinciding points of polylines merged, with all their cameras.
Scene WithMergedPoints(Scene scene, double factor, std::map<std::string, double>& stats) {
  const auto radii = MergeRadii(scene.points, scene.rays, scene.cameras, scene.polylines, factor);
  const auto representatives = Representatives(scene.points, radii);
  std::vector<Index> place_of(scene.points.size());
  std::vector<std::vector<Index>> members;
  Scene merged{scene.frame,
               {},
               {},
               {},
               std::move(scene.cameras),
               std::move(scene.polylines),
               std::move(scene.polyline_rows),
               {},
               {}};
  for (Index v = 0; v < static_cast<Index>(scene.points.size()); ++v) {
    if (representatives[v] == v) {
      place_of[v] = static_cast<Index>(members.size());
      members.emplace_back();
      merged.points.push_back(scene.points[v]);
      merged.sources.push_back(scene.sources[v]);
      merged.radii.push_back(radii[v]);
    } else {
      place_of[v] = place_of[representatives[v]];
    }
    members[place_of[v]].push_back(v);
  }
  for (const auto& same : members) {
    const auto cameras = United(scene.rays, same);
    merged.rays.values.insert(merged.rays.values.end(), cameras.begin(), cameras.end());
    merged.rays.offsets.push_back(static_cast<std::int64_t>(merged.rays.values.size()));
  }
  for (Index& v : merged.polylines.values) v = place_of[v];
  stats["points_merged"] = static_cast<double>(scene.points.size() - merged.points.size());
  stats["rays"] = static_cast<double>(merged.rays.values.size());
  return merged;
}

// Inserts the cameras with background rays as vertices, in an order that depends only on their
// positions. These vertices have no rays.
void AddBackground(const MesherInput& input, DelaunayBuilder& builder, Scene& scene) {
  std::vector<Index> cameras = input.background_cameras;
  std::sort(cameras.begin(), cameras.end(), [&](Index a, Index b) {
    return scene.cameras[a] < scene.cameras[b] || (scene.cameras[a] == scene.cameras[b] && a < b);
  });
  cameras.erase(std::unique(cameras.begin(), cameras.end()), cameras.end());
  std::vector<Index> vertex_of(scene.cameras.size(), kNone);
  for (const Index camera : cameras) vertex_of[camera] = builder.Insert(scene.cameras[camera], 0);
  while (scene.rays.size() < builder.num_vertices())
    scene.rays.offsets.push_back(scene.rays.offsets.back());

  const auto [low, high] = BoundsOf(builder.points());
  const double outside = 2 * Norm(high - low);
  for (std::size_t i = 0; i < input.background_cameras.size(); ++i) {
    const Index camera = input.background_cameras[i];
    const Vec3& direction = input.background_directions[i];
    const Vec3 target = scene.cameras[camera] + (outside / Norm(direction)) * direction;
    scene.background.push_back({vertex_of[camera], target});
  }
}

// Empty if the points span no volume. Appends rays for the points that it adds, and writes the
// `pieces` of the polylines.
Triangulation Triangulate(const MesherInput& input, const MesherOptions& options, Scene& scene,
                          std::vector<Piece>& pieces, std::map<std::string, double>& stats) {
  DelaunayBuilder builder(scene.points);
  if (builder.dimension() < 3) return {};
  if (options.min_segment_factor > 0) {
    const double min_length =
        options.min_segment_factor * TypicalSegmentLength(scene.polylines, scene.points);
    Conforming conforming = Conform(scene.polylines, min_length, scene.radii, builder, scene.rays);
    pieces = std::move(conforming.pieces);
    stats["edge_segments"] = conforming.segments;
    stats["edge_segments_missing"] = conforming.segments_missing;
    stats["edge_points_added"] = conforming.points_added;
  } else {
    pieces = PiecesOf(scene.polylines);
  }
  if (!input.background_cameras.empty()) AddBackground(input, builder, scene);
  return builder.Flatten();
}

// 1 for vertices on polylines, including added ones.
std::vector<std::uint8_t> EdgePoints(const Triangulation& triangulation, const Scene& scene) {
  std::vector<std::uint8_t> is_edge(triangulation.points.size(), 0);
  for (Index v : scene.polylines.values) is_edge[v] = 1;
  std::fill(is_edge.begin() + scene.points.size(), is_edge.end(), 1);
  return is_edge;
}

std::vector<std::uint8_t> LabelFreeCells(const Triangulation& triangulation, const Scene& scene,
                                         const MesherOptions& options, MesherResult& result,
                                         Stopwatch& watch) {
  if (options.method == "graphcut") {
    CutProblem problem =
        VisibilityProblem(triangulation, scene.rays, scene.cameras,
                          EdgePoints(triangulation, scene), scene.background, options.visibility);
    watch.Lap("visibility");
    Cut cut = MinimumCut(triangulation.cells, std::move(problem));
    result.stats["cut_value"] = static_cast<double>(cut.flow) / kRayWeight;
    return std::move(cut.is_source);
  }
  auto votes =
      CountVotes(triangulation, scene.rays, scene.cameras, scene.background, options.votes);
  watch.Lap("visibility");
  if (options.method == "carve") return FreeByVotes(votes, options.votes.threshold);
  for (double& vote : votes) vote -= options.votes.threshold;
  ManifoldRegion region = SweepManifold(triangulation, votes);
  result.stats["cells_closed"] = region.cells_closed;
  result.stats["cells_opened"] = region.cells_opened;
  return std::move(region.is_free);
}

// Viewing distance of each vertex: the distance of the nearest of its cameras, or the median
// length of all rays if that is longer. Unlike the spacing of points, it does not depend on added
// points, which must not cause holes elsewhere.
std::vector<double> SeenFrom(const std::vector<Vec3>& points, const Scene& scene) {
  std::vector<double> nearest(points.size(), 0), lengths;
  lengths.reserve(scene.rays.values.size());
  for (std::size_t v = 0; v < points.size(); ++v) {
    const std::size_t first = lengths.size();
    for (const Index* camera = scene.rays.begin(v); camera != scene.rays.end(v); ++camera)
      lengths.push_back(Norm(scene.cameras[*camera] - points[v]));
    if (lengths.size() > first)
      nearest[v] = *std::min_element(lengths.begin() + first, lengths.end());
  }
  if (lengths.empty()) return std::vector<double>(points.size(), HUGE_VAL);
  const auto median = lengths.begin() + lengths.size() / 2;
  std::nth_element(lengths.begin(), median, lengths.end());
  for (double& range : nearest) range = std::max(range, *median);
  return nearest;
}

void AddSurface(const MesherInput& input, const Scene& scene, const Triangulation& triangulation,
                const Surface& surface, MesherResult& result) {
  const Index num_sources = static_cast<Index>(scene.sources.size());
  for (const auto& [a, b] : surface.vertices) {
    const Index source = a == b && a < num_sources ? scene.sources[a] : kNone;
    const Vec3 middle = 0.5 * triangulation.points[a] + 0.5 * triangulation.points[b];
    result.sources.push_back(source);
    result.vertices.push_back(source == kNone ? scene.frame.Inverse(middle) : input.points[source]);
  }
  result.faces = surface.faces;
  const SurfaceStats& stats = surface.stats;
  result.stats["boundary_facets"] = stats.boundary_facets;
  result.stats["long_facets_dropped"] = stats.long_facets_dropped;
  result.stats["component_faces_dropped"] = stats.component_faces_dropped;
  result.stats["vertices_split"] = stats.vertices_split;
  result.stats["edges_split"] = stats.edges_split;
}

// The sides of faces that lie on pieces of polylines. A side that ends at the midpoint of two
// vertices lies on the piece between them.
void AddEdges(const Scene& scene, const std::vector<Piece>& pieces, const Surface& surface,
              MesherResult& result) {
  std::map<std::pair<Index, Index>, Index> rows;
  for (const Piece& piece : pieces) rows.emplace(std::pair(piece.a, piece.b), piece.row);
  for (const auto& corners : surface.faces)
    for (int k = 0; k < 3; ++k) {
      const Index i = corners[k], j = corners[(k + 1) % 3];
      const auto [a, b] = surface.vertices[i];
      const auto [c, d] = surface.vertices[j];
      const auto [low, high] = std::minmax({a, b, c, d});
      const auto is_end = [low = low, high = high](Index v) { return v == low || v == high; };
      if (!is_end(a) || !is_end(b) || !is_end(c) || !is_end(d)) continue;
      const auto found = rows.find({low, high});
      if (found != rows.end())
        result.edges.push_back(
            {std::min(i, j), std::max(i, j), scene.polyline_rows[found->second]});
    }
  std::sort(result.edges.begin(), result.edges.end());
  result.edges.erase(std::unique(result.edges.begin(), result.edges.end()), result.edges.end());
}

}  // namespace

MesherResult MeshPoints(const MesherInput& input, const MesherOptions& options) {
  CheckInput(input);
  if (options.method != "graphcut" && options.method != "carve" && options.method != "manifold")
    throw std::invalid_argument("unknown meshing method " + options.method);
  MesherResult result;
  Stopwatch watch(result.stats);
  Scene scene =
      WithMergedPoints(MakeScene(input, result.stats), options.merge_factor, result.stats);
  watch.Lap("sorting");
  std::vector<Piece> pieces;
  const Triangulation triangulation = Triangulate(input, options, scene, pieces, result.stats);
  result.stats["cells"] = triangulation.num_cells();
  result.stats["background_rays"] = static_cast<double>(scene.background.size());
  watch.Lap("triangulation");
  if (triangulation.cells.empty()) return result;
  const auto is_free = LabelFreeCells(triangulation, scene, options, result, watch);
  watch.Lap("labelling");
  const auto ranges = SeenFrom(triangulation.points, scene);
  const Surface surface =
      ExtractSurface(triangulation, is_free, {scene.rays, scene.cameras, ranges}, options.surface);
  AddSurface(input, scene, triangulation, surface, result);
  AddEdges(scene, pieces, surface, result);
  watch.Lap("surface");
  return result;
}

}  // namespace mesher
