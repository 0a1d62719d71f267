// SPDX-License-Identifier: GPL-3.0-or-later
// Exact signs, for cases that floating point cannot decide.
#pragma once

#include "types.h"

namespace mesher {

// Sign of det(b - a, c - a, d - a).
int Orientation(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d);

// The same with b moved by an infinitesimal (e, e^2, e^3): zero only if a, c and d are collinear.
int PerturbedOrientation(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d);

}  // namespace mesher
