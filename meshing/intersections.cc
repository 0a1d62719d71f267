// SPDX-License-Identifier: GPL-3.0-or-later
#include "intersections.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/box_intersection_d.h>
#include <CGAL/intersections.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numeric>

#include "parallel.h"

namespace mesher {
namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Point = Kernel::Point_3;
using Box = CGAL::Box_intersection_d::Box_with_info_d<double, 3, Index>;
using Pair = std::pair<Index, Index>;

// Motions are halved this many times before they are taken back as a whole.
constexpr int kHalvings = 3;
// Boxes are sorted out one by one where so few are left: CGAL's 10 takes twice as long.
constexpr std::ptrdiff_t kFewBoxes = 1000;

Point ToPoint(const Vec3& p) { return {p.x, p.y, p.z}; }

class Tester {
 public:
  Tester(const Faces3& faces, const std::vector<Vec3>& vertices, const std::vector<Index>& same)
      : faces_(faces), vertices_(vertices), same_(same) {}

  // Whether two faces share more than their common vertices and side.
  bool Intersect(Index f, Index g) const {
    int of_f[3], of_g[3], count = 0;
    for (int i = 0; i < 3; ++i)
      for (int j = 0; j < 3; ++j)
        if (same_[faces_[f][i]] == same_[faces_[g][j]] && count < 3)
          of_f[count] = i, of_g[count++] = j;
    if (count < 2 && (IsBeside(f, g, of_f, count) || IsBeside(g, f, of_g, count))) return false;
    if (count == 0) return CGAL::do_intersect(Triangle(f), Triangle(g));
    if (count == 1)
      return CGAL::do_intersect(Opposite(f, of_f[0]), Triangle(g)) ||
             CGAL::do_intersect(Opposite(g, of_g[0]), Triangle(f));
    if (count == 2) return IsFold(f, of_f[0], of_f[1], g, of_g[0], of_g[1]);
    return false;
  }

 private:
  const Vec3& At(Index f, int corner) const { return vertices_[faces_[f][corner % 3]]; }
  Kernel::Triangle_3 Triangle(Index f) const {
    return {ToPoint(At(f, 0)), ToPoint(At(f, 1)), ToPoint(At(f, 2))};
  }
  Kernel::Segment_3 Opposite(Index f, int corner) const {
    return {ToPoint(At(f, corner + 1)), ToPoint(At(f, corner + 2))};
  }
  // Whether the corners of `f` but for the first `count` of `common` certainly lie on one side of
  // the plane of `g`.
  bool IsBeside(Index f, Index g, const int* common, int count) const {
    const Vec3& origin = At(g, 0);
    const Vec3 normal = Cross(At(g, 1) - origin, At(g, 2) - origin);
    int sides = 0, tested = 0;
    for (int corner = 0; corner < 3; ++corner) {
      if (count == 1 && corner == common[0]) continue;
      const Vec3 offset = At(f, corner) - origin;
      const double height = Dot(normal, offset), sure = 1e-9 * Norm(normal) * Norm(offset);
      sides += height > sure ? 1 : height < -sure ? -1 : 0;
      ++tested;
    }
    return sides == tested || sides == -tested;
  }
  // Whether two faces on the same side of their common one overlap.
  bool IsFold(Index f, int f0, int f1, Index g, int g0, int g1) const {
    const Point a = ToPoint(At(f, f0)), b = ToPoint(At(f, f1));
    const Point c = ToPoint(At(f, 3 - f0 - f1)), d = ToPoint(At(g, 3 - g0 - g1));
    return CGAL::coplanar(a, b, c, d) && !CGAL::collinear(a, b, c) &&
           CGAL::coplanar_orientation(a, b, c, d) == CGAL::POSITIVE;
  }

  const Faces3& faces_;
  const std::vector<Vec3>& vertices_;
  const std::vector<Index>& same_;
};

Vec3 Normal(const std::array<Index, 3>& face, const std::vector<Vec3>& at) {
  return Cross(at[face[1]] - at[face[0]], at[face[2]] - at[face[0]]);
}

// Pairs of faces whose boxes, around their corners at both times, meet. One of each pair is chosen.
std::vector<Pair> MeetingBoxes(const Faces3& faces, const std::vector<Vec3>& before,
                               const std::vector<Vec3>& after, const std::vector<char>& is_chosen) {
  std::vector<Box> chosen, others;
  for (std::size_t f = 0; f < faces.size(); ++f) {
    Box box(false);
    for (const Index v : faces[f])
      for (const Vec3& p : {before[v], after[v]}) {
        double point[] = {p.x, p.y, p.z};
        box.extend(point);
      }
    box = {box.bbox(), static_cast<Index>(f)};
    (is_chosen[f] ? chosen : others).push_back(box);
  }
  std::vector<Pair> pairs;
  const auto add = [&](const Box& a, const Box& b) {
    pairs.push_back(std::minmax(a.info(), b.info()));
  };
  CGAL::box_self_intersection_d(chosen.begin(), chosen.end(), add, kFewBoxes);
  CGAL::box_intersection_d(chosen.begin(), chosen.end(), others.begin(), others.end(), add,
                           kFewBoxes);
  return pairs;
}

struct Extent {
  Vec3 low, high;

