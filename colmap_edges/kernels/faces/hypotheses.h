// Greedy choice of planes among candidates, by the weight of the points on them.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <numeric>
#include <optional>
#include <queue>
#include <utility>
#include <vector>

#include "common/piecewise.h"
#include "faces/plane_points.h"

namespace colmap_edges {

struct PlaneSearchOptions {
  double tolerance;         // maximum distance of a point from its plane, in deviations
  double min_share;         // minimum share of all weight on a plane
  double explained_weight;  // weight of points already on one plane
  double same_share;        // minimum share of shared points of duplicate planes
  double snap_gain;         // minimum share of a plane's support kept with a common normal
  int max_planes;
};

class PlaneSearch {
 public:
  // weights: (N) of the given points; common: normals that many planes have.
  PlaneSearch(const PlanePoints& points, const double* weights, std::vector<Vec3> common,
              const PlaneSearchOptions& options)
      : points_(points),
        options_(options),
        common_(std::move(common)),
        whole_(64 * points.num_blocks(), 0) {
    for (size_t i = 0; i < points.size(); ++i) total_ += whole_[i] = weights[points.given(i)];
  }

  // One plane after the other, each with the most support by points that are not on others yet, and
  // then, if wanted, those at which others end; the second number is how many the first are.
  std::pair<std::vector<Plane>, size_t> Run(const std::vector<Plane>& planes, bool with_ends) {
    const double least = options_.min_share * total_;
    weights_ = whole_;
    Score(planes, least);
    std::vector<Plane> found;
    std::vector<PointSet> owned;
    std::vector<Tried> tried;
    // Weights only decrease, so a candidate is weighed again only when no other may have more.
    std::priority_queue<std::pair<double, int64_t>> queue;  // the first of equals first
    for (size_t c = 0; c < candidates_.size(); ++c)
      queue.emplace(Support(candidates_[c]), -int64_t(c));
    while (int(found.size()) < options_.max_planes && !queue.empty()) {
      const auto [left, key] = queue.top();
      queue.pop();
      if (left < least) break;
      Candidate& best = candidates_[-key];
      if (best.seen < tried.size()) {
        if (IsOpen(tried, &best)) queue.emplace(Support(best), key);
        continue;
      }
      std::optional<Plane> plane = Fitted(best.plane);
      if (!plane) continue;
      plane = Snapped(*plane);
      const PointSet own = On(*plane, options_.tolerance);
      tried.push_back({plane->normal, {}});
      for (size_t b = 0; b < own.size(); ++b)
        if (own[b]) tried.back().points.emplace_back(b, own[b]);
      bool is_new = true;
      for (size_t k = 0; k < found.size() && is_new; ++k)
        is_new = !AreSame(own, owned[k], MostShared(plane->normal, found[k].normal));
      if (!is_new) continue;
      VisitPoints(own.data(), own.size(), [&](size_t i) {
        weights_[i] *= 1 - (1 - options_.explained_weight) * Closeness(*plane, i);
      });
      found.push_back(*plane), owned.push_back(own);
    }
    const size_t count = found.size();
    if (with_ends) AddEnds(&found, std::move(owned));
    return {found, count};
  }

 private:
  struct Tried {
    Vec3 normal;
    std::vector<std::pair<size_t, uint64_t>> points;  // the blocks of the set that are not empty
  };

  struct Candidate {
    Plane plane;
    double weight;    // of what lies on it
    size_t first;     // of its words
    size_t seen = 0;  // number of tried planes that it is known to differ from
  };

  // 1 for a point on a plane, 0 for one at the tolerance, as in MSAC (Torr, Zisserman 2000): the
  // points of a picture hardly count for the plane of the wall behind it.
  double Closeness(const Plane& plane, size_t i, double factor = 1) const {
    const double off = plane.Distance(points_.point(i)) / (factor * options_.tolerance);
    return std::max(0.0, 1 - off * off / points_.Variance(i, plane.normal));
  }

  double Support(const Candidate& candidate) const {
    double sum = 0;
    VisitPoints(&words_[candidate.first], points_.num_blocks(),
                [&](size_t i) { sum += weights_[i] * Closeness(candidate.plane, i); });
    return sum;
  }

  void Score(const std::vector<Plane>& planes, double least) {
    PointSet words(points_.num_blocks());
    for (const Plane& plane : planes) {
      points_.FindOn(plane, options_.tolerance, words.data());
      const double weight = Weight(words.data(), whole_);
      if (weight < least) continue;
      candidates_.push_back({plane, weight, words_.size()});
      words_.insert(words_.end(), words.begin(), words.end());
    }
  }

