// Depths of a mesh along rays of a view.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

// Inverse depths of the nearest triangle along rays (x, y, 1) of a view, and its number in the
// order of adding; 0 and -1 where there is none.
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
    cells_.resize(size_t(columns_) * rows_);
    for (size_t i = 0; i < rays.size(); ++i)
      cells_[size_t(Row(rays[i].y)) * columns_ + Column(rays[i].x)].push_back(int32_t(i));
  }

  // Adds a triangle with these corners in the coordinates of the view.
  void Add(const Vec3& a, const Vec3& b, const Vec3& c) {
    const int32_t face = num_added_++;
    const int before = (a.z > 0) + (b.z > 0) + (c.z > 0);
    if (before == 0) return;
    const std::array<Vec3, 3> sides{Cross(b, c), Cross(c, a), Cross(a, b)};
    const double volume = Dot(a, sides[0]);
    if (volume == 0) return;
    int first[2] = {0, 0}, last[2] = {columns_ - 1, rows_ - 1};
    if (before == 3) {
      const auto [left, right] = std::minmax({a.x / a.z, b.x / b.z, c.x / c.z});
      const auto [top, bottom] = std::minmax({a.y / a.z, b.y / b.z, c.y / c.z});
      if (right < low_.x || bottom < low_.y || left > low_.x + columns_ * side_ ||
          top > low_.y + rows_ * side_)
        return;
      first[0] = Column(left), first[1] = Row(top), last[0] = Column(right), last[1] = Row(bottom);
    }
    for (int row = first[1]; row <= last[1]; ++row)
      for (int column = first[0]; column <= last[0]; ++column)
        for (const int32_t i : cells_[size_t(row) * columns_ + column])
          Meet(i, face, sides, volume);
  }

  const std::vector<double>& inverse() const { return inverse_; }
  const std::vector<int32_t>& faces() const { return faces_; }

 private:
  int Column(double x) const { return int(std::clamp((x - low_.x) / side_, 0., columns_ - 1.)); }
  int Row(double y) const { return int(std::clamp((y - low_.y) / side_, 0., rows_ - 1.)); }

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
  int32_t num_added_ = 0;
  Vec2 low_;
  double side_ = 1;
  int columns_ = 1, rows_ = 1;
  std::vector<std::vector<int32_t>> cells_;
};

}  // namespace colmap_edges
