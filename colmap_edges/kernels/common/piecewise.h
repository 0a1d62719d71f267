// Optimal segmentation of polylines into lines and circular arcs by dynamic programming.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

enum PieceKind : int32_t { kNothing = -1, kLine = 0, kArc = 1 };

// A piece of a polyline: points [first, last).
struct Piece {
  int64_t first, last;
  PieceKind kind;
};

// Costs of pieces, in addition to squared residuals in standard deviations.
struct PieceCosts {
  double line, arc;  // per piece
  double nothing;    // per outlier
  double variance;   // divisor of the squares; for a piece of n points,
  double shared;     // it is multiplied by 1 + n / shared
};

// Weighted moments of points, from which lines and circles are fitted.
struct Moments {
  double w = 0, p[3] = {}, pp[6] = {}, pz[3] = {}, z = 0,
         zz = 0;  // z is |p|^2; pp: xx xy xz yy yz zz

  void Add(const Vec3& point, double weight) {
    const double x = point.x, y = point.y, t = point.z, square = x * x + y * y + t * t;
    w += weight;
    p[0] += weight * x, p[1] += weight * y, p[2] += weight * t;
    pp[0] += weight * x * x, pp[1] += weight * x * y, pp[2] += weight * x * t;
    pp[3] += weight * y * y, pp[4] += weight * y * t, pp[5] += weight * t * t;
    pz[0] += weight * x * square, pz[1] += weight * y * square, pz[2] += weight * t * square;
    z += weight * square, zz += weight * square * square;
  }
};

// Ascending eigenvalues of a symmetric matrix (xx xy xz yy yz zz) and their eigenvectors, by
// Jacobi.
inline void Eigen3(const double given[6], double values[3], Vec3 vectors[3]) {
  double a[3][3] = {{given[0], given[1], given[2]},
                    {given[1], given[3], given[4]},
                    {given[2], given[4], given[5]}};
  double v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  for (int sweep = 0; sweep < 30; ++sweep) {
    const double off = a[0][1] * a[0][1] + a[0][2] * a[0][2] + a[1][2] * a[1][2];
    const double on = a[0][0] * a[0][0] + a[1][1] * a[1][1] + a[2][2] * a[2][2];
    if (off <= 1e-30 * on) break;
    for (int p = 0; p < 2; ++p) {
      for (int q = p + 1; q < 3; ++q) {
        if (a[p][q] == 0) continue;
        const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
        const double t = (theta >= 0 ? 1 : -1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
        const double c = 1 / std::sqrt(t * t + 1), s = t * c;
        for (int k = 0; k < 3; ++k) {
          const double x = a[k][p], y = a[k][q];
          a[k][p] = c * x - s * y, a[k][q] = s * x + c * y;
        }
        for (int k = 0; k < 3; ++k) {
          const double x = a[p][k], y = a[q][k];
          a[p][k] = c * x - s * y, a[q][k] = s * x + c * y;
        }
        for (int k = 0; k < 3; ++k) {
          const double x = v[k][p], y = v[k][q];
          v[k][p] = c * x - s * y, v[k][q] = s * x + c * y;
        }
      }
    }
  }
  int order[3] = {0, 1, 2};
  std::sort(order, order + 3, [&](int i, int j) { return a[i][i] < a[j][j]; });
  for (int k = 0; k < 3; ++k) {
    values[k] = std::max(0.0, a[order[k]][order[k]]);
    vectors[k] = {v[0][order[k]], v[1][order[k]], v[2][order[k]]};
  }
}

// Mean squared distance of points in a plane to their circle, by Taubin's fit with Newton's method
// (Chernov 2010, section 5.9). Moments are central and divided by the weight.
inline double TaubinResidual(double xx, double xy, double yy, double xz, double yz, double zz) {
  const double z = xx + yy, det = xx * yy - xy * xy, variance = zz - z * z;
  const double a3 = 4 * z, a2 = -3 * z * z - zz;
  const double a1 = variance * z + 4 * det * z - xz * xz - yz * yz;
  const double a0 = xz * (xz * yy - yz * xy) + yz * (yz * xx - xz * xy) - variance * det;
  double x = 0, y = a0;
  for (int i = 0; i < 20; ++i) {
    const double slope = a1 + x * (2 * a2 + 3 * a3 * x);
    const double next = x - y / slope;
    if (next == x || !std::isfinite(next)) break;
    const double value = a0 + next * (a1 + next * (a2 + next * a3));
    if (std::abs(value) >= std::abs(y)) break;
    x = next, y = value;
  }
  return std::max(0.0, x);
}

// Weighted sums of squared distances to the best line, and to the best circle in the best plane.
inline void Residuals(const Moments& m, double* line, double* arc) {
  const double mean[3] = {m.p[0] / m.w, m.p[1] / m.w, m.p[2] / m.w};
  const int row[6] = {0, 0, 0, 1, 1, 2}, column[6] = {0, 1, 2, 1, 2, 2};
  double spread[6];
  for (int k = 0; k < 6; ++k) spread[k] = m.pp[k] / m.w - mean[row[k]] * mean[column[k]];
  double values[3];
  Vec3 axes[3];
  Eigen3(spread, values, axes);
  *line = m.w * (values[0] + values[1]);
  // Moments of q = p - mean with |q|^2.
  const double at[3][3] = {
      {m.pp[0], m.pp[1], m.pp[2]}, {m.pp[1], m.pp[3], m.pp[4]}, {m.pp[2], m.pp[4], m.pp[5]}};
  const double mm = mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2];
  double at_mean[3], bent = m.zz + mm * mm * m.w + 2 * mm * m.z - 4 * mm * mm * m.w;
  const double centered = m.z - mm * m.w;  // sum of |q|^2
  Vec3 qz;
  for (int k = 0; k < 3; ++k) {
    at_mean[k] = at[k][0] * mean[0] + at[k][1] * mean[1] + at[k][2] * mean[2];
    bent += 4 * mean[k] * at_mean[k] - 4 * mean[k] * m.pz[k];
  }
  for (int k = 0; k < 3; ++k) {
    // sum (p - m)(|p|^2 - 2 p m + |m|^2)
    qz[k] = (m.pz[k] - 2 * at_mean[k] + mm * m.p[k] - mean[k] * centered) / m.w;
  }
  const double plane =
      TaubinResidual(values[2], 0, values[1], Dot(qz, axes[2]), Dot(qz, axes[1]), bent / m.w);
  *arc = m.w * (values[0] + std::min(plane, values[1]));
}