  // Adds planes with common normals that share most of their points with one that ends there: a
  // wall may be known by its line with the ceiling alone, which makes it a duplicate of the
  // ceiling.
  void AddEnds(std::vector<Plane>* found, std::vector<PointSet> owned) {
    std::vector<std::pair<double, const Candidate*>> ends;
    for (const Candidate& candidate : candidates_)
      if (IsCommon(candidate.plane.normal)) ends.emplace_back(-candidate.weight, &candidate);
    std::stable_sort(ends.begin(), ends.end(),
                     [](const auto& a, const auto& b) { return a.first < b.first; });
    const size_t count = found->size();
    for (const auto& [weight, candidate] : ends) {
      if (found->size() - count >= size_t(options_.max_planes)) return;
      const Plane plane = Moved(candidate->plane);
      const PointSet own = On(plane, options_.tolerance);
      bool is_end = false, is_new = true;
      for (size_t k = 0; k < found->size() && is_new; ++k) {
        if (!AreSame(own, owned[k], options_.same_share)) continue;
        is_new = std::abs(Dot(plane.normal, (*found)[k].normal)) < kSnapCosine;
        is_end = is_end || (k < count && Ends(owned[k], plane));
      }
      if (is_new && is_end) found->push_back(plane), owned.push_back(own);
    }
  }

  // The parallel plane in the middle of what lies on a plane.
  Plane Moved(const Plane& plane) const {
    double sum = 0, total = 0;
    const PointSet on = On(plane, options_.tolerance);
    VisitPoints(on.data(), on.size(), [&](size_t i) {
      const double sure = whole_[i] / points_.Variance(i, plane.normal);
      total += sure, sum += sure * Dot(plane.normal, points_.point(i));
    });
    return {plane.normal, sum / total};
  }

  bool IsCommon(const Vec3& normal) const {
    return std::any_of(common_.begin(), common_.end(),
                       [&](const Vec3& other) { return std::abs(Dot(other, normal)) > 1 - 1e-9; });
  }

  // Whether the points of a plane lie on one side of another one.
  bool Ends(const PointSet& points, const Plane& other) const {
    double sides[2] = {};
    VisitPoints(points.data(), points.size(), [&](size_t i) {
      const double off = other.Distance(points_.point(i)) / options_.tolerance;
      if (off * off > points_.Variance(i, other.normal)) sides[off > 0] += whole_[i];
    });
    return std::min(sides[0], sides[1]) <= kBeyond * std::max(sides[0], sides[1]);
  }

  // Whether not too much of a candidate lies on any tried plane.
  bool IsOpen(const std::vector<Tried>& tried, Candidate* candidate) const {
    for (; candidate->seen < tried.size(); ++candidate->seen) {
      const Tried& other = tried[candidate->seen];
      double shared = 0;
      for (const auto& [b, word] : other.points) {
        const uint64_t both = word & words_[candidate->first + b];
        VisitPoints(&both, 1, [&, at = &whole_[64 * b]](size_t i) { shared += at[i]; });
      }
      if (shared > MostShared(candidate->plane.normal, other.normal) * candidate->weight)
        return false;
    }
    return true;
  }

  PointSet On(const Plane& plane, double tolerance) const {
    PointSet words(points_.num_blocks());
    points_.FindOn(plane, tolerance, words.data());
    return words;
  }

  double Weight(const uint64_t* words, const std::vector<double>& weights) const {
    double sum = 0;
    VisitPoints(words, points_.num_blocks(), [&](size_t i) { sum += weights[i]; });
    return sum;
  }
  double Weight(const PointSet& set) const { return Weight(set.data(), whole_); }

  // Share of the points of a plane that another plane may have. Of planes at an angle, those of a
  // slope of a roof lie on the walls around it, too.
  double MostShared(const Vec3& normal, const Vec3& other) const {
    return std::abs(Dot(normal, other)) > kParallel ? options_.same_share : kSharedAtAngle;
  }

  // Whether more than a share of what lies on one of two planes lies on the other.
  bool AreSame(const PointSet& one, const PointSet& other, double share) const {
    PointSet both(one.size());
    for (size_t b = 0; b < one.size(); ++b) both[b] = one[b] & other[b];
    return Weight(both) > share * std::min(Weight(one), Weight(other));
  }

