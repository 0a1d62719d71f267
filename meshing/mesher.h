// SPDX-License-Identifier: GPL-3.0-or-later
// Points and who sees them in, a surface out.
#pragma once

#include <array>
#include <map>
#include <string>
#include <vector>

#include "surface.h"
#include "types.h"
#include "visibility.h"

namespace mesher {

struct MesherInput {
  std::vector<Vec3> points;
  Rows visibility;  // point -> cameras
  std::vector<Vec3> cameras;
};

struct MesherOptions {
  std::string method = "graphcut";
  VisibilityOptions visibility;
  SurfaceOptions surface;
};

struct MesherResult {
  std::vector<Vec3> vertices;
  std::vector<std::array<Index, 3>> faces;
  // Indices of the input points that a vertex lies at (twice the same) or between.
  std::vector<std::array<Index, 2>> sources;
  std::map<std::string, double> stats;
};

// An empty result without cells (`stats`) if the points span no volume. Throws
// std::invalid_argument for malformed input.
MesherResult MeshPoints(const MesherInput& input, const MesherOptions& options);

}  // namespace mesher
