// SPDX-License-Identifier: GPL-3.0-or-later
#include "surface.h"

#include <algorithm>
#include <numeric>
#include <tuple>

namespace mesher {
namespace {

// Facets that face no camera are dropped if they are longer than this part of the limit of others;
// shorter ones are the noise of surfaces.
constexpr double kUnseenFactor = 0.4;

class DisjointSets {
 public:
  explicit DisjointSets(std::size_t size) : parents_(size) {
    std::iota(parents_.begin(), parents_.end(), 0);
  }
  Index Find(Index i) {
    while (parents_[i] != i) i = parents_[i] = parents_[parents_[i]];
    return i;
  }
  // The lower representative is kept, so that results do not depend on the order of unions.
  void Unite(Index a, Index b) {
    a = Find(a), b = Find(b);
    if (a < b)
      parents_[b] = a;
    else
      parents_[a] = b;
  }

 private:
  std::vector<Index> parents_;
};

// Side k of a face runs from corner k to corner (k + 1) % 3. Sides are numbered 3 * face + k.
struct Facets {
  std::vector<std::array<Index, 3>> corners;  // vertices of the triangulation
  std::vector<Index> partners;                // per side: the side across, or kNone

  Index size() const { return static_cast<Index>(corners.size()); }
  Index From(Index side) const { return corners[side / 3][side % 3]; }
  Index To(Index side) const { return corners[side / 3][(side % 3 + 1) % 3]; }
};

class Extractor {
 public:
  Extractor(const Triangulation& triangulation, const std::vector<std::uint8_t>& is_free)
      : triangulation_(triangulation), is_free_(is_free) {}

  Facets Extract() {
    facet_ids_.assign(4 * triangulation_.cells.size(), kNone);
    for (Index c = 0; c < triangulation_.num_cells(); ++c) AddBoundary(c);
    facets_.partners.assign(3 * facets_.corners.size(), kNone);
    for (Index side = 0; side < 3 * facets_.size(); ++side)
      if (facets_.partners[side] == kNone) FindPartner(side);
    return std::move(facets_);
  }

 private:
  void AddBoundary(Index c) {
    if (is_free_[c]) return;
    const Cell& cell = triangulation_.cells[c];
    for (int i = 0; i < 4; ++i) {
      if (!is_free_[cell.neighbors[i]]) continue;
      const std::array<Index, 3> corners{cell.vertices[kFacet[i][0]], cell.vertices[kFacet[i][1]],
                                         cell.vertices[kFacet[i][2]]};
      if (std::count(corners.begin(), corners.end(), kInfinite)) continue;
      facet_ids_[4 * std::size_t(c) + i] = facets_.size();
      facets_.corners.push_back(corners);
      places_.push_back(c);
    }
  }

  // Rotates about the side through solid cells to the facet that bounds them at the other end.
  void FindPartner(Index side) {
    Index c = places_[side / 3];
    const Index from = facets_.From(side), to = facets_.To(side);
    const Index behind = facets_.corners[side / 3][(side % 3 + 2) % 3];
    int across = triangulation_.cells[c].SlotOf(behind);
    while (!is_free_[triangulation_.cells[c].neighbors[across]]) {
      const Cell& cell = triangulation_.cells[c];
      const Index next = cell.neighbors[across];
      const int entry = triangulation_.MirrorIndex(c, next);
      const Cell& next_cell = triangulation_.cells[next];
      // The shared facet contains the side and one more vertex, which the next facet does not
      // contain.
      for (int i = 0; i < 4; ++i)
        if (i != entry && next_cell.vertices[i] != from && next_cell.vertices[i] != to) across = i;
      c = next;
    }
    const Index partner = facet_ids_[4 * std::size_t(c) + across];
    if (partner == kNone) return;  // the surface ends at infinity
    for (Index k = 0; k < 3; ++k) {
      if (facets_.corners[partner][k] != to) continue;
      facets_.partners[side] = 3 * partner + k;
      facets_.partners[3 * partner + k] = side;
    }
  }

