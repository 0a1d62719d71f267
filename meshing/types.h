// SPDX-License-Identifier: GPL-3.0-or-later
// Small value types used by all parts of the mesher.
#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

namespace mesher {

using Index = std::int32_t;

// The vertex at infinity that closes the triangulation around its convex hull.
constexpr Index kInfinite = -1;
constexpr Index kNone = -1;

struct Vec3 {
  double x = 0, y = 0, z = 0;

  double& operator[](int axis) { return axis == 0 ? x : axis == 1 ? y : z; }
  double operator[](int axis) const { return axis == 0 ? x : axis == 1 ? y : z; }
};

inline Vec3 operator+(const Vec3& a, const Vec3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec3 operator-(const Vec3& a, const Vec3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec3 operator*(double s, const Vec3& a) { return {s * a.x, s * a.y, s * a.z}; }
inline bool operator==(const Vec3& a, const Vec3& b) {
  return a.x == b.x && a.y == b.y && a.z == b.z;
}
inline bool operator<(const Vec3& a, const Vec3& b) {
  return a.x != b.x ? a.x < b.x : a.y != b.y ? a.y < b.y : a.z < b.z;
}
inline double Dot(const Vec3& a, const Vec3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vec3 Cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline double Norm(const Vec3& a) { return std::sqrt(Dot(a, a)); }
inline bool IsFinite(const Vec3& a) {
  return std::isfinite(a.x) && std::isfinite(a.y) && std::isfinite(a.z);
}

// Rows of different lengths in one array: row i is values[offsets[i] : offsets[i + 1]].
struct Rows {
  std::vector<std::int64_t> offsets{0};
  std::vector<Index> values;

  std::int64_t size() const { return static_cast<std::int64_t>(offsets.size()) - 1; }
  const Index* begin(std::int64_t row) const { return values.data() + offsets[row]; }
  const Index* end(std::int64_t row) const { return values.data() + offsets[row + 1]; }
  std::int64_t length(std::int64_t row) const { return offsets[row + 1] - offsets[row]; }
};

}  // namespace mesher
