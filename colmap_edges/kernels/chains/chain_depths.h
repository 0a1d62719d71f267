// Depths along the chains of one view. The depth hypotheses of a sample are the intersections of
// its epipolar lines with the chains of other views. Hypotheses that agree form clusters, scored
// by a likelihood ratio against accidental agreement. Dynamic programming selects one cluster or
// none per sample, such that consecutive clusters lie on the same chains of the other views.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <utility>
#include <vector>

#include "chains/epipolar_index.h"
#include "common/edge_index.h"
#include "common/parallel.h"

namespace colmap_edges {

struct ChainDepthParameters {
  double max_disagreement_px;  // between two hypotheses, along their epipolar lines
  // (256, 256) likelihood ratios of one edge against two, by the differences of the intensities
  // (0 to 255) of the dark and the bright sides in two views; 0 for no match.
  const float* side_likelihoods;
  double min_angle_sin;             // minimum sine of the angle between edge and epipolar line
  double visibility_rate;           // probability that an edge of one view is visible in another
  double detection_rate;            // probability that a visible edge is detected
  double min_log_likelihood_ratio;  // minimum log likelihood ratio of a cluster
  double break_penalty;             // of consecutive clusters without common chains
  int max_clusters;
};

// An intersection of a sample's epipolar line with a chain of a neighbour.
struct Hypothesis {
  double inverse_depth;
  double sigma;     // change of inverse depth for 1 px across the neighbour's chain
  double position;  // of the intersection on the neighbour's chain
  int32_t neighbor;
  int32_t polyline;
  float likelihood;  // likelihood ratio of its sides
};

struct Support {
  double position;
  int32_t neighbor;
  int32_t polyline;
};

struct Cluster {
  double inverse_depth = 0, sigma = 0, score = 0;
  std::vector<Support> support;  // by ascending neighbour, at most one each
};

// The range of inverse depths of a sample.
struct DepthRange {
  double low, high;
};

// The selected cluster of each sample; score 0 and no support where there is none.
struct ChainDepths {
  std::vector<double> inverse_depths, sigmas, scores;
  std::vector<int64_t> support_offsets;
  std::vector<double> positions;
  std::vector<int32_t> neighbors;
};

namespace chain_depths_internal {

// Direction in the image, at pixel x, of the projection of 3D direction d (both camera frame).
inline Vec2 ImageDirection(const Vec3& d, const Vec2& x, double focal) {
  return {focal * d[0] - x[0] * d[2], focal * d[1] - x[1] * d[2]};
}

// The range, extended along the epipolar line so that the density of intersections can be
// estimated: a range of few pixels, as near an epipole, contains little but the true one. At
// inverse depth rho, the depth in the neighbour is z = a + rho b and pixels move by speed / z^2.
inline DepthRange WithNeighborhood(const DepthRange& range, double a, double b, double speed) {
  constexpr double kLengthPx = 64, kMostTimes = 16;
  const double middle = 0.5 * (range.low + range.high), z = a + middle * b;
  // Limited, since agreement must not count if the whole range is about a pixel.
  const double extent = range.high - range.low;
  const double lacking = 0.5 * (std::min(kLengthPx * z * z / speed, kMostTimes * extent) - extent);
  if (!(z > 0) || lacking <= 0) return range;
  DepthRange wide{std::max(range.low - lacking, 0.0), range.high + lacking};
  // The depth in the neighbour must stay positive.
  if (b < 0) wide.high = std::max(range.high, std::min(wide.high, middle - 0.5 * z / b));
  return wide;
}

// Density of intersections with the chains of one neighbour.
struct Seen {
  bool visible = false;
  double density = 0;  // intersections of the right polarity per unit of inverse depth
};

class Sampler {
 public:
  Sampler(const EdgeIndex& source, const std::vector<Pair>& pairs,
          const std::vector<EpipolarIndex>& indexes, const ChainDepthParameters& p)
      : source_(source), pairs_(pairs), indexes_(indexes), p_(p), agree_(pairs.size()) {}

  // Clusters of each of `count` samples at points of the source, best first.
  std::vector<std::vector<Cluster>> Clusters(const int64_t* points, const DepthRange* ranges,
                                             size_t count);

