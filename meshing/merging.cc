// SPDX-License-Identifier: GPL-3.0-or-later
#include "merging.h"

#include <algorithm>
#include <cmath>
#include <unordered_map>

namespace mesher {
namespace {

// Smaller than the rounding of coordinates between -1 and 1.
constexpr double kSmallestRadius = 1e-16;

// Distance of each vertex to the nearest camera that sees it; infinite without any.
std::vector<double> Ranges(const std::vector<Vec3>& points, const Rows& rays,
                           const std::vector<Vec3>& cameras) {
  std::vector<double> ranges(points.size(), HUGE_VAL);
  for (std::size_t v = 0; v < points.size(); ++v)
    for (const Index* camera = rays.begin(v); camera != rays.end(v); ++camera)
      ranges[v] = std::min(ranges[v], Norm(cameras[*camera] - points[v]));
  return ranges;
}

// Grids of points, by their radii: cubes with a power of two as the side length.
class Grid {
 public:
  // The index of a point in the grid that coincides with `point`, or kNone.
  Index Find(const Vec3& point, double radius, const std::vector<Vec3>& points,
             const std::vector<double>& radii) const {
    Index found = kNone;
    for (int level = std::ilogb(radius) - 1; level <= std::ilogb(radius) + 1; ++level) {
      const Cube low = CubeOf(point, level, -0.25), high = CubeOf(point, level, 0.25);
      for (auto x = low.x; x <= high.x; ++x)
        for (auto y = low.y; y <= high.y; ++y)
          for (auto z = low.z; z <= high.z; ++z)
            if (const auto cube = cubes_.find({x, y, z, level}); cube != cubes_.end())
              for (const Index other : cube->second)
                if (IsSame(Norm(points[other] - point), radius, radii[other]) &&
                    (found == kNone || other < found))
                  found = other;
    }
    return found;
  }

  void Add(const Vec3& point, double radius, Index index) {
    cubes_[CubeOf(point, std::ilogb(radius), 0)].push_back(index);
  }

 private:
  struct Cube {
    std::int64_t x, y, z;
    int level;
    bool operator==(const Cube& other) const {
      return x == other.x && y == other.y && z == other.z && level == other.level;
    }
  };
  struct Hash {
    std::size_t operator()(const Cube& cube) const {
      std::uint64_t hash = static_cast<std::uint64_t>(cube.level);
      for (const std::int64_t part : {cube.x, cube.y, cube.z})
        hash = (hash ^ static_cast<std::uint64_t>(part)) * 0x9E3779B97F4A7C15u;
      return hash ^ (hash >> 32);
    }
  };

  static bool IsSame(double distance, double a, double b) {
    return distance <= std::min(a, b) && std::max(a, b) <= 2 * std::min(a, b);
  }

  // The cube of a point, offset by a fraction of the side. A side is at least twice the radii of
  // its level, so a radius is at most half a side.
  static Cube CubeOf(const Vec3& p, int level, double moved) {
    const double side = std::ldexp(1.0, level + 3);
    auto cell = [&](double x) { return static_cast<std::int64_t>(std::floor(x / side + moved)); };
    return {cell(p.x), cell(p.y), cell(p.z), level};
  }

  std::unordered_map<Cube, std::vector<Index>, Hash> cubes_;
};

}  // namespace

std::vector<double> MergeRadii(const std::vector<Vec3>& points, const Rows& rays,
                               const std::vector<Vec3>& cameras, const Rows& polylines,
                               double factor) {
  const std::vector<double> ranges = Ranges(points, rays, cameras);
  std::vector<double> lengths;
  for (std::int64_t row = 0; row < polylines.size(); ++row)
    for (const Index* v = polylines.begin(row); v + 1 < polylines.end(row); ++v) {
      const double length =
          Norm(points[v[1]] - points[v[0]]) / std::min(ranges[v[0]], ranges[v[1]]);
      if (length > 0) lengths.push_back(length);
    }
  std::vector<double> radii(points.size(), 0);
  if (lengths.empty()) return radii;
  const auto median = lengths.begin() + lengths.size() / 2;
  std::nth_element(lengths.begin(), median, lengths.end());
  for (const Index v : polylines.values)
    if (std::isfinite(ranges[v])) radii[v] = factor * *median * ranges[v];
  return radii;
}

std::vector<Index> Representatives(const std::vector<Vec3>& points,
                                   const std::vector<double>& radii) {
  std::vector<Index> representatives(points.size());
  Grid grid;
  for (Index v = 0; v < static_cast<Index>(points.size()); ++v) {
    representatives[v] = v;
    if (radii[v] < kSmallestRadius) continue;
    const Index same = grid.Find(points[v], radii[v], points, radii);
    if (same == kNone)
      grid.Add(points[v], radii[v], v);
    else
      representatives[v] = same;
  }
  return representatives;
}

}  // namespace mesher
