// SPDX-License-Identifier: GPL-3.0-or-later
#include "predicates.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>

namespace mesher {
namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;

// Sign of component `axis` of (c - a) x (d - a).
int NormalSign(const Vec3& a, const Vec3& c, const Vec3& d, int axis) {
  const int u = (axis + 1) % 3, v = (axis + 2) % 3;
  return CGAL::orientation(Kernel::Point_2(a[u], a[v]), Kernel::Point_2(c[u], c[v]),
                           Kernel::Point_2(d[u], d[v]));
}

}  // namespace

int Orientation(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  // As where rays end at a vertex: exact arithmetic would take a fifth of the time of the rays.
  if (a == b || a == c || a == d || b == c || b == d || c == d) return 0;
  return CGAL::orientation(Kernel::Point_3(a.x, a.y, a.z), Kernel::Point_3(b.x, b.y, b.z),
                           Kernel::Point_3(c.x, c.y, c.z), Kernel::Point_3(d.x, d.y, d.z));
}

// det(b + h - a, c - a, d - a) = det(b - a, c - a, d - a) + h . ((c - a) x (d - a)).
int PerturbedOrientation(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  int sign = Orientation(a, b, c, d);
  for (int axis = 0; sign == 0 && axis < 3; ++axis) sign = NormalSign(a, c, d, axis);
  return sign;
}

}  // namespace mesher
