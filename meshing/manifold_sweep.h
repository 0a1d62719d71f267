// SPDX-License-Identifier: GPL-3.0-or-later
// Free space whose boundary is a 2-manifold.
#pragma once

#include <cstdint>
#include <vector>

#include "triangulation.h"

namespace mesher {

struct ManifoldRegion {
  std::vector<std::uint8_t> is_free;
  Index cells_closed = 0;  // free by votes, but solid in the region
  Index cells_opened = 0;  // solid by votes, but free in the region
};

// A region of free cells whose boundary is a 2-manifold and that differs little from the cells with
// votes >= 0. `votes` are relative to the threshold.
//
// Growing a region cell by cell from the most voted one (Litvinov & Lhuillier 2013, Romanoni &
// Matteucci 2015) keeps a manifold at every step, but stops at the many vertices where voted
// cells touch only in a vertex or along an edge. This sweep starts from all voted cells and repairs
// these critical vertices: of the fans of free (or of solid) cells around a vertex, connected
// through facets, the one with the least opposing votes changes its label as a whole, until one fan
// of each remains. This can make neighboring vertices critical, which are repaired in turn.
// Changing labels repeatedly costs votes, and cells stay solid after `kMaxFlips` changes, so the
// repair ends. Then single cells change to the label of their votes, as long as the boundary stays
// a manifold.
ManifoldRegion SweepManifold(const Triangulation& triangulation, const std::vector<double>& votes);

// Whether the cells around a vertex inside and outside `region` each form at most one component
// connected through facets, so that the boundary is a disk there.
bool IsRegular(const Triangulation& triangulation, const std::vector<std::uint8_t>& region,
               Index vertex);

}  // namespace mesher