 private:
  // The hypotheses of one sample, and the density of intersections in each neighbour.
  struct Found {
    std::vector<Hypothesis> hypotheses;
    std::vector<Seen> seen;
  };

  float Likelihood(const Sides& a, const Sides& b) const {
    const int dark = std::abs(int(a[0]) - int(b[0])), bright = std::abs(int(a[1]) - int(b[1]));
    return p_.side_likelihoods[256 * dark + bright];
  }
  // Square of the window in inverse depth within which two hypotheses agree.
  double Window2(const Hypothesis& a, const Hypothesis& b) const {
    return p_.max_disagreement_px * p_.max_disagreement_px *
           (a.sigma * a.sigma + b.sigma * b.sigma);
  }
  void Collect(int64_t i, const DepthRange& range, int32_t neighbor, Found* found);
  void Agreeing(const std::vector<Hypothesis>& hypotheses, int64_t u);
  void ScoreAll(const Found& found);
  Cluster MakeCluster(const std::vector<Hypothesis>& hypotheses, int64_t u);
  std::vector<Cluster> BestClusters(const std::vector<Hypothesis>& hypotheses);

  const EdgeIndex& source_;
  const std::vector<Pair>& pairs_;
  const std::vector<EpipolarIndex>& indexes_;
  const ChainDepthParameters& p_;
  std::vector<Found> found_;  // by sample; a member to reuse its memory
  std::vector<double> scores_;
  std::vector<int64_t> agree_;
  std::vector<EpipolarIndex::Crossed> crossed_;
};

inline std::vector<std::vector<Cluster>> Sampler::Clusters(const int64_t* points,
                                                           const DepthRange* ranges, size_t count) {
  if (found_.size() < count) found_.resize(count);
  for (size_t s = 0; s < count; ++s) {
    found_[s].hypotheses.clear();
    found_[s].seen.assign(pairs_.size(), Seen());
  }
  // Neighbour by neighbour, since consecutive samples access nearby memory.
  for (size_t n = 0; n < pairs_.size(); ++n) {
    for (size_t s = 0; s < count; ++s) Collect(points[s], ranges[s], int32_t(n), &found_[s]);
  }
  std::vector<std::vector<Cluster>> clusters(count);
  for (size_t s = 0; s < count; ++s) {
    std::vector<Hypothesis>& hypotheses = found_[s].hypotheses;
    std::sort(hypotheses.begin(), hypotheses.end(), [](const Hypothesis& a, const Hypothesis& b) {
      if (a.inverse_depth != b.inverse_depth) return a.inverse_depth < b.inverse_depth;
      if (a.neighbor != b.neighbor) return a.neighbor < b.neighbor;
      return a.position < b.position;
    });
    ScoreAll(found_[s]);
    clusters[s] = BestClusters(hypotheses);
  }
  return clusters;
}

inline void Sampler::Collect(int64_t i, const DepthRange& range, int32_t neighbor, Found* found) {
  const Pair& pair = pairs_[neighbor];
  const EdgeIndex& view = *pair.view;
  const double f = view.focal();
  std::vector<Hypothesis>& hypotheses = found->hypotheses;
  const Vec2& x = source_.point(i);
  const Vec2 toward = ImageDirection(pair.source_epipole, x, source_.focal());
  const double toward_norm = Norm(toward);
  const Vec2 &n0 = source_.normal(i), &tangent0 = source_.tangent(i);
  const double sin0 = std::abs(Cross(tangent0, toward)) / (toward_norm + 1e-300);
  if (sin0 < p_.min_angle_sin) return;
  const Sides& sides0 = source_.sides(i);
  const double polarity0 = Dot(n0, toward) / (toward_norm + 1e-300);
  const Vec3 a = Multiply(pair.rotation, {x[0] / source_.focal(), x[1] / source_.focal(), 1});
  const Vec3& b = pair.translation;
  // Along the epipolar line a pixel moves by gradient / z^2 per unit of inverse depth.
  const Vec2 gradient = {f * (b[0] * a[2] - a[0] * b[2]), f * (b[1] * a[2] - a[1] * b[2])};
  const double speed = Norm(gradient);
  if (!(speed > 0)) return;
  const Vec2 u = {gradient[0] / speed, gradient[1] / speed};
  const auto wide_range = WithNeighborhood(range, a[2], b[2], speed);
  // No structured bindings, since C++17 lambdas cannot capture them.
  const double low = range.low, high = range.high;
  const double wide_low = wide_range.low, wide_high = wide_range.high;
  const size_t before = hypotheses.size();
  int64_t count = 0;
  double nearest = wide_high, farthest = wide_low;
  const bool wide = std::abs(u[0]) > std::abs(u[1]);
  indexes_[neighbor].VisitCrossings(a, wide_low, wide_high, &crossed_, [&](int64_t s, double t) {
    const double sin = std::abs(Cross(u, view.tangent(s)));
    if (sin < p_.min_angle_sin) return;
    const float likelihood = Likelihood(sides0, view.sides(s));
    if (likelihood == 0) return;
    const int k = wide ? 0 : 1;
    const double q = view.point(s)[k], at = q + t * (view.point(view.Next(s))[k] - q);
    const double rho = (at * a[2] - f * a[k]) / (f * b[k] - at * b[2]);
    if (!(rho >= wide_low && rho <= wide_high)) return;
    ++count;
    nearest = std::min(nearest, rho), farthest = std::max(farthest, rho);
    if (!(rho >= low && rho <= high)) return;
    constexpr double kSure = 0.1;  // closer to the epipolar line, the sign is not reliable
    // The direction from the source's centre to the neighbour's is that of -u.
    const double polarity = -Dot(view.normal(s), u);
    if (polarity * polarity0 < 0 && std::min(std::abs(polarity), std::abs(polarity0)) > kSure) {
      return;
    }
    const double z = a[2] + rho * b[2];
    const double sigma = z * z / (speed * std::min(sin, sin0));
    hypotheses.push_back({rho, sigma, double(s) + t, neighbor, view.polyline(s), likelihood});
  });
  if (hypotheses.size() == before) return;
  Seen& seen = found->seen[neighbor];
  seen.visible = true;
  // n intersections span (n - 1) / (n + 1) of the visible part of the range on average. Half of
  // them have the wrong polarity.
  const double span = (farthest - nearest) * double(count + 1) / std::max(double(count - 1), 0.1);
  seen.density =
      0.5 * double(count) / std::clamp(span, 0.05 * (wide_high - wide_low), wide_high - wide_low);
}

// Writes to agree_ the nearest agreeing hypothesis of each neighbour for hypothesis u.
inline void Sampler::Agreeing(const std::vector<Hypothesis>& hypotheses, int64_t u) {
  const int64_t count = int64_t(hypotheses.size());
  const Hypothesis& center = hypotheses[u];
  std::fill(agree_.begin(), agree_.end(), -1);
  agree_[center.neighbor] = u;
  const auto consider = [&](int64_t v, double gap) {
    const Hypothesis& other = hypotheses[v];
    if (gap * gap > Window2(center, other)) return;
    int64_t& held = agree_[other.neighbor];
    if (held < 0 || gap < std::abs(hypotheses[held].inverse_depth - center.inverse_depth)) {
      held = v;
    }
  };
  const double reach = 4 * p_.max_disagreement_px * center.sigma;
  for (int64_t v = u - 1; v >= 0; --v) {
    const double gap = center.inverse_depth - hypotheses[v].inverse_depth;
    if (gap > reach) break;
    consider(v, gap);
  }
  for (int64_t v = u + 1; v < count; ++v) {
    const double gap = hypotheses[v].inverse_depth - center.inverse_depth;
    if (gap > reach) break;
    consider(v, gap);
  }
}

// Likelihood ratio of the difference of two agreeing hypotheses, true edge against chance, given
// the square of its fraction of the window: a Gaussian with sigma of half the window, and outliers.
inline double GapLikelihood(double share2) {
  constexpr double kAnywhere = 0.2, kSpread = 0.5;
  constexpr double kMean = 0.598144;  // mean of the Gaussian over the window
  return kAnywhere + (1 - kAnywhere) / kMean * std::exp(-0.5 * share2 / (kSpread * kSpread));
}

// Log likelihood ratio of the agreement with each hypothesis, true edge against chance. A neighbour
// agrees by chance with the probability x / (1 + x) for x expected intersections in the window of
// two hypotheses. Distances and side similarities are further factors.
inline void Sampler::ScoreAll(const Found& found) {
  const std::vector<Hypothesis>& hypotheses = found.hypotheses;
  const double q = p_.detection_rate;
  scores_.resize(hypotheses.size());
  for (size_t u = 0; u < hypotheses.size(); ++u) {
    Agreeing(hypotheses, int64_t(u));
    int count = 0;
    for (const int64_t v : agree_) count += v >= 0;
    if (count < 2) {
      scores_[u] = -std::numeric_limits<double>::infinity();
      continue;
    }
    const double sigma = hypotheses[u].sigma;
    double ratio = 1;
    for (size_t n = 0; n < pairs_.size(); ++n) {
      if (!found.seen[n].visible) continue;
      const double other = agree_[n] >= 0 ? hypotheses[agree_[n]].sigma : sigma;
      const double window = std::sqrt(2.0) * p_.max_disagreement_px * (sigma + other);
      const double x = std::clamp(window * found.seen[n].density, 0.02, 50.0);
      double seen = (1 - q) * (1 + x);
      if (agree_[n] >= 0) {
        const Hypothesis &own = hypotheses[u], &agreeing = hypotheses[agree_[n]];
        seen = q * (1 + x) / x * agreeing.likelihood;
        const double gap = agreeing.inverse_depth - own.inverse_depth;
        if (agree_[n] != int64_t(u)) seen *= GapLikelihood(gap * gap / Window2(own, agreeing));
      }
      ratio *= p_.visibility_rate * seen + 1 - p_.visibility_rate;
    }
    scores_[u] = std::log(ratio);
  }
}

inline Cluster Sampler::MakeCluster(const std::vector<Hypothesis>& hypotheses, int64_t u) {
  Agreeing(hypotheses, u);
  Cluster cluster;
  cluster.score = scores_[u];
  double weights = 0, sum = 0;
  for (const int64_t v : agree_) {
    if (v < 0) continue;
    const Hypothesis& h = hypotheses[v];
    weights += 1 / (h.sigma * h.sigma), sum += h.inverse_depth / (h.sigma * h.sigma);
    cluster.support.push_back({h.position, h.neighbor, h.polyline});
  }
  cluster.inverse_depth = sum / weights, cluster.sigma = 1 / std::sqrt(weights);
  return cluster;
}

// The best clusters, no two of which agree with each other.
inline std::vector<Cluster> Sampler::BestClusters(const std::vector<Hypothesis>& hypotheses) {
  std::vector<Cluster> kept;
  while (int(kept.size()) < p_.max_clusters) {
    const int64_t best = std::max_element(scores_.begin(), scores_.end()) - scores_.begin();
    if (best == int64_t(scores_.size()) || std::isinf(scores_[best])) break;
    kept.push_back(MakeCluster(hypotheses, best));
    const double reach = p_.max_disagreement_px * hypotheses[best].sigma;
    for (size_t v = 0; v < hypotheses.size(); ++v) {
      if (int64_t(v) == best ||
          std::abs(hypotheses[v].inverse_depth - kept.back().inverse_depth) < reach) {
        scores_[v] = -std::numeric_limits<double>::infinity();
      }
    }
  }
  return kept;
}

// Number of neighbours in which two clusters lie on one chain, about `steps` points apart.
inline int CountFollowed(const Cluster& from, const Cluster& to, const std::vector<Pair>& pairs,
                         double steps) {
  int count = 0;
  for (size_t i = 0, j = 0; i < from.support.size() && j < to.support.size();) {
    const Support &a = from.support[i], &b = to.support[j];
    if (a.neighbor != b.neighbor) {
      (a.neighbor < b.neighbor ? i : j) += 1;
      continue;
    }
    if (a.polyline == b.polyline) {
      const double moved =
          std::abs(pairs[a.neighbor].view->Steps(a.polyline, a.position, b.position));
      count += moved < 4 * steps;
    }
    ++i, ++j;
  }
  return count;
}

// Viterbi over the samples of one chain; returns the selected cluster of each sample or -1.
inline std::vector<int> Decode(const std::vector<std::vector<Cluster>>& states,
                               const std::vector<Pair>& pairs, double steps,
                               const ChainDepthParameters& p) {
  const int64_t count = int64_t(states.size());
  std::vector<std::vector<double>> score(count);
  std::vector<std::vector<int>> back(count);
  for (int64_t t = 0; t < count; ++t) {
    const int n = int(states[t].size());
    score[t].assign(n + 1, 0), back[t].assign(n + 1, 0);
    const int before = t > 0 ? int(states[t - 1].size()) : 0;
    for (int k = 0; k <= n; ++k) {
      const double own = k < n ? states[t][k].score - p.min_log_likelihood_ratio : 0;
      double best = t > 0 ? -std::numeric_limits<double>::infinity() : 0;
      for (int j = 0; t > 0 && j <= before; ++j) {
        double penalty = j == before && k == n ? 0 : 0.5 * p.break_penalty;
        if (j < before && k < n) {
          const int followed = CountFollowed(states[t - 1][j], states[t][k], pairs, steps);
          penalty = followed >= 2 ? 0 : (followed == 1 ? 0.5 : 1.0) * p.break_penalty;
        }
        if (score[t - 1][j] - penalty > best) best = score[t - 1][j] - penalty, back[t][k] = j;
      }
      score[t][k] = best + own;
    }
  }
  std::vector<int> picked(count, -1);
  if (count == 0) return picked;
  int k = int(std::max_element(score[count - 1].begin(), score[count - 1].end()) -
              score[count - 1].begin());
  for (int64_t t = count - 1; t >= 0; --t) {
    picked[t] = k < int(states[t].size()) ? k : -1;
    k = back[t][k];
  }
  return picked;
}

}  // namespace chain_depths_internal

// samples: point indices into `source`, those of one polyline contiguous and ascending.
// sample_offsets: CSR of the samples by polyline. ranges: inverse depths of the samples. steps:
// points between two samples.
inline ChainDepths ComputeChainDepths(const EdgeIndex& source,
                                      const std::vector<const EdgeIndex*>& neighbors,
                                      const std::vector<int64_t>& samples,
                                      const std::vector<int64_t>& sample_offsets,
                                      const std::vector<DepthRange>& ranges, double steps,
                                      const ChainDepthParameters& parameters, int num_threads) {
  using namespace chain_depths_internal;
  std::vector<Pair> pairs;
  for (const EdgeIndex* neighbor : neighbors) pairs.push_back(MakePair(source, *neighbor));
  std::vector<EpipolarIndex> indexes(pairs.size());
  ParallelFor(int64_t(pairs.size()), num_threads, [&](int64_t n, int) {
    indexes[n] = EpipolarIndex(pairs[n], parameters.min_angle_sin);
  });
  std::vector<Cluster> picked(samples.size());
  const int64_t num_chains = int64_t(sample_offsets.size()) - 1;
  std::vector<Sampler> samplers(std::max(1, num_threads),
                                Sampler(source, pairs, indexes, parameters));
  ParallelFor(num_chains, num_threads, [&](int64_t chain, int worker) {
    std::vector<std::vector<Cluster>> states = samplers[worker].Clusters(
        samples.data() + sample_offsets[chain], ranges.data() + sample_offsets[chain],
        sample_offsets[chain + 1] - sample_offsets[chain]);
    const std::vector<int> path = Decode(states, pairs, steps, parameters);
    for (size_t t = 0; t < path.size(); ++t) {
      if (path[t] >= 0) picked[sample_offsets[chain] + t] = std::move(states[t][path[t]]);
    }
  });
  ChainDepths result;
  result.support_offsets.push_back(0);
  for (const Cluster& cluster : picked) {
    result.inverse_depths.push_back(cluster.inverse_depth);
    result.sigmas.push_back(cluster.sigma);
    result.scores.push_back(cluster.score);
    for (const Support& support : cluster.support) {
      result.positions.push_back(support.position);
      result.neighbors.push_back(support.neighbor);
    }
    result.support_offsets.push_back(int64_t(result.positions.size()));
  }
  return result;
}

}  // namespace colmap_edges