  bool Meets(const Extent& other) const {
    for (int axis = 0; axis < 3; ++axis)
      if (low[axis] > other.high[axis] || high[axis] < other.low[axis]) return false;
    return true;
  }
};

Extent ExtentOf(const std::array<Index, 3>& face, const std::vector<Vec3>& at) {
  Extent extent{at[face[0]], at[face[0]]};
  for (const Index v : face)
    for (int axis = 0; axis < 3; ++axis) {
      extent.low[axis] = std::min(extent.low[axis], at[v][axis]);
      extent.high[axis] = std::max(extent.high[axis], at[v][axis]);
    }
  return extent;
}

// Tells most of the extents that meet none of some given ones, by the cells of a grid, of which
// several share a bit.
class Occupancy {
 public:
  explicit Occupancy(const std::vector<Extent>& extents) : is_taken_(std::size_t{1} << 18) {
    std::vector<double> sizes;
    for (const Extent& e : extents)
      sizes.push_back(std::max({e.high.x - e.low.x, e.high.y - e.low.y, e.high.z - e.low.z}));
    const auto middle = sizes.begin() + sizes.size() / 2;
    std::nth_element(sizes.begin(), middle, sizes.end());
    scale_ = *middle > 0 ? 0.5 / *middle : 0;
    for (const Extent& e : extents)
      if (!Visit(e, [&](std::size_t bit) { return is_taken_[bit] = true; })) large_.push_back(e);
  }

  bool MayMeet(const Extent& extent) const {
    bool is_met = false;
    if (!Visit(extent, [&](std::size_t bit) { return !(is_met = is_taken_[bit]); }) || is_met)
      return true;
    return std::any_of(large_.begin(), large_.end(),
                       [&](const Extent& e) { return e.Meets(extent); });
  }

 private:
  // Calls a function with the bit of each cell of an extent until it returns false; returns whether
  // the extent has few cells, otherwise none is visited.
  template <typename Function>
  bool Visit(const Extent& extent, const Function& function) const {
    std::int64_t low[3], high[3], count = 1;
    for (int axis = 0; axis < 3; ++axis) {
      const double first = std::floor(scale_ * extent.low[axis]);
      const double last = std::floor(scale_ * extent.high[axis]);
      if (!(std::abs(first) < 1e9 && std::abs(last) < 1e9 && last - first < 64)) return false;
      low[axis] = static_cast<std::int64_t>(first);
      high[axis] = static_cast<std::int64_t>(last);
      count *= high[axis] - low[axis] + 1;
    }
    if (count > 64) return false;
    for (auto x = low[0]; x <= high[0]; ++x)
      for (auto y = low[1]; y <= high[1]; ++y)
        for (auto z = low[2]; z <= high[2]; ++z) {
          const auto hash = static_cast<std::uint64_t>(x * 73856093 ^ y * 19349663 ^ z * 83492791);
          if (!function(hash % is_taken_.size())) return true;
        }
    return true;
  }

  double scale_ = 0;
  std::vector<bool> is_taken_;
  std::vector<Extent> large_;
};

// Those of the pairs that share more than a vertex or a side.
std::vector<Pair> Intersecting(const Tester& tester, const std::vector<Pair>& pairs,
                               int num_threads) {
  std::vector<char> intersect(pairs.size());
  ParallelChunks(static_cast<std::int64_t>(pairs.size()), num_threads,
                 [&](std::int64_t begin, std::int64_t end) {
                   for (std::int64_t i = begin; i < end; ++i)
                     intersect[i] = tester.Intersect(pairs[i].first, pairs[i].second);
                 });
  std::vector<Pair> found;
  for (std::size_t i = 0; i < pairs.size(); ++i)
    if (intersect[i]) found.push_back(pairs[i]);
  return found;
}

}  // namespace

