// SPDX-License-Identifier: GPL-3.0-or-later
// Replaces badly shaped triangles of a mesh within the noise of its points.
#pragma once

#include "editing.h"
#include "refinement.h"

namespace mesher {

struct ShapingOptions {
  double min_angle;   // in radians; triangles with a smaller angle are replaced
  double max_sigmas;  // points stay within this number of their deviations of the surface
  double max_turn;    // in radians, by which faces may turn from their neighbours, besides by noise
  double turn_sigmas;  // number of deviations of normals that are noise
};

// Swaps sides, collapses vertices onto neighbours and inserts vertices into needles, as long as it
// lowers the sum over faces of the square of
//
//   max(0, 1 - sin(smallest angle) / sin(2 min_angle)).
//
// Vertices that are left out stay within their noise of the surface, and those of creases and
// borders of these lines; so do the midpoints of the sides that are replaced. Creases are not
// swapped, and end where they did. No face turns over or passes through another one; none turns
// farther from those around the change than faces did before, unless noise explains it. The
// topology stays, and so do vertices without information and those where sheets of the surface
// touch.
//
// Throws std::invalid_argument for faces, creases or information that do not fit the vertices.
EditedMesh Shape(const RefinementInput& input, const ShapingOptions& options, int num_threads);

}  // namespace mesher
