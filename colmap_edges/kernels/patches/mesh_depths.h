// Depths of a mesh along rays of a view.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

// Inverse depths of the nearest triangle along rays (x, y, 1) of a view, and its number; 0 and -1
// where there is none.
class MeshDepths {
 public:
  explicit MeshDepths(const std::vector<Vec2>& rays)
      : rays_(rays), inverse_(rays.size(), 0), faces_(rays.size(), -1) {
    Vec2 high = rays[0];
    low_ = rays[0];
    for (const Vec2& ray : rays) {
      low_ = {std::min(low_.x, ray.x), std::min(low_.y, ray.y)};
      high = {std::max(high.x, ray.x), std::max(high.y, ray.y)};
    }
    const double most = std::max({high.x - low_.x, high.y - low_.y, 1e-9});
    side_ = most / std::clamp(std::sqrt(double(rays.size())), 1., 200.);
    columns_ = int((high.x - low_.x) / side_) + 1, rows_ = int((high.y - low_.y) / side_) + 1;
    const auto cell_of = [&](const Vec2& ray) {
      return size_t(Within((ray.y - low_.y) / side_, rows_)) * columns_ +
             Within((ray.x - low_.x) / side_, columns_);
    };
    starts_.resize(size_t(columns_) * rows_ + 1), order_.resize(rays.size());
    for (const Vec2& ray : rays) ++starts_[cell_of(ray) + 1];
    std::partial_sum(starts_.begin(), starts_.end(), starts_.begin());
    std::vector<int32_t> next = starts_;
    for (size_t i = 0; i < rays.size(); ++i) order_[next[cell_of(rays[i])]++] = int32_t(i);
  }

  // Adds the triangles with these corners among points in the coordinates of the view, (F, 3).
  void Add(const std::vector<Vec3>& points, const int32_t* corners, size_t num_faces) {
    std::vector<Vec2> places(points.size());  // where the points are on the grid
    for (size_t i = 0; i < points.size(); ++i) {
      const Vec3& p = points[i];
      places[i] = {(p.x / p.z - low_.x) / side_, (p.y / p.z - low_.y) / side_};
    }
    for (size_t f = 0; f < num_faces; ++f) {
      const int32_t* of = corners + 3 * f;
      const Vec3 &a = points[of[0]], &b = points[of[1]], &c = points[of[2]];
      const int before = (a.z > 0) + (b.z > 0) + (c.z > 0);
      if (before == 0) continue;
      int first[2] = {0, 0}, last[2] = {columns_ - 1, rows_ - 1};
      if (before == 3) {
        const Vec2 &i = places[of[0]], &j = places[of[1]], &k = places[of[2]];
        const double left = std::min({i.x, j.x, k.x}), right = std::max({i.x, j.x, k.x});
        const double top = std::min({i.y, j.y, k.y}), bottom = std::max({i.y, j.y, k.y});
        if (right < 0 || bottom < 0 || left > columns_ || top > rows_) continue;
        first[0] = Within(left, columns_), first[1] = Within(top, rows_);
        last[0] = Within(right, columns_), last[1] = Within(bottom, rows_);
      }
      Add(int32_t(f), {a, b, c}, first, last);
    }
  }

  const std::vector<double>& inverse() const { return inverse_; }
  const std::vector<int32_t>& faces() const { return faces_; }

 private:
  static int Within(double place, int count) { return int(std::clamp(place, 0., count - 1.)); }

  // Compares a triangle with the rays of a range of cells.
  void Add(int32_t face, const std::array<Vec3, 3>& corners, const int first[2],
           const int last[2]) {
    bool has_rays = false;
    for (int row = first[1]; row <= last[1]; ++row)
      has_rays |= starts_[size_t(row) * columns_ + first[0]] !=
                  starts_[size_t(row) * columns_ + last[0] + 1];
    if (!has_rays) return;
    const auto& [a, b, c] = corners;
    const std::array<Vec3, 3> sides{Cross(b, c), Cross(c, a), Cross(a, b)};
    const double volume = Dot(a, sides[0]);
    if (volume == 0) return;
    for (int row = first[1]; row <= last[1]; ++row) {
      const size_t at = size_t(row) * columns_;
      for (int32_t i = starts_[at + first[0]]; i < starts_[at + last[0] + 1]; ++i)
        Meet(order_[i], face, sides, volume);
    }
  }

  void Meet(int32_t i, int32_t face, const std::array<Vec3, 3>& sides, double volume) {
    double sum = 0;
    for (const Vec3& side : sides) {
      const double share = (side.x * rays_[i].x + side.y * rays_[i].y + side.z) / volume;
      if (share < 0) return;
      sum += share;
    }
    if (sum > inverse_[i]) inverse_[i] = sum, faces_[i] = face;
  }

  const std::vector<Vec2>& rays_;
  std::vector<double> inverse_;
  std::vector<int32_t> faces_;
  Vec2 low_;
  double side_ = 1;
  int columns_ = 1, rows_ = 1;
  std::vector<int32_t> starts_, order_;  // rays by cells of the grid
};

}  // namespace colmap_edges
