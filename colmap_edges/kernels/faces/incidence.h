// Which points lie on which planes, and which views see the same points.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "faces/plane_points.h"

namespace colmap_edges {

template <typename Entry>
struct Rows {
  std::vector<int64_t> offsets{0};
  std::vector<Entry> entries;
};

// Planes, ascending, that each point and its tangent lie on, by a tolerance in deviations.
inline Rows<int32_t> PlanesOfPoints(const PlaneEvidence& given, const std::vector<Plane>& planes,
                                    double tolerance, double max_slope) {
  const size_t count = planes.size();
  std::vector<double> x(count), y(count), z(count), offsets(count);
  for (size_t k = 0; k < count; ++k) {
    x[k] = planes[k].normal.x, y[k] = planes[k].normal.y, z[k] = planes[k].normal.z;
    offsets[k] = planes[k].offset;
  }
  std::vector<uint8_t> on(count);
  Rows<int32_t> rows;
  for (int64_t i = 0; i < given.count; ++i) {
    const double *p = given.points + 3 * i, *r = given.rays + 3 * i, *t = given.tangents + 3 * i;
    const double px = p[0], py = p[1], pz = p[2], rx = r[0], ry = r[1], rz = r[2];
    const double tx = t[0], ty = t[1], tz = t[2];
    const double variance = given.sigmas[i] * given.sigmas[i], squared = tolerance * tolerance;
    for (size_t k = 0; k < count; ++k) {
      const double off = x[k] * px + y[k] * py + z[k] * pz - offsets[k];
      const double along = x[k] * rx + y[k] * ry + z[k] * rz;
      const double rise = x[k] * tx + y[k] * ty + z[k] * tz;
      on[k] = (off * off <= squared * (along * along + variance)) &
              (rise * rise <= max_slope * max_slope);
    }
    for (size_t k = 0; k < count; ++k)
      if (on[k]) rows.entries.push_back(int32_t(k));
    rows.offsets.push_back(int64_t(rows.entries.size()));
  }
  return rows;
}

// Of each view at most `most` views that see the most of the same points, the most first.
// offsets, views: tracks of the points; observed_offsets, observed: points that each view sees.
inline Rows<int32_t> NeighborsOf(const int64_t* offsets, const int32_t* views,
                                 const std::vector<int64_t>& observed_offsets,
                                 const int32_t* observed, size_t most) {
  const size_t num_views = observed_offsets.size() - 1;
  std::vector<int64_t> shared(num_views, 0);
  std::vector<int32_t> others;
  Rows<int32_t> rows;
  for (size_t v = 0; v < num_views; ++v) {
    std::fill(shared.begin(), shared.end(), 0);
    for (int64_t i = observed_offsets[v]; i < observed_offsets[v + 1]; ++i)
      for (int64_t j = offsets[observed[i]]; j < offsets[observed[i] + 1]; ++j) ++shared[views[j]];
    shared[v] = 0;
    others.clear();
    for (size_t other = 0; other < num_views; ++other)
      if (shared[other] > 0) others.push_back(int32_t(other));
    const auto before = [&](int32_t a, int32_t b) {
      return shared[a] != shared[b] ? shared[a] > shared[b] : a < b;
    };
    const size_t kept = std::min(most, others.size());
    std::partial_sort(others.begin(), others.begin() + kept, others.end(), before);
    rows.entries.insert(rows.entries.end(), others.begin(), others.begin() + kept);
    rows.offsets.push_back(int64_t(rows.entries.size()));
  }
  return rows;
}

}  // namespace colmap_edges
