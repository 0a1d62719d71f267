// SPDX-License-Identifier: GPL-3.0-or-later
#include "refinement.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <stdexcept>
#include <string>
#include <tuple>
#include <utility>

#include "intersections.h"
#include "parallel.h"

namespace mesher {
namespace {

// Weight of the distances of vertices from the planes of their faces.
constexpr double kPlaneWeight = 2;
// Share of the variances of two normals that makes them differ: the faces have two corners in
// common.
constexpr double kNoiseShare = 0.2;
// Variance of a normal, in addition to that by the noise of its corners: no normal is exact.
constexpr double kNormalVariance = 0.1;
// Degrees of freedom of Student's t distribution of measurements: outliers weigh less.
constexpr double kFreedom = 8;
// No vertex moves farther than this number of standard deviations.
constexpr double kMaxSigmas = 8;
constexpr int kNormalSweeps = 10, kVertexSweeps = 5;
// Share of `typical_` that keeps the equations of a vertex regular.
constexpr double kRegular = 1e-9;

Vec3 Multiply(const Symmetric& a, const Vec3& b) {
  return {a[0] * b.x + a[1] * b.y + a[2] * b.z, a[1] * b.x + a[3] * b.y + a[4] * b.z,
          a[2] * b.x + a[4] * b.y + a[5] * b.z};
}

Symmetric Inverse(const Symmetric& a) {
  const double xx = a[3] * a[5] - a[4] * a[4], xy = a[2] * a[4] - a[1] * a[5],
               xz = a[1] * a[4] - a[2] * a[3];
  const double scale = 1 / (a[0] * xx + a[1] * xy + a[2] * xz);
  return {scale * xx,
          scale * xy,
          scale * xz,
          scale * (a[0] * a[5] - a[2] * a[2]),
          scale * (a[1] * a[2] - a[0] * a[4]),
          scale * (a[0] * a[3] - a[1] * a[1])};
}

// Adds weight * n n^T.
void AddOuter(double weight, const Vec3& n, Symmetric& a) {
  a[0] += weight * n.x * n.x, a[1] += weight * n.x * n.y, a[2] += weight * n.x * n.z;
  a[3] += weight * n.y * n.y, a[4] += weight * n.y * n.z, a[5] += weight * n.z * n.z;
}

void AddToDiagonal(double value, Symmetric& a) {
  for (const int i : {0, 3, 5}) a[i] += value;
}

double Mean(const Symmetric& a) { return (a[0] + a[3] + a[5]) / 3; }

Vec3 Unit(const Vec3& a) {
  const double norm = Norm(a);
  return norm > 0 ? (1 / norm) * a : a;
}

double Median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + values.size() / 2;
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

void CheckVertices(const Index* begin, const Index* end, std::size_t count, const char* what) {
  for (const Index* v = begin; v != end; ++v)
    if (*v < 0 || *v >= static_cast<Index>(count))
      throw std::invalid_argument(std::string(what) + " hold vertex " + std::to_string(*v) +
                                  " of " + std::to_string(count));
}

struct Side {
  Index a, b;  // vertices, a < b
  Index side;  // 3 * face + side, or kNone for a crease
};

// Sides of faces and creases; those between the same vertices are neighbours, creases first.
std::vector<Side> SortedSides(const RefinementInput& input) {
  std::vector<Side> sides;
  sides.reserve(3 * input.faces.size() + input.creases.size());
  const auto add = [&](Index a, Index b, std::size_t side) {
    sides.push_back({std::min(a, b), std::max(a, b), static_cast<Index>(side)});
  };
  for (std::size_t f = 0; f < input.faces.size(); ++f)
    for (int k = 0; k < 3; ++k) add(input.faces[f][k], input.faces[f][(k + 1) % 3], 3 * f + k);
  for (const auto& [a, b] : input.creases) add(a, b, kNone);
  std::sort(sides.begin(), sides.end(), [](const Side& s, const Side& t) {
    return std::tie(s.a, s.b, s.side) < std::tie(t.a, t.b, t.side);
  });
  return sides;
}

// Vertices at the same place as another one.
std::vector<Index> Duplicates(const std::vector<Vec3>& vertices) {
  const auto first = FirstAtPlace(vertices);
  std::vector<Index> found;
  for (Index v = 0; v < static_cast<Index>(first.size()); ++v)
    if (first[v] != v) found.insert(found.end(), {v, first[v]});
  return found;
}

Rows FacesOfVertices(const RefinementInput& input) {
  Rows rows;
  rows.offsets.assign(input.vertices.size() + 1, 0);
  for (const auto& corners : input.faces)
    for (const Index v : corners) ++rows.offsets[v + 1];
  std::partial_sum(rows.offsets.begin(), rows.offsets.end(), rows.offsets.begin());
  auto next = rows.offsets;
  rows.values.resize(3 * input.faces.size());
  for (std::size_t f = 0; f < input.faces.size(); ++f)
    for (const Index v : input.faces[f]) rows.values[next[v]++] = static_cast<Index>(f);
  return rows;
}

// The plane through the mean of points with the normal along which they vary least; whether there
// is one.
bool FitPlane(const std::vector<Vec3>& points, Vec3& mean, Vec3& normal) {
  if (points.size() < 3) return false;
  mean = {};
  for (const Vec3& p : points) mean = mean + p;
  mean = (1.0 / static_cast<double>(points.size())) * mean;
  Symmetric scatter{};
  for (const Vec3& p : points) AddOuter(1, p - mean, scatter);
  const double size = Mean(scatter);
  if (!(size > 0)) return false;
  // Power iteration of the inverse.
  AddToDiagonal(1e-6 * size, scatter);
  const Symmetric inverse = Inverse(scatter);
  normal = Unit(Vec3{inverse[0] + inverse[1], inverse[3] + inverse[2], inverse[5] + inverse[4]});
  for (int i = 0; i < 20; ++i) normal = Unit(Multiply(inverse, normal));
  return Norm(normal) > 0.5;
}

// Weight of a neighbour whose normal differs by a square q times a variance: exp(-q / 2), nearly,
// in a tenth of the time.
double Similarity(double square, double variance) {
  double weight = 16 * variance / (16 * variance + square);
  for (int i = 0; i < 3; ++i) weight *= weight;
  return weight;
}

}  // namespace

void CheckFaces(const std::vector<std::array<Index, 3>>& faces,
                const std::vector<std::array<Index, 2>>& creases, std::size_t num_vertices) {
  for (const auto& f : faces) CheckVertices(f.data(), f.data() + 3, num_vertices, "faces");
  for (const auto& c : creases) CheckVertices(c.data(), c.data() + 2, num_vertices, "creases");
}

void CheckInput(const RefinementInput& input) {
  const std::size_t count = input.vertices.size();
  if (input.information.size() != count)
    throw std::invalid_argument("vertices and information differ in number");
  CheckFaces(input.faces, input.creases, count);
}

struct Refiner::Face {
  Vec3 normal;           // smoothed
  double variance = 0;   // of the measured normal, by the noise of the corners
  double certainty = 0;  // weight of the normal
};

Refiner::Refiner(RefinementInput input, int num_threads)
    : input_(std::move(input)),
      num_threads_(num_threads),
      across_(input_.faces.size(), {kNone, kNone, kNone}) {
  const std::size_t count = input_.vertices.size();
  CheckInput(input_);
  faces_of_ = FacesOfVertices(input_);
  const std::vector<Side> sides = SortedSides(input_);
  std::vector<Index> stay = Duplicates(input_.vertices);
  for (std::size_t i = 0, end; i < sides.size(); i = end) {
    const std::size_t begin = i;
    for (end = i; end < sides.size() && sides[end].a == sides[i].a && sides[end].b == sides[i].b;)
      ++end;
    while (i < end && sides[i].side == kNone) ++i;
    const bool is_crease = i != begin;
    if (end - i == 1) stay.insert(stay.end(), {sides[i].a, sides[i].b});  // a border
    if (end - i != 2 || is_crease) continue;
    const Index s = sides[i].side, t = sides[i + 1].side;
    across_[s / 3][s % 3] = t / 3;
    across_[t / 3][t % 3] = s / 3;
  }
  for (const Index v : stay) input_.information[v] = {};
  std::vector<double> means;
  for (const Symmetric& information : input_.information)
    if (Mean(information) > 0) means.push_back(Mean(information));
  typical_ = Median(std::move(means));
  covariances_.assign(count, {});
  for (std::size_t v = 0; v < count; ++v) {
    Symmetric information = input_.information[v];
    if (!(Mean(information) > 0)) continue;
    AddToDiagonal(kRegular * typical_, information);
    covariances_[v] = Inverse(information);
  }
}

template <typename Body>
void Refiner::Each(std::size_t count, const Body& body) const {
  ParallelChunks(static_cast<std::int64_t>(count), num_threads_,
                 [&](std::int64_t begin, std::int64_t end) {
                   for (std::int64_t i = begin; i < end; ++i) body(i);
                 });
}

// A corner's height over the opposite side is as uncertain as the corner along the normal, which
// tilts the normal by that over the height.
std::vector<Refiner::Face> Refiner::MeasuredFaces(const std::vector<Vec3>& x) const {
  std::vector<Face> faces(input_.faces.size());
  std::vector<double> areas(faces.size());
  Each(faces.size(), [&](std::int64_t f) {
    const auto& c = input_.faces[f];
    const Vec3 cross = Cross(x[c[1]] - x[c[0]], x[c[2]] - x[c[0]]);
    areas[f] = Norm(cross);
    const Vec3 normal = Unit(cross);
    double variance = 0;
    for (int k = 0; k < 3; ++k) {
      const Vec3 side = x[c[(k + 1) % 3]] - x[c[(k + 2) % 3]];
      const double of_corner = Dot(normal, Multiply(covariances_[c[k]], normal));
      variance += of_corner * Dot(side, side) / (areas[f] * areas[f]);
    }
    faces[f] = {normal, variance < 1 ? variance : 1, 0};  // 1 also if the area is 0
  });
  const double typical = Median(areas);
  Each(faces.size(), [&](std::int64_t f) {
    faces[f].certainty = areas[f] / typical / (kNormalVariance + faces[f].variance);
  });
  return faces;
}

void Refiner::SmoothNormals(Smoothness smoothness, std::vector<Face>& faces) const {
  const std::vector<Face> measured = faces;
  std::vector<Face> next = faces;
  for (int sweep = 0; sweep < kNormalSweeps; ++sweep) {
    Each(faces.size(), [&](std::int64_t f) {
      const Face& face = faces[f];
      const double own_scale = smoothness.angle * smoothness.angle + kNoiseShare * face.variance;
      Vec3 sum{};
      for (const Index g : across_[f]) {
        if (g == kNone) continue;
        const Face& other = faces[g];
        const Vec3 difference = face.normal - other.normal;
        const double scale = own_scale + kNoiseShare * other.variance;
        const double similarity = Similarity(Dot(difference, difference), scale);
        sum = sum + similarity * other.certainty * other.normal;
      }
      next[f].normal = Unit(face.certainty * measured[f].normal + smoothness.strength * sum);
    });
    faces.swap(next);
  }
}

void Refiner::MoveVertices(const RefinementInput& input, const std::vector<Face>& faces,
                           std::vector<Vec3>& x) const {
  const double plane_weight = kPlaneWeight * typical_;
  std::vector<Symmetric> inverse(x.size());
  std::vector<Vec3> right(x.size()), next(x.size()), pulls(input.faces.size());
  Each(x.size(), [&](std::int64_t v) {
    Symmetric left = input.information[v];
    if (!(Mean(left) > 0)) return;
    const Vec3 moved = x[v] - input.vertices[v];
    const double weight = 1 / (1 + Dot(moved, Multiply(left, moved)) / kFreedom);
    for (double& value : left) value *= weight;
    right[v] = Multiply(left, input.vertices[v]) + kRegular * typical_ * x[v];
    AddToDiagonal(kRegular * typical_, left);
    for (const Index* f = faces_of_.begin(v); f != faces_of_.end(v); ++f)
      AddOuter(plane_weight, faces[*f].normal, left);
    inverse[v] = Inverse(left);
  });
  for (int sweep = 0; sweep < kVertexSweeps; ++sweep) {
    Each(input.faces.size(), [&](std::int64_t f) {
      const auto& c = input.faces[f];
      const Vec3& n = faces[f].normal;
      pulls[f] = plane_weight / 3 * Dot(n, x[c[0]] + x[c[1]] + x[c[2]]) * n;
    });
    Each(x.size(), [&](std::int64_t v) {
      Vec3 sum = right[v];
      for (const Index* f = faces_of_.begin(v); f != faces_of_.end(v); ++f) sum = sum + pulls[*f];
      next[v] = Mean(input.information[v]) > 0 ? Multiply(inverse[v], sum) : x[v];
    });
    x.swap(next);
  }
}

std::vector<Vec3> Refiner::Minimise(const RefinementInput& input, std::vector<Vec3> x,
                                    Smoothness smoothness, int num_rounds) const {
  for (int round = 0; round < num_rounds; ++round) {
    std::vector<Face> faces = MeasuredFaces(x);
    SmoothNormals(smoothness, faces);
    MoveVertices(input, faces, x);
  }
  return x;
}

std::vector<Vec3> Refiner::Refine(Smoothness smoothness, int num_rounds) const {
  std::vector<Vec3> x = Minimise(input_, input_.vertices, smoothness, num_rounds);
  Each(x.size(), [&](std::int64_t v) {
    const Vec3 moved = x[v] - input_.vertices[v];
    const double sigmas =
        std::sqrt(std::max(Dot(moved, Multiply(input_.information[v], moved)), 0.0));
    if (!IsFinite(x[v]))
      x[v] = input_.vertices[v];
    else if (sigmas > kMaxSigmas)
      x[v] = input_.vertices[v] + (kMaxSigmas / sigmas) * moved;
  });
  TakeBack(input_.faces, input_.vertices, num_threads_, x);
  return x;
}

std::vector<double> Refiner::HeldOutErrors(const std::vector<Index>& held_out,
                                           Smoothness smoothness, int num_rounds) const {
  CheckVertices(held_out.data(), held_out.data() + held_out.size(), input_.vertices.size(),
                "held out ones");
  RefinementInput input = input_;
  std::vector<Vec3> x = input.vertices, normals(held_out.size()), ring;
  std::vector<double> informations(held_out.size(), -1);
  for (std::size_t i = 0; i < held_out.size(); ++i) {
    const Index v = held_out[i];
    ring.clear();
    for (const Index* f = faces_of_.begin(v); f != faces_of_.end(v); ++f)
      for (const Index corner : input.faces[*f])
        if (corner != v) ring.push_back(x[corner]);
    Vec3 mean, &normal = normals[i];
    if (!FitPlane(ring, mean, normal)) continue;
    // The measurement along the normal is left out, those across it are kept.
    Symmetric& information = input.information[v];
    const Vec3 column = Multiply(information, normal);
    const double along = Dot(column, normal);
    if (!(along > 0)) continue;
    informations[i] = along;
    AddOuter(-1 / along, column, information);
    x[v] = x[v] + Dot(mean - x[v], normal) * normal;
  }
  x = Minimise(input, std::move(x), smoothness, num_rounds);
  std::vector<double> errors(held_out.size(), -1);
  for (std::size_t i = 0; i < held_out.size(); ++i) {
    if (informations[i] < 0) continue;
    const double off = Dot(x[held_out[i]] - input.vertices[held_out[i]], normals[i]);
    errors[i] = informations[i] * off * off;
  }
  return errors;
}

}  // namespace mesher
