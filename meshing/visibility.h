// SPDX-License-Identifier: GPL-3.0-or-later
// Votes of the rays between points and cameras for labelling cells free or solid.
#pragma once

#include "min_cut.h"
#include "triangulation.h"

namespace mesher {

struct VisibilityOptions {
  double sigma_factor = 1;      // sigma of a point's depth, in units of the spacing of points
  double quality_weight = 0.1;  // weight of the surface quality relative to one ray
  double edge_solid_weight =
      0.7;  // of the solid cell behind an edge point, relative to other points
  double background_weight = 16;  // of a background ray, relative to a ray to a point
  int num_threads = 1;
};

// Unit of the integer weights: one ray.
constexpr std::int64_t kRayWeight = 1 << 20;

// Lower quartile of the lengths of the triangulation's edges.
double TypicalSpacing(const Triangulation& triangulation);

// Number of rays that each ray represents far from its point; 0 for rays represented by another.
// Rays from nearby edge points to the same camera cross nearly the same cells there. The first of
// the edge points in a cube of a grid with this side represents all that the camera sees there;
// rays of other points represent themselves.
std::vector<Index> FarWeights(const std::vector<Vec3>& points,
                              const std::vector<std::uint8_t>& is_edge, const Rows& rays,
                              std::size_t num_cameras, double side);

// Soft visibility (Labatut et al. 2009) and surface quality as a minimum cut problem. Row v of
// `rays` holds the cameras that see vertex v; none of them may coincide with the vertex. The cell
// behind a point is solid, with the weight edge_solid_weight for vertices with is_edge set, since a
// ray that grazes an occluding edge continues through free space on one side of it.
CutProblem VisibilityProblem(const Triangulation& triangulation, const Rows& rays,
                             const std::vector<Vec3>& cameras,
                             const std::vector<std::uint8_t>& is_edge,
                             const std::vector<BackgroundRay>& background,
                             const VisibilityOptions& options);

}  // namespace mesher
