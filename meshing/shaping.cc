// SPDX-License-Identifier: GPL-3.0-or-later
#include "shaping.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <tuple>
#include <utility>

#include "editing.h"
#include "parallel.h"

namespace mesher {
namespace {

// The first rounds gain nearly all.
constexpr int kMaxRounds = 12;
// Least decrease of the cost for which faces are replaced.
constexpr double kMinGain = 1e-3;
// The cost of a face whose smallest angle is `min_angle`.
constexpr double kBad = 0.25;
// Heights of new vertices over the short side of a needle, in lengths of this side; they are at
// most at this share of its length.
constexpr double kHeights[] = {6, 3, 1.5};
constexpr double kMaxShare = 0.6;
// Most faces that a new vertex replaces.
constexpr std::size_t kMaxCavity = 32;

enum class Kind { kCollapse, kSwap, kInsert };

// What a face proposes.
struct Proposal {
  double gain = 0;
  Kind kind = Kind::kCollapse;
  Index from = kNone, to = kNone;  // ends of a side; the first one is collapsed onto the other one
  Index face = kNone;              // the face into which a vertex is inserted, at a height over its
  double height = 0;               // short side, in lengths of it
};

// Inside by its barycentric coordinates (Ericson, Real-Time Collision Detection), or on a side.
Vec3 ClosestOnTriangle(const Vec3& p, const Corners& c) {
  const Vec3 ab = c[1] - c[0], ac = c[2] - c[0], ap = p - c[0], bp = p - c[1], cp = p - c[2];
  const double d1 = Dot(ab, ap), d2 = Dot(ac, ap), d3 = Dot(ab, bp), d4 = Dot(ac, bp),
               d5 = Dot(ab, cp), d6 = Dot(ac, cp);
  const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
  if (va > 0 && vb > 0 && vc > 0) return c[0] + (1 / (va + vb + vc)) * (vb * ab + vc * ac);
  Vec3 closest;
  double least = std::numeric_limits<double>::infinity();
  for (int k = 0; k < 3; ++k) {
    const Vec3 on = ClosestOnSegment(p, c[k], c[(k + 1) % 3]);
    const double square = Dot(p - on, p - on);
    if (square < least) least = square, closest = on;
  }
  return closest;
}

// Whether the angles opposite side ab, at c and d, sum up to 180 degrees at most: the sine of it.
bool IsDelaunay(const Vec3& a, const Vec3& b, const Vec3& c, const Vec3& d) {
  const Vec3 ca = a - c, cb = b - c, da = a - d, db = b - d;
  return Norm(Cross(ca, cb)) * Dot(da, db) + Norm(Cross(da, db)) * Dot(ca, cb) >= 0;
}

class Shaper : public Editor {
 public:
  Shaper(const RefinementInput& input, const ShapingOptions& options, int num_threads);
  void Run();

 private:
  double Cost(const Corners& corners) const;
  double CollapseGain(Index from, Index to) const;
  bool MakeSwap(Index a, Index b, Change& change) const;
  bool MakeInsert(Index face, double height, Change& change) const;
  bool Make(const Proposal& proposal, Change& change) const;

  bool IsNear(const Vec3& point, const Symmetric& information, const Change& change) const;
  bool KeepsLine(const Change& change) const;
  bool KeepsPoints(const Change& change) const;
  double NormalVariance(const Face& face, const Corners& corners, const Change& change) const;
  double Turn(const Face& f, const Face& g, const Change& change) const;
  std::array<double, 2> LargestTurns(const std::vector<Face>& faces, const Change& change) const;
  bool KeepsDirection(const Change& change) const;
  bool IsAllowed(const Change& change) const;

  Proposal BestFor(Index face) const;
  std::vector<Change> Choose();
  void Number(Change& change);
  void Apply(const Change& change);

