// SPDX-License-Identifier: GPL-3.0-or-later
// What the rays between points and cameras say about each cell: free space or solid.
#pragma once

#include "min_cut.h"
#include "triangulation.h"

namespace mesher {

struct VisibilityOptions {
  double sigma_factor = 1;         // softness of a point's depth, in units of the spacing of points
  double quality_weight = 0.1;     // weight of well-shaped surfaces against one ray
  double edge_solid_weight = 0.7;  // of the solid behind an edge point, against that behind others
  double background_weight = 16;   // of a ray to the background against one to a point
  int num_threads = 1;
};

// Unit of the whole-number weights: one ray.
constexpr std::int64_t kRayWeight = 1 << 20;

// Length that a quarter of the triangulation's edges fall short of.
double TypicalSpacing(const Triangulation& triangulation);

// Soft visibility (Labatut et al. 2009) and surface quality as a minimum cut problem. Row v of
// `rays` holds the cameras that see vertex v; none of them may coincide with the vertex. What lies
// behind a point is taken for solid; edge_solid_weight says how much for vertices with is_edge set,
// since a ray that grazes an occluding edge goes on through free space on one side of it.
CutProblem VisibilityProblem(const Triangulation& triangulation, const Rows& rays,
                             const std::vector<Vec3>& cameras,
                             const std::vector<std::uint8_t>& is_edge,
                             const std::vector<BackgroundRay>& background,
                             const VisibilityOptions& options);

}  // namespace mesher
