// SPDX-License-Identifier: GPL-3.0-or-later
// Walks from a vertex of the triangulation towards a camera, cell by cell.
//
// Points are projected along the ray to a plane, where the ray is the origin and the side on which
// an edge passes it is the sign of a 2D cross product. Signs within the rounding error are computed
// exactly, and a ray that meets an edge or a vertex is treated as if its target were displaced by
// an infinitesimal. Every ray has one reproducible result, and every walk terminates.
#pragma once

#include <algorithm>
#include <cmath>

#include "predicates.h"
#include "triangulation.h"

namespace mesher {

// The ray leaves `cell` through its facet `facet`, at `distance` from the vertex, and enters `next`
// through its facet `entry`.
struct Crossing {
  Index cell;
  int facet;
  Index next;
  int entry;
  double distance;
};

// Cells around a vertex at which the search for those of a ray starts; the result does not depend
// on them.
struct StartCells {
  Index front = kNone, behind = kNone;
};

class RayWalker {
 public:
  RayWalker(const Triangulation& triangulation, Index vertex, const Vec3& target,
            const StartCells& near = {})
      : triangulation_(&triangulation),
        vertex_(vertex),
        origin_(triangulation.points[vertex]),
        target_(target) {
    const Vec3 ray = target - origin_;
    length_ = Norm(ray);
    direction_ = (1 / length_) * ray;
    // The coordinate axis least aligned with the ray makes the frame well conditioned.
    const Vec3 size{std::abs(ray.x), std::abs(ray.y), std::abs(ray.z)};
    const Vec3 axis = size.x <= size.y && size.x <= size.z ? Vec3{1, 0, 0}
                      : size.y <= size.z                   ? Vec3{0, 1, 0}
                                                           : Vec3{0, 0, 1};
    const Vec3 normal = Cross(axis, direction_);
    axis_u_ = (1 / Norm(normal)) * normal;
    axis_v_ = Cross(direction_, axis_u_);
    const Index any = near.front == kNone ? FirstFinite() : near.front;
    front_ = FindStart(any, 1);
    behind_ = FindStart(near.behind == kNone ? any : near.behind, -1);
  }

  double length() const { return length_; }

  // The cells around the vertex that the ray and its extension behind the vertex enter; kNone if
  // they leave the convex hull at the vertex.
  Index front() const { return front_; }
  Index behind() const { return behind_; }

  // Start of the search for the cells of a similar ray from the same vertex.
  StartCells near() const { return {front_, behind_}; }

  // Calls visit(cell) for the infinite cells around the vertex whose hull facet faces the ray (if
  // `ahead`) or its extension, for rays that leave the convex hull at the vertex.
  template <typename Visit>
  void VisitOutside(bool ahead, Visit&& visit) const {
    for (const Index* c = triangulation_->stars.begin(vertex_);
         c != triangulation_->stars.end(vertex_); ++c) {
      if (!triangulation_->cells[*c].IsInfinite()) continue;
      const double facing = HullFacing(triangulation_->cells[*c]);
      if (ahead ? facing > 0 : facing < 0) visit(*c);
    }
  }

  // Facet of `behind` opposite the vertex, and its distance along the extension. Only valid if
  // there is such a cell.
  Crossing BehindExit() const {
    const Cell& cell = triangulation_->cells[behind_];
    const int facet = PositionOf(vertex_, cell);
    Projected corners[3];
    for (int i = 0; i < 3; ++i) corners[i] = Project(cell.vertices[kFacet[facet][i]]);
    const Index next = cell.neighbors[facet];
    return {behind_, facet, next, triangulation_->MirrorIndex(behind_, next), -Depth(corners)};
  }

  // A vertex, seen along the ray.
  struct Projected {
    double u, v, depth, size;
    Index vertex;
  };

  // Where a walk is: in `cell`, which it leaves through its facet `exit` with these corners.
  struct Position {
    Index cell;
    int exit;
    Projected corners[3];
  };

