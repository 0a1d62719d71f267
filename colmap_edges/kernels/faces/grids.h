// Views as grids of cells, in which the faces of a scene are labelled, and planes seen in them.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "common/geometry.h"
#include "common/vectors.h"

namespace colmap_edges {

constexpr double kNearer = 1.02;  // ratio of depths from which one surface stands before another

struct Plane {
  Vec3 normal;    // length 1
  double offset;  // normal . x = offset

  double Distance(const Vec3& point) const { return Dot(normal, point) - offset; }
  // Depth at which a ray, one unit deep, meets the plane; NaN behind the view or nearly along it.
  double DepthAlong(const Vec3& center, const Vec3& ray) const {
    const double slope = Dot(normal, ray);
    if (std::abs(slope) < 1e-6 * Norm(ray)) return NAN;
    const double depth = -Distance(center) / slope;
    return depth > 0 ? depth : NAN;
  }
};

// A view as a small undistorted picture, of which each cell is kCellPx pixels wide and high.
struct FaceView {
  static constexpr int kCellPx = 4;

  PinholeView pose;  // focal length in pixels of the small picture
  Vec2 principal;    // pixel, the corner of the picture is (0, 0)
  int32_t columns = 0, rows = 0;
  const uint8_t* gray = nullptr;  // (4 rows, 4 columns), 0 outside the image
  // (rows, columns) depth of what cells show that is no plane: of a round body, infinity of the
  // background; NaN where none is known.
  const float* shown = nullptr;

  int32_t num_cells() const { return columns * rows; }
  int32_t width() const { return columns * kCellPx; }
  int32_t height() const { return rows * kCellPx; }

  // World direction through a pixel, one unit deep.
  Vec3 RayThrough(Vec2 pixel) const {
    const Vec2 undistorted = pixel - principal;
    return pose.RotateBack({undistorted.x / pose.focal_px, undistorted.y / pose.focal_px, 1});
  }
  Vec2 CellCenter(int32_t cell) const {
    return {(cell % columns + 0.5) * kCellPx, (cell / columns + 0.5) * kCellPx};
  }
  bool IsBackground(int32_t cell) const { return std::isinf(shown[cell]); }
  // Whether a round body is shown before a depth, or nothing but background.
  bool Hides(int32_t cell, double depth) const {
    return IsBackground(cell) || kNearer * shown[cell] < depth;
  }
  Vec3 RayOfCell(int32_t cell) const { return RayThrough(CellCenter(cell)); }
  // Where a cell is sampled: its centre, at the picture's border its outer side, so that samples
  // span the picture.
  Vec2 CellSample(int32_t cell) const {
    const auto at = [](int32_t i, int32_t count) {
      return kCellPx * (i == 0 ? 0.02 : i == count - 1 ? count - 0.02 : i + 0.5);
    };
    return {at(cell % columns, columns), at(cell / columns, rows)};
  }

  // Pixel and depth of a world point; false behind the view or outside its picture.
  bool Project(const Vec3& point, Vec2* pixel, double* depth) const {
    return ProjectLocal(pose.FromWorld(point), pixel, depth);
  }
  // The same of a point in the coordinates of the view.
  bool ProjectLocal(const Vec3& p, Vec2* pixel, double* depth) const {
    if (!(p.z > 0)) return false;
    *depth = p.z;
    *pixel = {pose.focal_px * p.x / p.z + principal.x, pose.focal_px * p.y / p.z + principal.y};
    return pixel->x >= 0 && pixel->y >= 0 && pixel->x < width() && pixel->y < height();
  }
  // The vector whose product with (x, y, 1) is the inverse of a plane's depth in pixel (x, y).
  Vec3 InverseDepthOf(const Plane& plane) const {
    const Vec3 normal = (-1 / plane.Distance(pose.center)) * pose.Rotate(plane.normal);
    const double f = pose.focal_px;
    return {normal.x / f, normal.y / f,
            normal.z - (normal.x * principal.x + normal.y * principal.y) / f};
  }
  int32_t CellAt(Vec2 pixel) const {
    return int32_t(pixel.y / kCellPx) * columns + int32_t(pixel.x / kCellPx);
  }
};

// The part of a plane within which what is known of it lies: a polygon of few sides, as bounds of
// the places' components in some directions.
struct Extent {
  std::vector<Vec3> directions;
  std::vector<double> low, high;

  bool Holds(const Vec3& point) const {
    for (size_t i = 0; i < directions.size(); ++i) {
      const double at = Dot(directions[i], point);
      if (at < low[i] || at > high[i]) return false;
    }
    return true;
  }
};

// Points with the views that observe them, and the planes that they lie on, in rows by point.
struct FacePoints {
  std::vector<Vec3> points;
  std::vector<int64_t> plane_offsets;
  std::vector<int32_t> planes;  // ascending within a point
};

}  // namespace colmap_edges
