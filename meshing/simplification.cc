// SPDX-License-Identifier: GPL-3.0-or-later
#include "simplification.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "parallel.h"

namespace mesher {
namespace {

// Variance of the normals of faces: keeps vertices of flat faces apart, so that few are needles.
constexpr double kNormalVariance = 1e-3;
// Share of the proposals that a round considers, the best ones.
constexpr double kRoundShare = 0.5;
// Points of creases and borders that are left out cost nothing this near, in spacings of these
// points. Beyond it, their squared distances count this many times as much as those of faces.
constexpr double kTolerance = 0.2;
constexpr double kLineWeight = 1000;

// A sum of weighted squared distances from a place, as its function.
class Quadric {
 public:
  void AddPoint(double weight, const Vec3& p) {
    matrix_[0] += weight, matrix_[3] += weight, matrix_[5] += weight;
    vector_ = vector_ + weight * p;
    constant_ += weight * Dot(p, p);
  }
  void AddPlane(double weight, const Vec3& n, const Vec3& p) {
    const double offset = Dot(n, p);
    int i = 0;
    for (int row = 0; row < 3; ++row)
      for (int column = row; column < 3; ++column) matrix_[i++] += weight * n[row] * n[column];
    vector_ = vector_ + weight * offset * n;
    constant_ += weight * offset * offset;
  }
  void Add(const Quadric& other) {
    for (int i = 0; i < 6; ++i) matrix_[i] += other.matrix_[i];
    vector_ = vector_ + other.vector_;
    constant_ += other.constant_;
  }
  double operator()(const Vec3& p) const {
    return std::max(Quadratic(matrix_, p) - 2 * Dot(vector_, p) + constant_, 0.0);
  }

 private:
  Symmetric matrix_{};
  Vec3 vector_;
  double constant_ = 0;
};

// The collapse that a vertex proposes.
struct Proposal {
  double cost = 0;
  Index to = kNone;
};

class Simplifier : public Editor {
 public:
  Simplifier(const std::vector<Vec3>& vertices, const std::vector<Face>& faces,
             const std::vector<std::array<Index, 2>>& creases, int num_threads);
  void Run(std::size_t max_faces);

 private:
  Vec3 Local(Index v) const { return At(v) - At(0); }
  double Cost(Index from, Index to) const;
  double LineCost(Index from) const;
  bool KeepsDirection(Index from, Index to) const;
  Proposal BestFor(Index from) const;
  std::vector<Change> Choose(std::size_t max_removed);
  void Apply(const Change& change, std::vector<char>& is_changed);

