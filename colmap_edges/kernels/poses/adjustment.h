// Normal equations of poses and points, with points eliminated one by one.
//
// Rows are kept for one point at a time. Apart from the observations, memory therefore holds only
// the points and the blocks of poses that share points.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

// The measurements, and the poses and points of linearisation. Owns nothing.
struct Adjustment {
  int64_t num_points = 0;
  const int64_t* offsets = nullptr;   // (P + 1) rows of each point's observations
  const int32_t* views = nullptr;     // (N)
  const double* pixels = nullptr;     // (N, 2) undistorted
  const double* normals = nullptr;    // (N, 2) measured directions; 0 if both are measured
  const double* tangents = nullptr;   // (P, 3) unit directions in which points are fixed; 0: none
  const int32_t* frames = nullptr;    // (V)
  const double* rotations = nullptr;  // (V, 3, 3) of cam_from_world
  const double* translations = nullptr;  // (V, 3)
  const double* focals_px = nullptr;     // (V)
  const double* centers = nullptr;       // (F, 3) centres of rotation of the frames
  const double* points = nullptr;        // (P, 3)
  double sigmas_px[2] = {1, 1};          // of observations measured in two directions, in one
  double robust_factor = 1;              // threshold of the robust loss, in sigmas

  Vec3 Point(int64_t p) const { return At(points, p); }
  static Vec3 At(const double* values, int64_t i) {
    return {values[3 * i], values[3 * i + 1], values[3 * i + 2]};
  }
};

using Vec6 = std::array<double, 6>;
using Block = std::array<double, 36>;  // row major

// A weighted measurement: derivatives by the motion of its frame and by its point.
struct Row {
  int32_t frame;
  Vec6 by_pose;
  Vec3 by_point;  // after elimination of the point, L^-1 times this
  double residual;
};

// One observation in its view.
struct Projection {
  Vec3 local;          // the point in the camera
  double residual[2];  // pixels; infinite if the point is not in front of the camera
  bool across;         // only the first is measured, along the normal
};

inline Projection Project(const Adjustment& a, int64_t observation, const Vec3& point) {
  const int64_t view = a.views[observation];
  const double* r = a.rotations + 9 * view;
  Projection result;
  for (int i = 0; i < 3; ++i) {
    result.local[i] = r[3 * i] * point.x + r[3 * i + 1] * point.y + r[3 * i + 2] * point.z +
                      a.translations[3 * view + i];
  }
  const double *normal = a.normals + 2 * observation, *pixel = a.pixels + 2 * observation;
  result.across = normal[0] != 0 || normal[1] != 0;
  const double infinite = std::numeric_limits<double>::infinity();
  double away[2] = {infinite, infinite};
  if (result.local.z > 0) {
    for (int i = 0; i < 2; ++i)
      away[i] = a.focals_px[view] * result.local[i] / result.local.z - pixel[i];
    if (result.across) away[0] = normal[0] * away[0] + normal[1] * away[1];
  }
  result.residual[0] = away[0];
  result.residual[1] = result.across ? 0 : away[1];
  return result;
}

// (N, 2) residuals in pixels; the second is 0 if only one direction is measured.
inline std::vector<double> Residuals(const Adjustment& a) {
  std::vector<double> result(2 * a.offsets[a.num_points]);
  for (int64_t p = 0; p < a.num_points; ++p) {
    for (int64_t o = a.offsets[p]; o < a.offsets[p + 1]; ++o) {
      const Projection seen = Project(a, o, a.Point(p));
      result[2 * o] = seen.residual[0], result[2 * o + 1] = seen.residual[1];
    }
  }
  return result;
}

