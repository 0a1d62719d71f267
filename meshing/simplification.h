// SPDX-License-Identifier: GPL-3.0-or-later
// Simplifies a mesh: fewer faces where it is flat, creases kept.
#pragma once

#include <vector>

#include "editing.h"

namespace mesher {

// Collapses vertices onto neighbours, those first that change the surface least, until at most
// `max_faces` faces are left, or none can be collapsed. The error of a vertex is the weighted sum
// of squared distances from the planes of the faces that it replaces, from these faces, and from
// their creases and borders (Garland, Heckbert 1997; Trettner, Kobbelt 2020).
//
// Vertices stay where they were. Those of creases and borders are collapsed along these lines only,
// at a high cost where they leave points of them, and lines stay connected where they branch. No
// face turns over or passes through another one. The topology stays, and so do vertices where
// sheets of the surface touch.
//
// Throws std::invalid_argument for faces or creases that do not fit the vertices.
EditedMesh Simplify(const std::vector<Vec3>& vertices, const std::vector<Face>& faces,
                    const std::vector<std::array<Index, 2>>& creases, std::size_t max_faces,
                    int num_threads);

}  // namespace mesher