  // The position in the cell in front, which is required.
  Position Start() const {
    const Cell& cell = triangulation_->cells[front_];
    Position at{front_, PositionOf(vertex_, cell), {}};
    for (int i = 0; i < 3; ++i) at.corners[i] = Project(cell.vertices[kFacet[at.exit][i]]);
    return at;
  }

  // Calls visit(Crossing) for the facet ahead, moves on to the next cell and returns true, unless
  // the walk ends: in the cell that contains the target or is outside the convex hull, or with
  // the cell kNone if visit returned false. For facets entirely beyond `far`, distances of
  // crossings are only lower bounds.
  template <typename Visit>
  bool Step(double far, Position& at, Visit&& visit) const {
    Projected* corners = at.corners;
    double distance = Nearest(corners);
    if (distance <= far || Farthest(corners) >= length_ * (1 - kNearTarget)) {
      distance = Depth(corners);
      if (IsBeyondTarget(corners, distance)) return false;
    }
    const Index last = at.cell;
    at.cell = triangulation_->cells[last].neighbors[at.exit];
    const Cell& cell = triangulation_->cells[at.cell];
    const int entry = PositionIn(cell.neighbors, last);
    if (!visit(Crossing{last, at.exit, at.cell, entry, distance})) {
      at.cell = kNone;
      return false;
    }
    const Index apex_vertex = cell.vertices[entry];
    if (apex_vertex == kInfinite) return false;

    // Seen along the ray, the facet (0, 1, 2) turns counter-clockwise around it; the apex
    // replaces the corner opposite the side through which the ray leaves.
    const Projected apex = Project(apex_vertex);
    Projected& replaced = corners[ReplacedCorner(corners, apex)];
    at.exit = PositionOf(replaced.vertex, cell);
    // One by one: what is copied as a whole waits until all of it is written.
    replaced.u = apex.u;
    replaced.v = apex.v;
    replaced.depth = apex.depth;
    replaced.size = apex.size;
    replaced.vertex = apex.vertex;
    return true;
  }

  // Steps from the cell in front to the end; returns the last cell.
  template <typename Visit>
  Index Walk(double far, Visit&& visit) const {
    Position at = Start();
    while (Step(far, at, visit)) continue;
    return at.cell;
  }

 private:
  // Relative errors of a cross product of projected points stay well below this.
  static constexpr double kSignError = 1e-14;
  // Facets this close to the target, relative to the ray's length, are compared exactly.
  static constexpr double kNearTarget = 1e-9;

  Projected Project(Index vertex) const {
    const Vec3 p = triangulation_->points[vertex] - origin_;
    return {Dot(axis_u_, p), Dot(axis_v_, p), Dot(direction_, p),
            std::abs(p.x) + std::abs(p.y) + std::abs(p.z), vertex};
  }

  static double SideValue(const Projected& a, const Projected& b) { return a.u * b.v - a.v * b.u; }

  // The side of the ray on which the edge from a to b passes.
  int Side(const Projected& a, const Projected& b) const {
    const double value = SideValue(a, b);
    const double bound = kSignError * a.size * b.size;
    if (value > bound) return 1;
    if (value < -bound) return -1;
    const auto& points = triangulation_->points;
    return PerturbedOrientation(origin_, target_, points[a.vertex], points[b.vertex]);
  }

  // Without branches, which would be unpredictable, unless a sign is within the rounding error.
  int ReplacedCorner(const Projected corners[3], const Projected& apex) const {
    const double side0 = SideValue(corners[0], apex);
    const Projected& other = corners[1 + (side0 > 0)];
    const double side = SideValue(other, apex);
    const double error = kSignError * apex.size;
    if (std::abs(side0) > error * corners[0].size && std::abs(side) > error * other.size)
      return ((side0 > 0) & (side < 0)) | ((side0 < 0) & (side > 0)) << 1;
    const int sign0 = Side(corners[0], apex);
    if (sign0 == 0) return 0;
    if (sign0 > 0) return Side(corners[2], apex) < 0 ? 1 : 0;
    return Side(corners[1], apex) > 0 ? 2 : 0;
  }