  std::size_t num_faces_;
  std::vector<double> spacings_;     // of vertices of lines: mean length of the pieces at them
  std::vector<Quadric> quadrics_;    // of vertices
  std::vector<Proposal> proposals_;  // of vertices
};

Simplifier::Simplifier(const std::vector<Vec3>& vertices, const std::vector<Face>& faces,
                       const std::vector<std::array<Index, 2>>& creases, int num_threads)
    : Editor(vertices, faces, creases, true, num_threads),
      num_faces_(faces.size()),
      spacings_(vertices.size()),
      quadrics_(vertices.size()),
      proposals_(vertices.size()) {
  for (const Face& face : faces_) {
    const Vec3 normal = Normal(CornersOf(face));
    const double length = Norm(normal);
    if (!(length > 0)) continue;
    const Vec3 center = (1. / 3) * (Local(face[0]) + Local(face[1]) + Local(face[2]));
    for (const Index v : face) {
      quadrics_[v].AddPlane(length, (1 / length) * normal, center);
      quadrics_[v].AddPoint(kNormalVariance * length, center);
    }
  }
  for (std::size_t v = 0; v < lines_of_.size(); ++v)
    for (const Index other : lines_of_[v]) {
      const Vec3 side = At(other) - At(static_cast<Index>(v));
      const double length = Norm(side);
      if (!(length > 0)) continue;
      spacings_[v] += length / lines_of_[v].size();
      quadrics_[v].AddPoint(length * length, Local(other));
      if (lines_of_[v].size() > 1)
        quadrics_[v].AddPlane(-length * length, (1 / length) * side, Local(other));
    }
}

double Simplifier::Cost(Index from, Index to) const { return quadrics_[from](Local(to)); }

// The error of the points left out of a vertex's line, and of itself, where they are far from what
// is left of the line.
double Simplifier::LineCost(Index from) const {
  const auto& ends = lines_of_[from];
  if (ends.empty()) return 0;
  const auto error = [&](Index v) {
    const Vec3 off = At(v) - ClosestOnSegment(At(v), At(ends.front()), At(ends.back()));
    const double distance = Norm(off), spacing = spacings_[v];
    return distance > kTolerance * spacing ? std::pow(spacing * distance, 2) : 0;
  };
  double largest = error(from);
  for (const Index end : ends)
    for (const Index v : lines_.at(Key(from, end)).points) largest = std::max(largest, error(v));
  return kLineWeight * largest;
}

bool Simplifier::KeepsDirection(Index from, Index to) const {
  for (const Index f : faces_of_[from]) {
    Face face = faces_[f];
    if (Has(face, to)) continue;
    std::replace(face.begin(), face.end(), from, to);
    const Vec3 before = Normal(CornersOf(faces_[f])), after = Normal(CornersOf(face));
    if (!(Dot(before, after) > 0)) return false;
  }
  return true;
}

Proposal Simplifier::BestFor(Index from) const {
  if (stays_[from] || lines_of_[from].size() > 2) return {};
  thread_local std::vector<Index> around;
  thread_local std::vector<std::pair<double, Index>> neighbours;
  around.clear(), neighbours.clear();
  for (const Index f : faces_of_[from])
    around.insert(around.end(), faces_[f].begin(), faces_[f].end());
  SortUnique(around);
  for (const Index v : around)
    if (v != from && CanCollapse(from, v)) neighbours.emplace_back(Cost(from, v), v);
  std::sort(neighbours.begin(), neighbours.end());
  for (const auto& [cost, to] : neighbours)
    if (KeepsDirection(from, to) && KeepsTopology(from, to)) return {cost + LineCost(from), to};
  return {};
}

// The best proposals, no two of which have a vertex in common.
std::vector<Change> Simplifier::Choose(std::size_t max_removed) {
  std::vector<Index> order;
  for (std::size_t v = 0; v < proposals_.size(); ++v)
    if (proposals_[v].to != kNone) order.push_back(static_cast<Index>(v));
  std::stable_sort(order.begin(), order.end(),
                   [&](Index a, Index b) { return proposals_[a].cost < proposals_[b].cost; });
  order.resize(static_cast<std::size_t>(std::ceil(kRoundShare * order.size())));
  std::vector<char> is_taken(vertices_.size());
  std::vector<Change> changes;
  std::size_t num_removed = 0;
  for (const Index from : order) {
    if (num_removed >= max_removed) break;
    const auto& around = faces_of_[from];
    const auto is_free = [&](Index f) {
      const auto& [a, b, c] = faces_[f];
      return !is_taken[a] && !is_taken[b] && !is_taken[c];
    };
    if (!std::all_of(around.begin(), around.end(), is_free)) continue;
    Change change;
    const Index to = std::exchange(proposals_[from], {}).to;
    if (!MakeCollapse(from, to, change) || !KeepsDirection(from, to)) continue;
    for (const Index f : around)
      for (const Index v : faces_[f]) is_taken[v] = 1;
    num_removed += change.old_faces.size() - change.faces.size();
    changes.push_back(std::move(change));
  }
  return changes;
}

void Simplifier::Apply(const Change& change, std::vector<char>& is_changed) {
  num_faces_ -= change.old_faces.size() - change.faces.size();
  quadrics_[change.to].Add(quadrics_[change.removed]);
  proposals_[change.removed] = {};
  Replace(change);
  for (const Index f : faces_of_[change.to])
    for (const Index v : faces_[f]) is_changed[v] = 1;
}

void Simplifier::Run(std::size_t max_faces) {
  std::vector<char> is_changed(vertices_.size(), 1);
  while (num_faces_ > max_faces) {
    ParallelChunks(static_cast<std::int64_t>(vertices_.size()), num_threads_,
                   [&](std::int64_t begin, std::int64_t end) {
                     for (std::int64_t v = begin; v < end; ++v)
                       if (is_changed[v]) proposals_[v] = BestFor(static_cast<Index>(v));
                   });
    std::vector<Change> changes = Choose(num_faces_ - max_faces);
    if (changes.empty()) return;
    RemoveColliding(changes);
    std::fill(is_changed.begin(), is_changed.end(), 0);
    for (const Change& change : changes) Apply(change, is_changed);
  }
}

}  // namespace

EditedMesh Simplify(const std::vector<Vec3>& vertices, const std::vector<Face>& faces,
                    const std::vector<std::array<Index, 2>>& creases, std::size_t max_faces,
                    int num_threads) {
  Simplifier simplifier(vertices, faces, creases, num_threads);
  simplifier.Run(max_faces);
  return simplifier.Result();
}

}  // namespace mesher
