// Projective geometry of pinhole views: rays, epipolar lines, triangulation.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "common/vectors.h"

namespace colmap_edges {

// A pinhole view in undistorted pixels: x_cam = R x_world + t, pixel = focal_px * (x, y) / z.
struct PinholeView {
  Mat3 R;  // cam_from_world
  Vec3 t;
  Vec3 center;
  double focal_px;

  Vec3 Rotate(const Vec3& v) const { return Multiply(R, v); }
  Vec3 RotateBack(const Vec3& v) const { return MultiplyTransposed(R, v); }
  Vec3 FromWorld(const Vec3& point) const { return Rotate(point) + t; }
  // Direction in the world, length 1, of the ray through an undistorted pixel.
  Vec3 Ray(Vec2 pixel) const {
    const Vec3 d = RotateBack({pixel.x, pixel.y, focal_px});
    return (1 / Norm(d)) * d;
  }
  // Writes the undistorted pixel of a world point; false behind the view.
  bool Project(const Vec3& point, Vec2* pixel) const {
    const Vec3 p = FromWorld(point);
    if (!(p.z > 0)) return false;
    *pixel = {focal_px * p.x / p.z, focal_px * p.y / p.z};
    return true;
  }
};

inline PinholeView MakePinholeView(const double* R, const double* t, double focal_px) {
  PinholeView view;
  std::copy(R, R + 9, view.R.begin());
  view.t = {t[0], t[1], t[2]};
  view.center = -1.0 * view.RotateBack(view.t);
  view.focal_px = focal_px;
  return view;
}

// Line a x + b y + c = 0 with a^2 + b^2 = 1.
struct Line2D {
  double a, b, c;
  double SignedDistance(Vec2 p) const { return a * p.x + b * p.y + c; }
  // Intersection with p-q, as a fraction in [0, 1); of two segments with a common end, one has it.
  bool Crosses(Vec2 p, Vec2 q, double* fraction) const {
    const double s0 = SignedDistance(p), s1 = SignedDistance(q);
    if ((s0 < 0) == (s1 < 0)) return false;
    *fraction = s0 / (s0 - s1);
    return true;
  }
};

struct Box2D {
  Vec2 min, max;
  void Include(Vec2 p) {
    min = {std::min(min.x, p.x), std::min(min.y, p.y)};
    max = {std::max(max.x, p.x), std::max(max.y, p.y)};
  }
  bool Contains(Vec2 p) const {
    return p.x >= min.x && p.x <= max.x && p.y >= min.y && p.y <= max.y;
  }
  bool Meets(const Box2D& other) const {
    return min.x <= other.max.x && max.x >= other.min.x && min.y <= other.max.y &&
           max.y >= other.min.y;
  }
  bool Meets(const Line2D& line) const {  // with a tolerance for rounding
    const Vec2 half = 0.5 * (max - min);
    return std::abs(line.SignedDistance(min + half)) <=
           std::abs(line.a) * half.x + std::abs(line.b) * half.y + 1e-6;
  }
};

// Epipolar line in `to` of a pixel in `from`; false where it is undefined (no baseline).
inline bool EpipolarLine(const PinholeView& from, const PinholeView& to, Vec2 pixel, Line2D* line) {
  const Vec3 direction = to.Rotate(from.Ray(pixel));
  const Vec3 epipole = to.FromWorld(from.center);
  const Vec3 n = Cross(epipole, direction);
  const double a = n.x, b = n.y, c = n.z * to.focal_px;
  const double norm = std::hypot(a, b);
  if (!(norm > 1e-12 * Norm(epipole))) return false;
  *line = {a / norm, b / norm, c / norm};
  return true;
}

// Solves the symmetric 3x3 system A x = b, A = (xx, xy, xz, yy, yz, zz); false when singular.
inline bool SolveSymmetric(const std::array<double, 6>& A, const Vec3& b, Vec3* x) {
  const double c00 = A[3] * A[5] - A[4] * A[4];
  const double c01 = A[2] * A[4] - A[1] * A[5];
  const double c02 = A[1] * A[4] - A[2] * A[3];
  const double det = A[0] * c00 + A[1] * c01 + A[2] * c02;
  const double scale = (A[0] + A[3] + A[5]) / 3;
  if (!(std::abs(det) > 1e-14 * scale * scale * scale)) return false;
  const double c11 = A[0] * A[5] - A[2] * A[2];
  const double c12 = A[1] * A[2] - A[0] * A[4];
  const double c22 = A[0] * A[3] - A[1] * A[1];
  *x = {(c00 * b.x + c01 * b.y + c02 * b.z) / det, (c01 * b.x + c11 * b.y + c12 * b.z) / det,
        (c02 * b.x + c12 * b.y + c22 * b.z) / det};
  return true;
}

// One observation of a point: a view and an undistorted pixel in it.
struct Sighting {
  const PinholeView* view;
  Vec2 pixel;
};

// Point nearest to all rays, relative to the first view's centre for accuracy.
inline bool TriangulateLinear(const Sighting* sightings, int count, Vec3* point) {
  if (count < 2) return false;
  const Vec3 origin = sightings[0].view->center;
  std::array<double, 6> A = {};
  Vec3 b;
  for (int i = 0; i < count; ++i) {
    const PinholeView& view = *sightings[i].view;
    const Vec3 d = view.Ray(sightings[i].pixel);
    const Vec3 c = view.center - origin;
    A[0] += 1 - d.x * d.x, A[1] -= d.x * d.y, A[2] -= d.x * d.z;
    A[3] += 1 - d.y * d.y, A[4] -= d.y * d.z, A[5] += 1 - d.z * d.z;
    b = b + (c - Dot(c, d) * d);
  }
  Vec3 x;
  if (!SolveSymmetric(A, b, &x)) return false;
  *point = x + origin;
  return true;
}

// Largest reprojection error in pixels; infinity when the point is behind one of the views.
// `worst` receives the index of its sighting.
inline double MaxReprojectionError(const Sighting* sightings, int count, const Vec3& point,
                                   int* worst = nullptr) {
  double largest = -1;
  for (int i = 0; i < count; ++i) {
    Vec2 pixel;
    double error = INFINITY;
    if (sightings[i].view->Project(point, &pixel)) error = Norm(pixel - sightings[i].pixel);
    if (error > largest) {
      largest = error;
      if (worst) *worst = i;
    }
  }
  return largest;
}

// Least-squares triangulation: linear start, then Gauss-Newton on reprojection errors. False if the
// rays are parallel or the point is behind a view.
inline bool Triangulate(const Sighting* sightings, int count, Vec3* point) {
  if (!TriangulateLinear(sightings, count, point)) return false;
  for (int iteration = 0; iteration < 10; ++iteration) {
    std::array<double, 6> A = {};
    Vec3 gradient;
    double px_per_unit = 0;
    for (int i = 0; i < count; ++i) {
      const PinholeView& view = *sightings[i].view;
      const Vec3 p = view.FromWorld(*point);
      if (!(p.z > 0)) return false;
      const double s = view.focal_px / p.z, u = p.x / p.z, v = p.y / p.z;
      px_per_unit = std::max(px_per_unit, s);
      const auto& R = view.R;
      const Vec3 jx = {s * (R[0] - u * R[6]), s * (R[1] - u * R[7]), s * (R[2] - u * R[8])};
      const Vec3 jy = {s * (R[3] - v * R[6]), s * (R[4] - v * R[7]), s * (R[5] - v * R[8])};
      const double rx = view.focal_px * u - sightings[i].pixel.x;
      const double ry = view.focal_px * v - sightings[i].pixel.y;
      A[0] += jx.x * jx.x + jy.x * jy.x, A[1] += jx.x * jx.y + jy.x * jy.y;
      A[2] += jx.x * jx.z + jy.x * jy.z, A[3] += jx.y * jx.y + jy.y * jy.y;
      A[4] += jx.y * jx.z + jy.y * jy.z, A[5] += jx.z * jx.z + jy.z * jy.z;
      gradient = gradient + rx * jx + ry * jy;
    }
    Vec3 step;
    if (!SolveSymmetric(A, gradient, &step)) return false;
    *point = *point - step;
    if (Norm(step) * px_per_unit < 1e-4) break;
  }
  for (int i = 0; i < count; ++i) {
    if (!(sightings[i].view->FromWorld(*point).z > 0)) return false;
  }
  return true;
}

}  // namespace colmap_edges
