// SPDX-License-Identifier: GPL-3.0-or-later
// Free space whose boundary is a manifold by construction.
#pragma once

#include <cstdint>
#include <vector>

#include "triangulation.h"

namespace mesher {

// Grows a region of free cells from the one with the most votes (Litvinov & Lhuillier 2013,
// Romanoni & Matteucci 2015): cell by cell, the most voted first, as long as the boundary stays a
// 2-manifold; where that is stuck, all free cells around a vertex at once, which lets the region
// change its genus; then cell by cell again. When nothing grows any more, the next region starts
// from the most voted free cell that touches none. Returns 1 for the cells of the regions.
std::vector<std::uint8_t> GrowManifold(const Triangulation& triangulation,
                                       const std::vector<double>& votes,
                                       const std::vector<std::uint8_t>& is_free);

// Whether the cells around a vertex that are in `region`, and those that are not, each form at most
// one component connected through facets: then its boundary is a disk there.
bool IsRegular(const Triangulation& triangulation, const std::vector<std::uint8_t>& region,
               Index vertex);

}  // namespace mesher
