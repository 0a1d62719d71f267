// Points of surfaces in blocks of near ones, and the sets of them that lie on planes, as bits.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <numeric>
#include <tuple>
#include <vector>

#include "common/vectors.h"
#include "faces/grids.h"

namespace colmap_edges {

// Points with what is known of them; the rays are as long as the deviation along them.
struct PlaneEvidence {
  const double *points = nullptr, *tangents = nullptr, *rays = nullptr;  // (N, 3)
  const double* sigmas = nullptr;                                        // (N) across the rays
  int64_t count = 0;
};

// Sets of points are as many words as there are blocks; a block has a bit for each of its points.
using PointSet = std::vector<uint64_t>;

// Calls visit(i) for each point i of a set, ascending.
template <typename Visit>
void VisitPoints(const uint64_t* words, size_t num_words, const Visit& visit) {
  for (size_t b = 0; b < num_words; ++b)
    for (uint64_t word = words[b]; word; word &= word - 1)
      visit(b * 64 + size_t(__builtin_ctzll(word)));
}

class PlanePoints {
 public:
  // The given arrays must outlive the object.
  PlanePoints(const PlaneEvidence& given, double max_slope)
      : given_(given), squared_slope_(max_slope * max_slope), order_(given.count) {
    std::iota(order_.begin(), order_.end(), 0);
    Split(0, given.count);
    for (size_t first = 0; first < order_.size(); first += 64)
      blocks_.push_back(MakeBlock(first, std::min(first + 64, order_.size())));
  }

  size_t size() const { return order_.size(); }
  size_t num_blocks() const { return blocks_.size(); }
  // The given point that is at a place of the blocks.
  int64_t given(size_t i) const { return order_[i]; }
  Vec3 point(size_t i) const { return At(given_.points, i); }
  // Squared standard deviation of a point's distance from a plane.
  double Variance(size_t i, const Vec3& normal) const {
    const double along = Dot(normal, At(given_.rays, i)), sigma = given_.sigmas[order_[i]];
    return sigma * sigma + along * along;
  }

  // Writes which points, and their tangents, lie on a plane, by a tolerance in deviations.
  void FindOn(const Plane& plane, double tolerance, uint64_t* words) const {
    for (size_t b = 0; b < blocks_.size(); ++b) {
      const Block& block = blocks_[b];
      const double off = std::abs(plane.Distance(block.center)) - Extent(block.half, plane.normal);
      words[b] = off > Margin(block, plane.normal, tolerance) ? 0 : WordOf(block, plane, tolerance);
    }
  }

  // Calls visit(i, normal . x) for all points, with tangents along them, near parallel planes
  // between two offsets, and perhaps for some farther away.
  template <typename Visit>
  void VisitNear(const Vec3& normal, double low, double high, double tolerance,
                 const Visit& visit) const {
    for (size_t b = 0; b < blocks_.size(); ++b) {
      const Block& block = blocks_[b];
      const double middle = Dot(normal, block.center), margin = Margin(block, normal, tolerance);
      const double reach = Extent(block.half, normal) + margin;
      if (middle + reach < low || middle - reach > high) continue;
      for (size_t i = 64 * b; i < std::min(64 * (b + 1), order_.size()); ++i) {
        const double at = Dot(normal, point(i));
        const double rise = Dot(normal, At(given_.tangents, i));
        if (at >= low - margin && at <= high + margin && rise * rise <= squared_slope_)
          visit(i, at);
      }
    }
  }

 private:
  // What is known of 64 points, in single precision, from the centre of their box.
  struct Block {
    Vec3 center, half, ray_center, ray_half;  // boxes of the points and of the rays
    double max_sigma = 0;
    float points[3][64], rays[3][64], tangents[3][64], squared_sigmas[64];
  };

  Vec3 At(const double* vectors, size_t i) const {
    const double* v = vectors + 3 * order_[i];
    return {v[0], v[1], v[2]};
  }

  // Maximum distance from a plane of points of a block that lie on it.
  double Margin(const Block& block, const Vec3& normal, double tolerance) const {
    const double along = std::abs(Dot(normal, block.ray_center)) + Extent(block.ray_half, normal);
    return tolerance * std::sqrt(block.max_sigma * block.max_sigma + along * along);
  }
  static double Extent(const Vec3& half, const Vec3& normal) {
    return std::abs(normal.x) * half.x + std::abs(normal.y) * half.y + std::abs(normal.z) * half.z;
  }