std::vector<Index> FirstAtPlace(const std::vector<Vec3>& vertices) {
  std::vector<Index> order(vertices.size()), first(vertices.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](Index a, Index b) {
    return vertices[a] < vertices[b] || (vertices[a] == vertices[b] && a < b);
  });
  for (std::size_t i = 0; i < order.size(); ++i) {
    const bool is_same = i > 0 && vertices[order[i]] == vertices[order[i - 1]];
    first[order[i]] = is_same ? first[order[i - 1]] : order[i];
  }
  return first;
}

std::vector<Pair> Intersections(const Faces3& faces, const std::vector<Vec3>& vertices,
                                int num_threads) {
  const std::vector<Index> same = FirstAtPlace(vertices);
  auto found = Intersecting(
      Tester(faces, vertices, same),
      MeetingBoxes(faces, vertices, vertices, std::vector<char>(faces.size(), 1)), num_threads);
  std::sort(found.begin(), found.end());
  return found;
}

std::vector<char> Collisions(const Faces3& new_faces, const std::vector<Index>& groups,
                             const Faces3& faces, const std::vector<Index>& replaced_by,
                             const std::vector<Vec3>& vertices, int num_threads) {
  if (new_faces.empty()) return {};
  std::vector<Extent> extents;
  for (const auto& face : new_faces) extents.push_back(ExtentOf(face, vertices));
  const Occupancy occupancy(extents);
  Faces3 all = new_faces;
  std::vector<Index> group_of = groups;  // those that the faces belong to, or are replaced by
  for (std::size_t f = 0; f < faces.size(); ++f)
    if (occupancy.MayMeet(ExtentOf(faces[f], vertices))) {
      all.push_back(faces[f]);
      group_of.push_back(replaced_by[f]);
    }
  const auto count = static_cast<Index>(new_faces.size());
  std::vector<char> is_new(all.size());
  std::fill_n(is_new.begin(), count, 1);
  std::vector<Pair> pairs = MeetingBoxes(all, vertices, vertices, is_new);
  const auto is_replaced = [&](const Pair& pair) {
    return pair.second >= count && group_of[pair.second] == group_of[pair.first];
  };
  pairs.erase(std::remove_if(pairs.begin(), pairs.end(), is_replaced), pairs.end());
  const std::vector<Index> same = FirstAtPlace(vertices);
  std::vector<char> collides(*std::max_element(groups.begin(), groups.end()) + 1);
  for (const auto& [f, g] : Intersecting(Tester(all, vertices, same), pairs, num_threads))
    collides[g < count ? std::max(group_of[f], group_of[g]) : group_of[f]] = 1;
  return collides;
}

void TakeBack(const Faces3& faces, const std::vector<Vec3>& before, int num_threads,
              std::vector<Vec3>& after) {
  const std::vector<Index> same = FirstAtPlace(before);
  const Tester tester(faces, after, same);
  std::vector<char> is_changed(before.size()), is_tested(faces.size());
  for (std::size_t v = 0; v < before.size(); ++v) is_changed[v] = !(after[v] == before[v]);
  std::vector<Pair> pairs;
  for (int attempt = 0;; ++attempt) {
    for (std::size_t f = 0; f < faces.size(); ++f)
      is_tested[f] = is_changed[faces[f][0]] || is_changed[faces[f][1]] || is_changed[faces[f][2]];
    if (attempt == 0) pairs = MeetingBoxes(faces, before, after, is_tested);
    std::vector<Pair> changed;
    for (const auto& pair : pairs)
      if (is_tested[pair.first] || is_tested[pair.second]) changed.push_back(pair);
    std::vector<char> is_bad(faces.size());
    for (std::size_t f = 0; f < faces.size(); ++f) {
      const Vec3 normal = Normal(faces[f], before);
      is_bad[f] = is_tested[f] && Norm(normal) > 0 && Dot(normal, Normal(faces[f], after)) <= 0;
    }
    for (const auto& [f, g] : Intersecting(tester, changed, num_threads)) is_bad[f] = is_bad[g] = 1;
    std::fill(is_changed.begin(), is_changed.end(), 0);
    bool has_changed = false;
    for (std::size_t f = 0; f < faces.size(); ++f)
      for (const Index v : faces[f])
        if (is_bad[f] && !(after[v] == before[v])) is_changed[v] = has_changed = true;
    if (!has_changed) return;
    for (std::size_t v = 0; v < before.size(); ++v)
      if (is_changed[v])
        after[v] = attempt < kHalvings ? 0.5 * before[v] + 0.5 * after[v] : before[v];
  }
}

}  // namespace mesher
