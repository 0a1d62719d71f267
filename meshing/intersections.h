// SPDX-License-Identifier: GPL-3.0-or-later
// Intersections of the triangles of a mesh, and motions of its vertices that cause none.
#pragma once

#include <array>
#include <utility>
#include <vector>

#include "types.h"

namespace mesher {

using Faces3 = std::vector<std::array<Index, 3>>;

// The first vertex at the place of each one.
std::vector<Index> FirstAtPlace(const std::vector<Vec3>& vertices);

// Pairs of faces that share more than a vertex or a side, in ascending order. Exact; vertices at
// the same place are one vertex.
std::vector<std::pair<Index, Index>> Intersections(const Faces3& faces,
                                                   const std::vector<Vec3>& vertices,
                                                   int num_threads);

// Which groups of new faces would intersect other faces, one of their own, or those of a group
// before them. `groups` are those of the new faces, `replaced_by` of those that a group replaces,
// or kNone.
std::vector<char> Collisions(const Faces3& new_faces, const std::vector<Index>& groups,
                             const Faces3& faces, const std::vector<Index>& replaced_by,
                             const std::vector<Vec3>& vertices, int num_threads);

// Takes motions of vertices back, by halves and then whole, at faces that turn over (by more than
// 90 degrees) or intersect others after it. Faces that intersect before it stay as they are.
void TakeBack(const Faces3& faces, const std::vector<Vec3>& before, int num_threads,
              std::vector<Vec3>& after);

}  // namespace mesher