  void Enclose(const double* vectors, size_t first, size_t last, Vec3* low, Vec3* high) const {
    *low = *high = At(vectors, first);
    for (size_t i = first + 1; i < last; ++i) {
      const Vec3 at = At(vectors, i);
      for (int k = 0; k < 3; ++k)
        (*low)[k] = std::min((*low)[k], at[k]), (*high)[k] = std::max((*high)[k], at[k]);
    }
  }

  // Orders a range so that blocks are compact: halves, of whole blocks, of the longest side.
  void Split(size_t first, size_t last) {
    const size_t half = 64 * ((last - first + 127) / 128);
    if (half >= last - first) return;
    Vec3 low, high;
    Enclose(given_.points, first, last, &low, &high);
    const Vec3 sides = high - low;
    const int axis = sides.x >= sides.y && sides.x >= sides.z ? 0 : sides.y >= sides.z ? 1 : 2;
    const auto before = [&](int64_t a, int64_t b) {
      const double one = given_.points[3 * a + axis], other = given_.points[3 * b + axis];
      return one != other ? one < other : a < b;
    };
    std::nth_element(order_.begin() + first, order_.begin() + first + half, order_.begin() + last,
                     before);
    Split(first, first + half);
    Split(first + half, last);
  }

  Block MakeBlock(size_t first, size_t last) const {
    Block block;
    Vec3 low, high;
    Enclose(given_.points, first, last, &low, &high);
    block.center = 0.5 * (low + high), block.half = (0.5 + 1e-6) * (high - low);
    Enclose(given_.rays, first, last, &low, &high);
    block.ray_center = 0.5 * (low + high), block.ray_half = (0.5 + 1e-6) * (high - low);
    for (size_t j = 0; j < 64; ++j) {
      const size_t i = std::min(first + j, last - 1);
      const Vec3 off = point(i) - block.center, ray = At(given_.rays, i);
      const Vec3 tangent = At(given_.tangents, i);
      const double sigma = given_.sigmas[order_[i]];
      for (int k = 0; k < 3; ++k) {
        block.points[k][j] = float(off[k]), block.rays[k][j] = float(ray[k]);
        block.tangents[k][j] = float(tangent[k]);
      }
      block.squared_sigmas[j] = float(sigma * sigma);
      block.max_sigma = std::max(block.max_sigma, sigma);
    }
    for (size_t j = last - first; j < 64; ++j) {  // no plane is near what fills the last block
      for (int k = 0; k < 3; ++k) block.rays[k][j] = 0;
      block.squared_sigmas[j] = -1;
    }
    return block;
  }

  uint64_t WordOf(const Block& block, const Plane& plane, double tolerance) const {
    const float x = float(plane.normal.x), y = float(plane.normal.y), z = float(plane.normal.z);
    const float place = float(-plane.Distance(block.center));
    const float squared = float(tolerance * tolerance), slope = float(squared_slope_);
    const auto& [points, rays, tangents] = std::tie(block.points, block.rays, block.tangents);
    uint8_t on[64];
    for (int i = 0; i < 64; ++i) {
      const float off = x * points[0][i] + y * points[1][i] + z * points[2][i] - place;
      const float along = x * rays[0][i] + y * rays[1][i] + z * rays[2][i];
      const float rise = x * tangents[0][i] + y * tangents[1][i] + z * tangents[2][i];
      on[i] = (off * off <= squared * (along * along + block.squared_sigmas[i])) &
              (rise * rise <= slope);
    }
    uint64_t word = 0;
    for (int i = 0; i < 64; i += 8) {  // one multiplication gathers the bits of eight bytes
      uint64_t bytes;
      std::memcpy(&bytes, on + i, 8);
      word |= (bytes * 0x0102040810204080u >> 56) << i;
    }
    return word;
  }

  const PlaneEvidence given_;
  const double squared_slope_;
  std::vector<int64_t> order_;  // given points by block
  std::vector<Block> blocks_;
};

}  // namespace colmap_edges
