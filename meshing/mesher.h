// SPDX-License-Identifier: GPL-3.0-or-later
// The mesher: takes points and the cameras that see them, returns a surface.
#pragma once

#include <array>
#include <map>
#include <string>
#include <vector>

#include "free_space.h"
#include "surface.h"
#include "types.h"
#include "visibility.h"

namespace mesher {

struct MesherInput {
  std::vector<Vec3> points;
  Rows visibility;  // point -> cameras
  std::vector<Vec3> cameras;
  Rows polylines;  // rows of points that the mesh should follow
  // Background rays, which pass through free space only: camera and direction of each.
  std::vector<Index> background_cameras;
  std::vector<Vec3> background_directions;
};

struct MesherOptions {
  std::string method = "graphcut";  // or "carve" or "manifold"
  // Radius within which points of polylines are merged, in typical segments at their distance.
  double merge_factor = 0.05;
  // Minimum length of split segments of polylines, in median lengths; 0 disables splitting.
  double min_segment_factor = 0.25;
  VisibilityOptions visibility;  // of graphcut
  VoteOptions votes;             // of carve and manifold
  SurfaceOptions surface;
};

struct MesherResult {
  std::vector<Vec3> vertices;
  std::vector<std::array<Index, 3>> faces;
  std::vector<Index> sources;  // input point of each vertex; kNone for added ones
  // Edges of the mesh that lie on polylines: two vertices, and the first polyline of theirs.
  std::vector<std::array<Index, 3>> edges;
  std::map<std::string, double> stats;
};

// An empty result without cells (`stats`) if the points span no volume. Throws
// std::invalid_argument for malformed input.
MesherResult MeshPoints(const MesherInput& input, const MesherOptions& options);

}  // namespace mesher