  // The plane fitted to what is near it, the closest the most.
  std::optional<Plane> Fitted(Plane plane) const {
    for (const double factor : kFactors) {
      const PointSet on = On(plane, factor * options_.tolerance);
      const auto weigh = [&](const auto& add) {
        VisitPoints(on.data(), on.size(), [&](size_t i) {
          const double closeness = Closeness(plane, i, factor);
          add(i, closeness * weights_[i] / points_.Variance(i, plane.normal));
        });
      };
      int count = 0;
      double total = 0;
      Vec3 middle{};
      weigh([&](size_t i, double weight) {
        count += weight > 0, total += weight, middle = middle + weight * points_.point(i);
      });
      if (count < kMinPoints) return std::nullopt;
      middle = (1 / total) * middle;
      double spread[6] = {};
      weigh([&](size_t i, double weight) {
        const Vec3 off = points_.point(i) - middle;
        for (int a = 0, k = 0; a < 3; ++a)
          for (int b = a; b < 3; ++b) spread[k++] += weight * off[a] * off[b];
      });
      double values[3];
      Vec3 vectors[3];
      Eigen3(spread, values, vectors);
      // Otherwise nearly a line, which says no normal.
      if (values[1] > 0.005 * values[2]) plane.normal = vectors[0];
      plane.offset = Dot(plane.normal, middle);
    }
    return plane;
  }

  // The plane with the nearest common normal, where as much lies on that.
  Plane Snapped(const Plane& plane) const {
    const PointSet on = On(plane, options_.tolerance);
    Vec3 nearest{};
    for (const Vec3& normal : common_)
      if (std::abs(Dot(normal, plane.normal)) > std::abs(Dot(nearest, plane.normal)))
        nearest = normal;
    std::vector<double> offsets;
    VisitPoints(on.data(), on.size(),
                [&](size_t i) { offsets.push_back(Dot(nearest, points_.point(i))); });
    if (std::abs(Dot(nearest, plane.normal)) < kSnapCosine || offsets.empty()) return plane;
    std::sort(offsets.begin(), offsets.end());
    std::array<double, 17> tried;  // quantiles from 0.1 to 0.9
    for (size_t k = 0; k < tried.size(); ++k) {
      const double at = double(k + 2) / 20 * double(offsets.size() - 1);
      const size_t low = size_t(at), high = std::min(low + 1, offsets.size() - 1);
      tried[k] = offsets[low] + (at - double(low)) * (offsets[high] - offsets[low]);
    }
    // A point lies on those planes of the series that are within its tolerance.
    std::array<double, 18> support{};
    const auto add = [&](size_t i, double at) {
      const double reach = options_.tolerance * std::sqrt(points_.Variance(i, nearest));
      support[std::lower_bound(tried.begin(), tried.end(), at - reach) - tried.begin()] +=
          weights_[i];
      support[std::upper_bound(tried.begin(), tried.end(), at + reach) - tried.begin()] -=
          weights_[i];
    };
    points_.VisitNear(nearest, tried.front(), tried.back(), options_.tolerance, add);
    std::partial_sum(support.begin(), support.end(), support.begin());
    const size_t most = std::max_element(support.begin(), support.end() - 1) - support.begin();
    const PointSet best = On({nearest, tried[most]}, options_.tolerance);
    double weight = 0, sum = 0, total = 0;
    VisitPoints(best.data(), best.size(), [&](size_t i) {
      const double sure = weights_[i] / points_.Variance(i, nearest);
      weight += weights_[i], total += sure, sum += sure * Dot(nearest, points_.point(i));
    });
    if (!(weight > 0) || weight < options_.snap_gain * Weight(on.data(), weights_)) return plane;
    return {nearest, sum / total};
  }

  static constexpr double kSnapCosine = 0.984807753012208;  // of 10 degrees
  static constexpr double kParallel = 0.9396926207859084;   // of 20 degrees
  static constexpr double kSharedAtAngle = 0.95;
  static constexpr double kBeyond = 0.05;  // of a plane's points, behind the one at which it ends
  static constexpr int kMinPoints = 8;     // that a plane is fitted to
  // Of the tolerance in the steps of a fit.
  static constexpr double kFactors[] = {2, 1.4, 1, 1};

  const PlanePoints& points_;
  const PlaneSearchOptions options_;
  std::vector<Vec3> common_;
  std::vector<double> whole_;    // weights of the points
  std::vector<double> weights_;  // of the points, less on planes that are found
  double total_ = 0;
  std::vector<Candidate> candidates_;
  PointSet words_;  // of all candidates
};

}  // namespace colmap_edges