// Appends the weighted rows of an observation; none if the point is not in front of the camera.
inline void Linearize(const Adjustment& a, int64_t observation, int64_t p, std::vector<Row>* rows) {
  const Vec3 point = a.Point(p), tangent = Adjustment::At(a.tangents, p);
  const Projection seen = Project(a, observation, point);
  if (!(seen.local.z > 0)) return;
  const int64_t view = a.views[observation];
  const int32_t frame = a.frames[view];
  const double sigma = a.sigmas_px[seen.across], most = a.robust_factor * sigma;
  const double *e = seen.residual, *normal = a.normals + 2 * observation;
  const double weight = 1 / std::sqrt(1 + (e[0] * e[0] + e[1] * e[1]) / (most * most)) / sigma;
  const Vec3 arm = point - Adjustment::At(a.centers, frame);
  const double* r = a.rotations + 9 * view;
  for (int k = 0; k < (seen.across ? 1 : 2); ++k) {
    const Vec2 along =
        seen.across ? Vec2{normal[0], normal[1]} : Vec2{double(k == 0), double(k == 1)};
    const double inward = -(along.x * seen.local.x + along.y * seen.local.y) / seen.local.z;
    const double scale = weight * a.focals_px[view] / seen.local.z;
    Vec3 by_shift;
    for (int i = 0; i < 3; ++i)
      by_shift[i] = scale * (along.x * r[i] + along.y * r[3 + i] + inward * r[6 + i]);
    const Vec3 by_turn = Cross(arm, by_shift);
    rows->push_back({frame,
                     {by_turn.x, by_turn.y, by_turn.z, by_shift.x, by_shift.y, by_shift.z},
                     by_shift - Dot(by_shift, tangent) * tangent,
                     weight * e[k]});
  }
}

// An eliminated point: L of L L^T = its damped block, and L^-1 times its gradient.
struct Eliminated {
  double l[6];  // by rows of the lower triangle
  Vec3 gradient;

  Vec3 SolveLower(const Vec3& b) const {
    const double x = b.x / l[0], y = (b.y - l[1] * x) / l[2];
    return {x, y, (b.z - l[3] * x - l[4] * y) / l[5]};
  }
  Vec3 SolveUpper(const Vec3& b) const {
    const double z = b.z / l[5], y = (b.y - l[4] * z) / l[2];
    return {(b.x - l[1] * y - l[3] * z) / l[0], y, z};
  }
};

// Eliminates a point from its rows, sorts these by frame and multiplies their `by_point` by L^-1.
// Throws std::domain_error if the block is singular.
inline Eliminated Eliminate(const Adjustment& a, int64_t p, double damping,
                            std::vector<Row>* rows) {
  rows->clear();
  for (int64_t o = a.offsets[p]; o < a.offsets[p + 1]; ++o) Linearize(a, o, p, rows);
  double v[6] = {};  // lower triangle by rows
  Vec3 gradient;
  const auto add = [&v](double s, const Vec3& d) {
    v[0] += s * d.x * d.x, v[1] += s * d.y * d.x, v[2] += s * d.y * d.y;
    v[3] += s * d.z * d.x, v[4] += s * d.z * d.y, v[5] += s * d.z * d.z;
  };
  for (const Row& row : *rows) {
    add(1, row.by_point);
    gradient = gradient + row.residual * row.by_point;
  }
  add(v[0] + v[2] + v[5], Adjustment::At(a.tangents, p));
  const double least = 1e-12 * (v[0] + v[2] + v[5]) + 1e-300;
  for (const int k : {0, 2, 5}) v[k] += damping * v[k] + least;
  Eliminated result;
  double* l = result.l;
  l[0] = std::sqrt(v[0]);
  l[1] = v[1] / l[0], l[2] = std::sqrt(v[2] - l[1] * l[1]);
  l[3] = v[3] / l[0], l[4] = (v[4] - l[3] * l[1]) / l[2];
  l[5] = std::sqrt(v[5] - l[3] * l[3] - l[4] * l[4]);
  if (!(l[0] > 0 && l[2] > 0 && l[5] > 0)) throw std::domain_error("a point is not determined");
  result.gradient = result.SolveLower(gradient);
  for (Row& row : *rows) row.by_point = result.SolveLower(row.by_point);
  const auto before = [](const Row& r, const Row& s) { return r.frame < s.frame; };
  if (!std::is_sorted(rows->begin(), rows->end(), before))
    std::stable_sort(rows->begin(), rows->end(), before);
  return result;
}