  const Triangulation& triangulation_;
  const std::vector<std::uint8_t>& is_free_;
  Facets facets_;
  std::vector<Index> places_;  // the solid cell of each facet
  std::vector<Index> facet_ids_;
};

// Removes the facets that are not kept and renumbers the others. Returns the number removed.
Index Keep(const std::vector<std::uint8_t>& kept, Facets& facets) {
  std::vector<Index> new_ids(facets.corners.size(), kNone);
  Index count = 0;
  for (Index f = 0; f < facets.size(); ++f)
    if (kept[f]) new_ids[f] = count++;
  for (Index f = 0; f < facets.size(); ++f) {
    if (!kept[f]) continue;
    facets.corners[new_ids[f]] = facets.corners[f];
    for (int k = 0; k < 3; ++k) {
      const Index partner = facets.partners[3 * f + k];
      const bool lost = partner == kNone || new_ids[partner / 3] == kNone;
      facets.partners[3 * new_ids[f] + k] = lost ? kNone : 3 * new_ids[partner / 3] + partner % 3;
    }
  }
  const Index removed = facets.size() - count;
  facets.corners.resize(count);
  facets.partners.resize(3 * std::size_t(count));
  return removed;
}

// Whether a camera that observes a corner of a facet is on its free side. A facet that all of these
// see from behind closes a volume that no ray has entered, and is no surface that they observe.
// Facets between points that no camera observes are not judged.
bool FacesCamera(const std::array<Index, 3>& corners, const Sight& sight,
                 const std::vector<Vec3>& points) {
  const Vec3& origin = points[corners[0]];
  const Vec3 outward = Cross(points[corners[1]] - origin, points[corners[2]] - origin);
  bool is_observed = false;
  for (const Index v : corners)
    for (const Index* camera = sight.rays.begin(v); camera != sight.rays.end(v); ++camera) {
      is_observed = true;
      if (Dot(outward, sight.cameras[*camera] - origin) > 0) return true;
    }
  return !is_observed;
}

Index DropLongFacets(const Triangulation& triangulation, const Sight& sight, double factor,
                     Facets& facets) {
  if (factor <= 0) return 0;
  const auto& points = triangulation.points;
  std::vector<std::uint8_t> kept(facets.corners.size());
  for (Index f = 0; f < facets.size(); ++f) {
    const auto& [a, b, c] = facets.corners[f];
    const double longest = std::max(
        {Norm(points[a] - points[b]), Norm(points[b] - points[c]), Norm(points[c] - points[a])});
    const double limit = factor * std::min({sight.ranges[a], sight.ranges[b], sight.ranges[c]});
    kept[f] = longest <= kUnseenFactor * limit ||
              (longest <= limit && FacesCamera(facets.corners[f], sight, points));
  }
  return Keep(kept, facets);
}

Index DropSmallComponents(Index min_faces, Facets& facets) {
  if (min_faces <= 1) return 0;
  DisjointSets components(facets.corners.size());
  for (Index side = 0; side < 3 * facets.size(); ++side)
    if (facets.partners[side] != kNone) components.Unite(side / 3, facets.partners[side] / 3);
  std::vector<Index> sizes(facets.corners.size());
  for (Index f = 0; f < facets.size(); ++f) ++sizes[components.Find(f)];
  std::vector<std::uint8_t> kept(facets.corners.size());
  for (Index f = 0; f < facets.size(); ++f) kept[f] = sizes[components.Find(f)] >= min_faces;
  return Keep(kept, facets);
}

// Makes one vertex for every fan or disk of facets around a vertex of the triangulation. Returns
// the new vertex of each corner.
std::vector<Index> SplitVertices(const Facets& facets, Surface& surface) {
  DisjointSets fans(3 * facets.corners.size());
  for (Index side = 0; side < 3 * facets.size(); ++side) {
    const Index partner = facets.partners[side];
    if (partner == kNone) continue;
    fans.Unite(side, 3 * (partner / 3) + (partner % 3 + 1) % 3);
  }
  std::vector<std::pair<Index, Index>> roots;  // (vertex, corner)
  for (Index corner = 0; corner < 3 * facets.size(); ++corner)
    if (fans.Find(corner) == corner) roots.emplace_back(facets.From(corner), corner);
  std::sort(roots.begin(), roots.end());
  std::vector<Index> new_vertex(3 * facets.corners.size());
  for (const auto& [vertex, corner] : roots) {
    if (!surface.vertices.empty() && surface.vertices.back()[0] == vertex)
      ++surface.stats.vertices_split;
    new_vertex[corner] = static_cast<Index>(surface.vertices.size());
    surface.vertices.push_back({vertex, vertex});
  }
  for (Index corner = 0; corner < 3 * facets.size(); ++corner)
    new_vertex[corner] = new_vertex[fans.Find(corner)];
  return new_vertex;
}

// Several edges may connect the same two vertices; all but one get a midpoint. Returns the midpoint
// of each side, or kNone.
std::vector<Index> SplitEdges(const Facets& facets, const std::vector<Index>& vertex_of,
                              Surface& surface) {
  auto to = [&](Index side) { return vertex_of[side % 3 == 2 ? side - 2 : side + 1]; };
  std::vector<std::tuple<Index, Index, Index>> edges;  // (low vertex, high vertex, side)
  for (Index side = 0; side < 3 * facets.size(); ++side) {
    if (facets.partners[side] != kNone && facets.partners[side] < side) continue;
    edges.emplace_back(std::min(vertex_of[side], to(side)), std::max(vertex_of[side], to(side)),
                       side);
  }
  std::sort(edges.begin(), edges.end());
  std::vector<Index> midpoints(3 * facets.corners.size(), kNone);
  for (std::size_t i = 1; i < edges.size(); ++i) {
    const auto& [low, high, side] = edges[i];
    if (low != std::get<0>(edges[i - 1]) || high != std::get<1>(edges[i - 1])) continue;
    midpoints[side] = static_cast<Index>(surface.vertices.size());
    if (facets.partners[side] != kNone) midpoints[facets.partners[side]] = midpoints[side];
    surface.vertices.push_back({surface.vertices[low][0], surface.vertices[high][0]});
    ++surface.stats.edges_split;
  }
  return midpoints;
}

// Faces of a triangle whose sides may have midpoints: corners are cut off one by one.
void AddFaces(const Index* corners, const Index* midpoints, Surface& surface) {
  std::vector<Index> ring;
  for (int k = 0; k < 3; ++k) {
    ring.push_back(corners[k]);
    if (midpoints[k] != kNone) ring.push_back(midpoints[k]);
  }
  if (ring.size() == 6) {
    surface.faces.insert(surface.faces.end(), {{ring[1], ring[3], ring[5]},
                                               {ring[0], ring[1], ring[5]},
                                               {ring[2], ring[3], ring[1]},
                                               {ring[4], ring[5], ring[3]}});
    return;
  }
  // A fan around a midpoint (or around the only corner 0) never makes a flat triangle.
  std::size_t center = 0;
  for (int k = 2; k >= 0; --k)
    if (midpoints[k] != kNone)
      center = std::find(ring.begin(), ring.end(), midpoints[k]) - ring.begin();
  for (std::size_t i = 1; i + 1 < ring.size(); ++i)
    surface.faces.push_back(
        {ring[center], ring[(center + i) % ring.size()], ring[(center + i + 1) % ring.size()]});
}

}  // namespace

Surface ExtractSurface(const Triangulation& triangulation, const std::vector<std::uint8_t>& is_free,
                       const Sight& sight, const SurfaceOptions& options) {
  Surface surface;
  Facets facets = Extractor(triangulation, is_free).Extract();
  surface.stats.boundary_facets = facets.size();
  surface.stats.long_facets_dropped =
      DropLongFacets(triangulation, sight, options.long_facet_factor, facets);
  surface.stats.component_faces_dropped = DropSmallComponents(options.min_component_faces, facets);
  const std::vector<Index> vertex_of = SplitVertices(facets, surface);
  const std::vector<Index> midpoints = SplitEdges(facets, vertex_of, surface);
  for (Index f = 0; f < facets.size(); ++f)
    AddFaces(&vertex_of[3 * std::size_t(f)], &midpoints[3 * std::size_t(f)], surface);
  return surface;
}

}  // namespace mesher