  const double good_sine_, turn_square_, max_square_, noise_square_;
  std::vector<Symmetric> information_;
  std::vector<double> costs_;
  std::vector<std::vector<Index>> points_of_;  // of faces: vertices that are left out
  std::vector<Proposal> proposals_;            // of faces
};

Shaper::Shaper(const RefinementInput& input, const ShapingOptions& options, int num_threads)
    : Editor(input.vertices, input.faces, input.creases, false, num_threads),
      good_sine_(std::sin(2 * options.min_angle)),
      turn_square_(2 - 2 * std::cos(options.max_turn)),
      max_square_(options.max_sigmas * options.max_sigmas),
      noise_square_(options.turn_sigmas * options.turn_sigmas),
      information_(input.information),
      points_of_(input.faces.size()),
      proposals_(input.faces.size()) {
  for (std::size_t v = 0; v < information_.size(); ++v) {
    const Symmetric& information = information_[v];
    if (!(information[0] + information[3] + information[5] > 0)) stays_[v] = 1;
  }
  for (const Face& face : faces_) costs_.push_back(Cost(CornersOf(face)));
}

// The smallest angle lies opposite the shortest side.
double Shaper::Cost(const Corners& c) const {
  double squares[3];
  for (int k = 0; k < 3; ++k) {
    const Vec3 side = c[(k + 1) % 3] - c[k];
    squares[k] = Dot(side, side);
  }
  const Vec3 normal = Normal(c);
  const double shortest = std::min({squares[0], squares[1], squares[2]});
  const double product = shortest > 0 ? squares[0] * squares[1] * squares[2] / shortest : 0;
  const double sine = product > 0 ? std::sqrt(Dot(normal, normal) / product) : 0;
  const double lack = std::max(1 - sine / good_sine_, 0.0);
  return lack * lack;
}

// The decrease of the cost.
double Shaper::CollapseGain(Index from, Index to) const {
  double gain = 0;
  for (const Index f : faces_of_[from]) {
    gain += costs_[f];
    Face face = faces_[f];
    if (Has(face, to)) continue;
    std::replace(face.begin(), face.end(), from, to);
    gain -= Cost(CornersOf(face));
  }
  return gain;
}

bool Shaper::MakeSwap(Index a, Index b, Change& change) const {
  if (IsLine(a, b)) return false;
  const Index f = FaceWithSide(a, b), g = FaceWithSide(b, a);
  if (f == kNone || g == kNone || (stays_[a] && stays_[b])) return false;
  const auto opposite = [&](Index face) {
    return *std::find_if(faces_[face].begin(), faces_[face].end(),
                         [&](Index v) { return v != a && v != b; });
  };
  const Index c = opposite(f), d = opposite(g);
  if (c == d || (stays_[c] && stays_[d])) return false;
  for (const Index other : faces_of_[c])
    if (Has(faces_[other], d)) return false;
  change.old_faces = {f, g};
  change.faces = {{c, a, d}, {d, b, c}};
  return true;
}

// Puts a vertex on the median of a needle over its short side, and lets the faces in whose
// circumscribed circle it lies meet it, but none behind a line (Delaunay insertion).
bool Shaper::MakeInsert(Index face, double height, Change& change) const {
  const Corners c = CornersOf(faces_[face]);
  double lengths[3];
  for (int k = 0; k < 3; ++k) lengths[k] = Norm(c[(k + 1) % 3] - c[k]);
  const auto k = std::min_element(lengths, lengths + 3) - lengths;
  const Vec3 middle = 0.5 * c[k] + 0.5 * c[(k + 1) % 3], median = c[(k + 2) % 3] - middle;
  const double share = height * lengths[k] / Norm(median);
  if (!(share > 0 && share < kMaxShare)) return false;
  change.added = middle + share * median;
  change.old_faces = {face};
  for (const Index v : faces_[face])
    for (int i = 0; i < 6; ++i) change.information[i] += information_[v][i] / 3;
  std::vector<std::array<Index, 2>> sides;  // whose faces behind are still to be looked at
  for (int i = 0; i < 3; ++i) sides.push_back({faces_[face][i], faces_[face][(i + 1) % 3]});
  std::vector<Index> around;
  while (!sides.empty()) {
    const auto [a, b] = sides.back();
    sides.pop_back();
    const Index behind = IsLine(a, b) ? kNone : FaceWithSide(b, a);
    Index corner = kNone;
    if (behind != kNone && !std::count(change.old_faces.begin(), change.old_faces.end(), behind))
      for (const Index v : faces_[behind])
        if (v != a && v != b) corner = v;
    if (corner == kNone || change.old_faces.size() == kMaxCavity ||
        IsDelaunay(At(a), At(b), change.added, At(corner))) {
      change.faces.push_back({a, b, kAdded});
      around.push_back(a);
    } else {
      change.old_faces.push_back(behind);
      sides.push_back({a, corner});
      sides.push_back({corner, b});
    }
  }
  // A disk without a vertex inside.
  std::sort(around.begin(), around.end());
  return around.size() == change.old_faces.size() + 2 &&
         std::adjacent_find(around.begin(), around.end()) == around.end();
}

bool Shaper::Make(const Proposal& proposal, Change& change) const {
  const auto& [gain, kind, from, to, face, height] = proposal;
  if (!(kind == Kind::kSwap     ? MakeSwap(from, to, change)
        : kind == Kind::kInsert ? MakeInsert(face, height, change)
                                : MakeCollapse(from, to, change)))
    return false;
  for (const Index f : change.old_faces) change.gain += costs_[f];
  for (const Face& f : change.faces) change.gain -= Cost(CornersOf(f, change));
  return change.gain > kMinGain;
}

bool Shaper::IsNear(const Vec3& point, const Symmetric& information, const Change& change) const {
  return std::any_of(change.faces.begin(), change.faces.end(), [&](const Face& f) {
    const Vec3 off = point - ClosestOnTriangle(point, CornersOf(f, change));
    return Quadratic(information, off) <= max_square_;
  });
}

bool Shaper::KeepsLine(const Change& change) const {
  const auto is_near = [&](Index v) {
    const Vec3 off = At(v) - ClosestOnSegment(At(v), At(change.line[0]), At(change.line[1]));
    return Quadratic(information_[v], off) <= max_square_;
  };
  for (const Index end : change.line) {
    const auto& points = lines_.at(Key(change.removed, end)).points;
    if (!std::all_of(points.begin(), points.end(), is_near)) return false;
  }
  return is_near(change.removed);
}

bool Shaper::KeepsPoints(const Change& change) const {
  if (change.is_on_line) {
    if (!KeepsLine(change)) return false;
  } else if (change.removed != kNone) {
    if (!IsNear(At(change.removed), information_[change.removed], change)) return false;
  }
  std::vector<std::uint64_t> sides;
  for (const Index f : change.old_faces) {
    for (const Index v : points_of_[f])
      if (!IsNear(At(v), information_[v], change)) return false;
    for (int k = 0; k < 3; ++k) sides.push_back(Key(faces_[f][k], faces_[f][(k + 1) % 3]));
  }
  // The midpoints of the sides between old faces.
  std::sort(sides.begin(), sides.end());
  for (std::size_t i = 1; i < sides.size(); ++i) {
    if (sides[i] != sides[i - 1]) continue;
    const auto a = static_cast<Index>(sides[i] >> 32), b = static_cast<Index>(sides[i]);
    Symmetric mean;
    for (int j = 0; j < 6; ++j) mean[j] = 0.5 * (information_[a][j] + information_[b][j]);
    if (!IsNear(0.5 * At(a) + 0.5 * At(b), mean, change)) return false;
  }
  return true;
}

// Of the direction of a face's normal, by the noise of its corners; at most 1.
double Shaper::NormalVariance(const Face& face, const Corners& c, const Change& change) const {
  const Vec3 normal = Normal(c);
  double variance = 0;
  for (int k = 0; k < 3; ++k) {
    const Vec3 side = c[(k + 1) % 3] - c[(k + 2) % 3];
    const auto& information = face[k] == kAdded ? change.information : information_[face[k]];
    variance += Dot(side, side) / Quadratic(information, normal);
  }
  return variance < 1 ? variance : 1;
}

// The squared difference of the normals of two faces, relative to what is allowed.
double Shaper::Turn(const Face& f, const Face& g, const Change& change) const {
  const Corners c = CornersOf(f, change), d = CornersOf(g, change);
  const Vec3 n = Normal(c), m = Normal(d);
  const double norms = Dot(n, n) * Dot(m, m);
  const double square = norms > 0 ? 2 - 2 * Dot(n, m) / std::sqrt(norms) : 4;
  if (square <= turn_square_) return 0;
  const double variance = NormalVariance(f, c, change) + NormalVariance(g, d, change);
  return square / (turn_square_ + noise_square_ * variance);
}

// The largest turns of faces from those around them, across lines last.
std::array<double, 2> Shaper::LargestTurns(const std::vector<Face>& faces,
                                           const Change& change) const {
  thread_local std::vector<std::tuple<std::uint64_t, std::size_t, int>> sides;
  sides.clear();
  for (std::size_t i = 0; i < faces.size(); ++i)
    for (int k = 0; k < 3; ++k) sides.emplace_back(Key(faces[i][k], faces[i][(k + 1) % 3]), i, k);
  std::sort(sides.begin(), sides.end());
  std::array<double, 2> turns{};
  for (std::size_t s = 0; s < sides.size(); ++s) {
    const auto [key, i, k] = sides[s];
    if (s + 1 < sides.size() && std::get<0>(sides[s + 1]) == key) {
      ++s;  // a side between two of the faces
      continue;
    }
    const Index a = faces[i][k], b = faces[i][(k + 1) % 3], across = FaceWithSide(b, a);
    if (across == kNone) continue;
    double& largest = turns[IsLine(a, b)];
    largest = std::max(largest, Turn(faces[i], faces_[across], change));
  }
  return turns;
}

bool Shaper::KeepsDirection(const Change& change) const {
  Vec3 mean{};
  for (const Index f : change.old_faces) mean = mean + Normal(CornersOf(faces_[f]));
  for (const Face& f : change.faces)
    if (!(Dot(Normal(CornersOf(f, change)), mean) > 0)) return false;
  const auto after = LargestTurns(change.faces, change);
  if (after[0] <= 1 && after[1] <= 1) return true;
  std::vector<Face> old;
  for (const Index f : change.old_faces) old.push_back(faces_[f]);
  const auto before = LargestTurns(old, change);
  return after[0] <= std::max(before[0], 1.0) && after[1] <= std::max(before[1], 1.0);
}

bool Shaper::IsAllowed(const Change& change) const {
  return KeepsPoints(change) && KeepsDirection(change);
}

Proposal Shaper::BestFor(Index face) const {
  if (costs_[face] <= kBad) return {};
  std::vector<Proposal> proposals;
  const auto add = [&](Proposal proposal) {
    Change change;
    if (!Make(proposal, change)) return;
    proposal.gain = change.gain;
    proposals.push_back(proposal);
  };
  for (int k = 0; k < 3; ++k) {
    const Index a = faces_[face][k], b = faces_[face][(k + 1) % 3];
    for (const auto& [from, to] : {std::pair{a, b}, std::pair{b, a}})
      if (CanCollapse(from, to))
        proposals.push_back({CollapseGain(from, to), Kind::kCollapse, from, to, kNone, 0});
    add({0, Kind::kSwap, a, b, kNone, 0});
  }
  const auto best = [&]() -> Proposal {
    std::stable_sort(proposals.begin(), proposals.end(),
                     [](const Proposal& p, const Proposal& q) { return p.gain > q.gain; });
    for (const Proposal& proposal : proposals) {
      Change change;
      if (Make(proposal, change) && IsAllowed(change)) return proposal;
    }
    return {};
  };
  if (const Proposal found = best(); found.gain > 0) return found;
  // New vertices only where nothing else helps.
  proposals.clear();
  for (const double height : kHeights) add({0, Kind::kInsert, kNone, kNone, face, height});
  return best();
}

// The best proposals, no two of which have a vertex in common.
std::vector<Change> Shaper::Choose() {
  std::vector<Index> order;
  for (std::size_t f = 0; f < faces_.size(); ++f)
    if (is_alive_[f] && proposals_[f].gain > 0) order.push_back(static_cast<Index>(f));
  std::stable_sort(order.begin(), order.end(),
                   [&](Index f, Index g) { return proposals_[f].gain > proposals_[g].gain; });
  std::vector<char> is_taken(vertices_.size());
  std::vector<Change> changes;
  for (const Index f : order) {
    Change change;
    if (!Make(proposals_[f], change)) continue;
    bool is_free = true;
    for (const Index g : change.old_faces)
      for (const Index v : faces_[g]) is_free = is_free && !is_taken[v];
    if (!is_free || !IsAllowed(change)) continue;
    for (const Index g : change.old_faces)
      for (const Index v : faces_[g]) is_taken[v] = 1;
    proposals_[f] = {};
    changes.push_back(std::move(change));
  }
  return changes;
}

// Gives the new vertex of a change a number.
void Shaper::Number(Change& change) {
  const auto number = static_cast<Index>(vertices_.size());
  bool is_new = false;
  for (Face& face : change.faces)
    for (Index& v : face)
      if (v == kAdded) v = number, is_new = true;
  if (!is_new) return;
  vertices_.push_back(change.added);
  information_.push_back(change.information);
  stays_.push_back(0);
  faces_of_.emplace_back();
  lines_of_.emplace_back();
}

void Shaper::Apply(const Change& change) {
  std::vector<Index> points;
  if (change.removed != kNone && !change.is_on_line) points.push_back(change.removed);
  for (const Index f : change.old_faces) {
    points.insert(points.end(), points_of_[f].begin(), points_of_[f].end());
    points_of_[f].clear();
  }
  const std::vector<Index> places = Replace(change);
  costs_.resize(faces_.size());
  points_of_.resize(faces_.size());
  proposals_.resize(faces_.size());
  for (const Index f : places) costs_[f] = Cost(CornersOf(faces_[f]));
  for (const Index v : points) {
    double least = std::numeric_limits<double>::infinity();
    Index nearest = places[0];
    for (const Index f : places) {
      const Vec3 off = At(v) - ClosestOnTriangle(At(v), CornersOf(faces_[f]));
      const double square = Quadratic(information_[v], off);
      if (square < least) least = square, nearest = f;
    }
    points_of_[nearest].push_back(v);
  }
}

void Shaper::Run() {
  std::vector<char> is_tried(vertices_.size(), 1);  // at which faces propose anew
  for (int round = 0; round < kMaxRounds; ++round) {
    ParallelChunks(static_cast<std::int64_t>(faces_.size()), num_threads_,
                   [&](std::int64_t begin, std::int64_t end) {
                     for (std::int64_t f = begin; f < end; ++f) {
                       const auto& [a, b, c] = faces_[f];
                       if (is_alive_[f] && (is_tried[a] || is_tried[b] || is_tried[c]))
                         proposals_[f] = BestFor(static_cast<Index>(f));
                     }
                   });
    std::vector<Change> changes = Choose();
    if (changes.empty()) return;
    for (Change& change : changes) Number(change);
    RemoveColliding(changes);
    is_tried.assign(vertices_.size(), 0);
    for (const Change& change : changes) {
      Apply(change);
      for (const Face& face : change.faces)
        for (const Index v : face) is_tried[v] = 1;
    }
  }
}

}  // namespace

EditedMesh Shape(const RefinementInput& input, const ShapingOptions& options, int num_threads) {
  CheckInput(input);
  Shaper shaper(input, options, num_threads);
  shaper.Run();
  return shaper.Result();
}

}  // namespace mesher