inline void AddOuter(double scale, const Vec6& a, const Vec6& b, Block* block) {
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) (*block)[6 * i + j] += scale * a[i] * b[j];
  }
}

// Blocks of the reduced system of the poses: frames that share points (CSR, columns ascending), and
// the information subtracted by the elimination of points.
struct PoseSystem {
  const int64_t* offsets = nullptr;  // (F + 1)
  const int32_t* columns = nullptr;  // (B)
  int64_t num_frames = 0;
  std::vector<Block> information;  // (F) of the frames with fixed points, undamped
  std::vector<Block> shared;       // (B) to be added
  std::vector<Vec6> right;         // (F)

  int64_t Place(int32_t frame, int64_t from, int32_t other) const {
    const int32_t* end = columns + offsets[frame + 1];
    const int32_t* at = std::lower_bound(columns + from, end, other);
    if (at == end || *at != other) throw std::invalid_argument("frames share points unknown of");
    return at - columns;
  }

  void AddPairs(const std::vector<Row>& rows) {
    for (size_t r = 0; r < rows.size(); ++r) {
      int64_t place = offsets[rows[r].frame];
      for (size_t s = r; s < rows.size(); ++s) {
        place = Place(rows[r].frame, place, rows[s].frame);
        const double factor = -Dot(rows[r].by_point, rows[s].by_point);
        AddOuter(factor, rows[r].by_pose, rows[s].by_pose, &shared[place]);
        if (s != r && rows[s].frame == rows[r].frame)
          AddOuter(factor, rows[s].by_pose, rows[r].by_pose, &shared[place]);
      }
    }
  }

  // Fills the blocks below the diagonal with those above.
  void Mirror() {
    for (int32_t frame = 0; frame < num_frames; ++frame) {
      for (int64_t k = offsets[frame]; k < offsets[frame + 1]; ++k) {
        if (columns[k] <= frame) continue;
        Block& other = shared[Place(columns[k], offsets[columns[k]], frame)];
        for (int i = 0; i < 6; ++i) {
          for (int j = 0; j < 6; ++j) other[6 * j + i] = shared[k][6 * i + j];
        }
      }
    }
  }
};

inline void ReducePoints(const Adjustment& a, double damping, PoseSystem* system) {
  system->information.assign(system->num_frames, Block{});
  system->shared.assign(system->offsets[system->num_frames], Block{});
  system->right.assign(system->num_frames, Vec6{});
  std::vector<Row> rows;
  for (int64_t p = 0; p < a.num_points; ++p) {
    const Eliminated point = Eliminate(a, p, damping, &rows);
    for (const Row& row : rows) {
      AddOuter(1, row.by_pose, row.by_pose, &system->information[row.frame]);
      const double pull = Dot(row.by_point, point.gradient) - row.residual;
      for (int i = 0; i < 6; ++i) system->right[row.frame][i] += pull * row.by_pose[i];
    }
    system->AddPairs(rows);
  }
  system->Mirror();
}

// (P, 3) steps of the points, given the steps (F, 6) of the frames.
inline std::vector<double> PointSteps(const Adjustment& a, double damping, const double* steps) {
  std::vector<double> result(3 * a.num_points);
  std::vector<Row> rows;
  for (int64_t p = 0; p < a.num_points; ++p) {
    const Eliminated point = Eliminate(a, p, damping, &rows);
    Vec3 sum = point.gradient;
    for (const Row& row : rows) {
      double moved = 0;
      for (int i = 0; i < 6; ++i) moved += row.by_pose[i] * steps[6 * row.frame + i];
      sum = sum + moved * row.by_point;
    }
    const Vec3 step = point.SolveUpper(sum);
    for (int i = 0; i < 3; ++i) result[3 * p + i] = -step[i];
  }
  return result;
}

}  // namespace colmap_edges
