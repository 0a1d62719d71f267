// SPDX-License-Identifier: GPL-3.0-or-later
// Extraction of an oriented, manifold triangle surface from free and solid cells.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "triangulation.h"

namespace mesher {

struct SurfaceOptions {
  double long_facet_factor = 0.5;  // facets with a longer side, in ranges of their vertices, are
                                   // dropped; facets that face no camera sooner; 0 keeps all
  Index min_component_faces = 1;   // smaller connected components are dropped
};

struct SurfaceStats {
  Index boundary_facets = 0;
  Index long_facets_dropped = 0;
  Index component_faces_dropped = 0;
  Index vertices_split = 0;  // vertices duplicated where several sheets of the surface touched
  Index edges_split = 0;     // midpoints added for the same reason
};

// A vertex lies at a vertex of the triangulation (twice the same) or midway between two.
struct Surface {
  std::vector<std::array<Index, 2>> vertices;
  std::vector<std::array<Index, 3>> faces;
  SurfaceStats stats;
};

// How the vertices are seen: the cameras of each, and its viewing distance.
struct Sight {
  const Rows& rays;
  const std::vector<Vec3>& cameras;
  const std::vector<double>& ranges;
};

// The facets between free and solid cells, with normals towards free space. Where solid cells touch
// along an edge or in a vertex only, vertices are duplicated, which does not change the shape:
// every edge has one or two faces, and the faces around a vertex form one fan or one disk.
//
// The shortest viewing distance of a facet's vertices counts.
Surface ExtractSurface(const Triangulation& triangulation, const std::vector<std::uint8_t>& is_free,
                       const Sight& sight, const SurfaceOptions& options);

}  // namespace mesher