  static double Nearest(const Projected corners[3]) {
    return std::min({corners[0].depth, corners[1].depth, corners[2].depth});
  }
  static double Farthest(const Projected corners[3]) {
    return std::max({corners[0].depth, corners[1].depth, corners[2].depth});
  }

  // Distance at which the ray's line intersects the plane of a facet that it crosses.
  static double Depth(const Projected corners[3]) {
    const double weights[3] = {SideValue(corners[1], corners[2]), SideValue(corners[2], corners[0]),
                               SideValue(corners[0], corners[1])};
    const double sum = weights[0] + weights[1] + weights[2];
    const double depth = (weights[0] * corners[0].depth + weights[1] * corners[1].depth +
                          weights[2] * corners[2].depth) /
                         sum;
    if (!std::isfinite(depth)) return Nearest(corners);
    return std::min(std::max(depth, Nearest(corners)), Farthest(corners));
  }

  bool IsBeyondTarget(const Projected corners[3], double distance) const {
    if (distance < length_ * (1 - kNearTarget)) return false;
    if (distance > length_ * (1 + kNearTarget)) return true;
    const auto& points = triangulation_->points;
    return Orientation(points[corners[0].vertex], points[corners[1].vertex],
                       points[corners[2].vertex], target_) <= 0;
  }

  static int PositionOf(Index vertex, const Cell& cell) {
    return PositionIn(cell.vertices, vertex);
  }

  Index FirstFinite() const {
    const Index* c = triangulation_->stars.begin(vertex_);
    while (triangulation_->cells[*c].IsInfinite()) ++c;
    return *c;
  }

  // The cell around the vertex that the ray (`sign` 1) or its extension (-1) enters, or kNone.
  // Walks from cell to cell around the vertex through facets that separate the cell from the ray;
  // in a Delaunay triangulation this terminates.
  Index FindStart(Index at, int sign) const {
    while (true) {
      const Cell& cell = triangulation_->cells[at];
      if (cell.IsInfinite()) return kNone;  // the ray leaves the convex hull
      const int apex = PositionOf(vertex_, cell);
      Projected corners[3];
      for (int i = 0; i < 3; ++i) corners[i] = Project(cell.vertices[kFacet[apex][i]]);
      int i = 0;
      while (i < 3 && sign * Side(corners[i], corners[(i + 1) % 3]) > 0) ++i;
      if (i == 3) return at;
      at = cell.neighbors[kFacet[apex][(i + 2) % 3]];
    }
  }

  // Cosine between the ray and the outward normal of an infinite cell's hull facet.
  double HullFacing(const Cell& cell) const {
    const int at = PositionOf(kInfinite, cell);
    const auto& points = triangulation_->points;
    const Vec3& a = points[cell.vertices[kFacet[at][0]]];
    const Vec3& b = points[cell.vertices[kFacet[at][1]]];
    const Vec3& c = points[cell.vertices[kFacet[at][2]]];
    // Seen from the infinite vertex the facet turns clockwise: its normal points to the inside.
    const Vec3 inward = Cross(b - a, c - a);
    const double norm = Norm(inward);
    return norm > 0 ? -Dot(inward, direction_) / norm : -1;
  }

  const Triangulation* triangulation_;
  Index vertex_;
  Vec3 origin_, target_;
  double length_;
  Vec3 direction_, axis_u_, axis_v_;
  Index front_ = kNone, behind_ = kNone;
};

// Calls visit(cell, number of the camera's rays) for the cells around cameras with background rays.
// They are free, since no surface touches a camera.
template <typename Visit>
void VisitAroundCameras(const Triangulation& triangulation,
                        const std::vector<BackgroundRay>& background, Visit&& visit) {
  std::vector<std::int64_t> num_rays(background.empty() ? 0 : triangulation.points.size());
  for (const BackgroundRay& ray : background) ++num_rays[ray.vertex];
  for (std::size_t v = 0; v < num_rays.size(); ++v) {
    if (num_rays[v] == 0) continue;
    for (const Index* c = triangulation.stars.begin(v); c != triangulation.stars.end(v); ++c)
      visit(*c, num_rays[v]);
  }
}

}  // namespace mesher