// Squared residuals of lines and arcs through the points between each two candidate cuts.
class PieceTable {
 public:
  // `places`: ascending indices of points at candidate cuts, from 0 to the number of points.
  PieceTable(const Vec3* points, const double* weights, std::vector<int64_t> places)
      : places_(std::move(places)),
        count_(places_.size()),
        line_(count_ * count_, kInfinite),
        arc_(count_ * count_, kInfinite) {
    for (size_t i = 0; i + 1 < count_; ++i) {
      Moments moments;
      const Vec3 origin = points[places_[i]];
      for (size_t j = i + 1; j < count_; ++j) {
        for (int64_t k = places_[j - 1]; k < places_[j]; ++k) {
          moments.Add(points[k] - origin, weights[k]);
        }
        const int64_t length = places_[j] - places_[i];
        if (length < kLinePoints || moments.w <= 0) continue;
        double line, arc;
        Residuals(moments, &line, &arc);
        line_[i * count_ + j] = line;
        if (length >= kArcPoints) arc_[i * count_ + j] = arc;
      }
    }
  }

  // The pieces of least total cost, in order; returns this cost.
  double Cut(const PieceCosts& costs, std::vector<Piece>* pieces) const {
    std::vector<double> best(count_, kInfinite);
    std::vector<size_t> from(count_, 0);
    std::vector<PieceKind> kind(count_, kNothing);
    best[0] = 0;
    for (size_t j = 1; j < count_; ++j) {
      best[j] = best[j - 1] + costs.nothing * double(places_[j] - places_[j - 1]);
      from[j] = j - 1;
      for (size_t i = 0; i < j; ++i) {
        const double length = double(places_[j] - places_[i]);
        const double variance = costs.variance * (1 + length / costs.shared);
        const double line = best[i] + costs.line + line_[i * count_ + j] / variance;
        const double arc = best[i] + costs.arc + arc_[i * count_ + j] / variance;
        if (line < best[j]) best[j] = line, from[j] = i, kind[j] = kLine;
        if (arc < best[j]) best[j] = arc, from[j] = i, kind[j] = kArc;
      }
    }
    const size_t known = pieces->size();
    for (size_t j = count_ - 1; j > 0; j = from[j]) {
      const bool goes_on =
          kind[j] == kNothing && pieces->size() > known && pieces->back().kind == kNothing;
      if (goes_on) {
        pieces->back().first = places_[from[j]];
      } else {
        pieces->push_back({places_[from[j]], places_[j], kind[j]});
      }
    }
    std::reverse(pieces->begin() + int64_t(known), pieces->end());
    return best[count_ - 1];
  }

  static constexpr int64_t kLinePoints = 3, kArcPoints = 5;  // minimum numbers of points

 private:
  static constexpr double kInfinite = std::numeric_limits<double>::infinity();
  std::vector<int64_t> places_;
  size_t count_;
  std::vector<double> line_, arc_;
};

// Candidate cuts: both ends, and points up to `reach` from the cuts between pieces.
inline std::vector<int64_t> PlacesNear(const std::vector<Piece>& pieces, int64_t count,
                                       int64_t reach) {
  std::vector<int64_t> places = {0, count};
  for (const Piece& piece : pieces) {
    for (int64_t k = piece.first - reach; k <= piece.first + reach; ++k) {
      if (k > 0 && k < count) places.push_back(k);
    }
  }
  std::sort(places.begin(), places.end());
  places.erase(std::unique(places.begin(), places.end()), places.end());
  return places;
}

// At most `most` + 1 evenly spaced indices from 0 to `count`.
inline std::vector<int64_t> PlacesToCut(int64_t count, int64_t most) {
  const int64_t parts = std::min(count, most);
  std::vector<int64_t> places(parts + 1);
  for (int64_t k = 0; k <= parts; ++k) places[k] = parts > 0 ? k * count / parts : 0;
  return places;
}

}  // namespace colmap_edges
