// SPDX-License-Identifier: GPL-3.0-or-later
#include "intersections.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/box_intersection_d.h>
#include <CGAL/intersections.h>

#include <algorithm>
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

Point ToPoint(const Vec3& p) { return {p.x, p.y, p.z}; }

class Tester {
 public:
  Tester(const Faces3& faces, const std::vector<Vec3>& vertices, const std::vector<Index>& same)
      : faces_(faces), vertices_(vertices), same_(same) {}

  Box BoxOf(Index f) const {
    const Vec3 &a = At(f, 0), &b = At(f, 1), &c = At(f, 2);
    double low[3], high[3];
    for (int i = 0; i < 3; ++i) {
      low[i] = std::min({a[i], b[i], c[i]});
      high[i] = std::max({a[i], b[i], c[i]});
    }
    return {low, high, f};
  }

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
                                const std::vector<Index>& same, const std::vector<char>& is_tested,
                                int num_threads) {
  const Tester tester(faces, vertices, same);
  std::vector<Box> tested, others;
  for (Index f = 0; f < static_cast<Index>(faces.size()); ++f)
    (is_tested[f] ? tested : others).push_back(tester.BoxOf(f));
  std::vector<Pair> pairs;
  const auto add = [&](const Box& a, const Box& b) { pairs.emplace_back(a.info(), b.info()); };
  CGAL::box_self_intersection_d(tested.begin(), tested.end(), add);
  CGAL::box_intersection_d(tested.begin(), tested.end(), others.begin(), others.end(), add);
  std::vector<char> intersect(pairs.size());
  ParallelChunks(static_cast<std::int64_t>(pairs.size()), num_threads,
                 [&](std::int64_t begin, std::int64_t end) {
                   for (std::int64_t i = begin; i < end; ++i)
                     intersect[i] = tester.Intersect(pairs[i].first, pairs[i].second);
                 });
  std::vector<Pair> found;
  for (std::size_t i = 0; i < pairs.size(); ++i)
    if (intersect[i]) found.push_back(std::minmax(pairs[i].first, pairs[i].second));
  std::sort(found.begin(), found.end());
  return found;
}

void TakeBack(const Faces3& faces, const std::vector<Vec3>& before, int num_threads,
              std::vector<Vec3>& after) {
  const std::vector<Index> same = FirstAtPlace(before);
  std::vector<char> is_tested(faces.size());
  for (std::size_t f = 0; f < faces.size(); ++f)
    is_tested[f] = std::any_of(faces[f].begin(), faces[f].end(),
                               [&](Index v) { return !(after[v] == before[v]); });
  for (int attempt = 0;; ++attempt) {
    std::vector<char> is_bad(faces.size());
    for (std::size_t f = 0; f < faces.size(); ++f)
      is_bad[f] = is_tested[f] && Dot(Normal(faces[f], before), Normal(faces[f], after)) <= 0 &&
                  Norm(Normal(faces[f], before)) > 0;
    for (const auto& [f, g] : Intersections(faces, after, same, is_tested, num_threads))
      is_bad[f] = is_bad[g] = 1;
    // Only faces at vertices that are taken back can differ in the next attempt.
    std::vector<char> is_changed(before.size());
    for (std::size_t f = 0; f < faces.size(); ++f)
      if (is_bad[f])
        for (const Index v : faces[f]) is_changed[v] = !(after[v] == before[v]);
    if (std::none_of(is_changed.begin(), is_changed.end(), [](char c) { return c; })) return;
    for (std::size_t v = 0; v < before.size(); ++v)
      if (is_changed[v])
        after[v] = attempt < kHalvings ? 0.5 * before[v] + 0.5 * after[v] : before[v];
    for (std::size_t f = 0; f < faces.size(); ++f)
      is_tested[f] = std::any_of(faces[f].begin(), faces[f].end(),
                                 [&](Index v) { return is_changed[v] != 0; });
  }
}

}  // namespace mesher
