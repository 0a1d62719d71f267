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
  // (0 to 255) of the dark and the bright sides in two views.
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
  int32_t polyline;
  float likelihood;  // likelihood ratio of its sides
};

struct Support {
  double position;
  int32_t neighbor;
  int32_t polyline;
};

struct Cluster {
  double inverse_depth, sigma, score;
  int32_t begin, end;  // of its supports: by ascending neighbour, at most one each
};

// The clusters of consecutive samples, best first.
struct SampleClusters {
  std::vector<int32_t> offsets{0};  // CSR of the clusters by sample
  std::vector<Cluster> clusters;
  std::vector<Support> supports;
};

// The range of inverse depths of a sample.
struct DepthRange {
  double low, high;
};

// The selected cluster of each sample; score 0 and no support where there is none.
struct ChainDepths {
  std::vector<double> inverse_depths, sigmas, scores;
  std::vector<int64_t> support_offsets{0};
  std::vector<double> positions;
  std::vector<int32_t> neighbors;

  // Adds cluster k, or no depth if k is negative.
  void Add(const SampleClusters& found, int32_t k) {
    const Cluster cluster = k < 0 ? Cluster{} : found.clusters[k];
    inverse_depths.push_back(cluster.inverse_depth);
    sigmas.push_back(cluster.sigma);
    scores.push_back(cluster.score);
    for (int32_t i = cluster.begin; i < cluster.end; ++i) {
      positions.push_back(found.supports[i].position);
      neighbors.push_back(found.supports[i].neighbor);
    }
    support_offsets.push_back(int64_t(positions.size()));
  }

  // Appends the samples of `next`.
  void Append(const ChainDepths& next) {
    const auto append = [](auto& to, const auto& from) {
      to.insert(to.end(), from.begin(), from.end());
    };
    append(inverse_depths, next.inverse_depths), append(sigmas, next.sigmas);
    append(scores, next.scores);
    for (size_t s = 1; s < next.support_offsets.size(); ++s) {
      support_offsets.push_back(int64_t(positions.size()) + next.support_offsets[s]);
    }
    append(positions, next.positions), append(neighbors, next.neighbors);
  }
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

// The hypotheses of a sample with one neighbour.
struct Seen {
  int32_t begin = 0, end = 0;
  double density = 0;  // intersections of the right polarity per unit of inverse depth
  Vec3 ray{};          // of the sample, in the neighbour's frame
};

// Likelihood ratio of the difference of two agreeing hypotheses, true edge against chance, given
// the square of its fraction of the window: a Gaussian with sigma of half the window, and outliers.
constexpr double kAnywhere = 0.2, kSpread = 0.5;
constexpr double kMean = 0.598144;  // mean of the Gaussian over the window
inline double GapLikelihood(double share2) {
  return kAnywhere + (1 - kAnywhere) / kMean * std::exp(-0.5 * share2 / (kSpread * kSpread));
}

class Sampler {
 public:
  Sampler(const EdgeIndex& source, const std::vector<Pair>& pairs,
          const std::vector<EpipolarIndex>& indexes, const ChainDepthParameters& p)
      : source_(source),
        pairs_(pairs),
        indexes_(indexes),
        p_(p),
        // To leave a cluster out of a path costs a break at most.
        least_ratio_(std::exp(p.min_log_likelihood_ratio - p.break_penalty)),
        hypotheses_(pairs.size()),
        seen_(pairs.size()),
        agree_(pairs.size()) {}

  // Clusters of each of `count` samples at points of the source. Those that can be on no best path
  // are left out.
  const SampleClusters& Clusters(const int64_t* points, const DepthRange* ranges, size_t count);

 private:
  // A hypothesis among those of one sample, which are sorted by inverse depth.
  struct Candidate {
    double inverse_depth, sigma, sigma2;
    int32_t neighbor;
    const Hypothesis* hypothesis;
  };

  float Likelihood(const Sides& a, const Sides& b) const {
    const int dark = std::abs(int(a[0]) - int(b[0])), bright = std::abs(int(a[1]) - int(b[1]));
    return p_.side_likelihoods[256 * dark + bright];
  }
  // Square of the window in inverse depth within which two hypotheses agree.
  double Window2(const Candidate& a, const Candidate& b) const {
    return p_.max_disagreement_px * p_.max_disagreement_px * (a.sigma2 + b.sigma2);
  }
  // The ray of point i in the frame of a neighbour.
  Vec3 RayIn(int64_t i, const Pair& pair) const {
    const Vec2 x = source_.point(i);
    return Multiply(pair.rotation, {x[0] / source_.focal(), x[1] / source_.focal(), 1});
  }
  void Collect(int64_t i, const DepthRange& range, int32_t neighbor, Seen* seen);
  void Gather(size_t sample);
  bool Holds(int32_t neighbor, const Seen& seen, double inverse_depth) const;
  int Agreeing(int64_t u);
  double RatioOf(int64_t u);
  Cluster MakeCluster(int64_t u);
  void AddBestClusters();

  const EdgeIndex& source_;
  const std::vector<Pair>& pairs_;
  const std::vector<EpipolarIndex>& indexes_;
  const ChainDepthParameters& p_;
  const double least_ratio_;
  // All are members to reuse their memory.
  std::vector<std::vector<Hypothesis>> hypotheses_;  // by neighbour
  std::vector<std::vector<Seen>> seen_;              // by neighbour and sample
  std::vector<std::pair<float, int32_t>> order_;
  std::vector<EpipolarIndex::Crossed> crossed_;
  // Of one sample:
  std::vector<Candidate> candidates_;
  std::vector<std::pair<int32_t, const Seen*>> visible_;  // neighbours with hypotheses
  std::vector<double> ratios_;                            // by candidate; 0 for none
  std::vector<int64_t> agree_;                            // by neighbour
  SampleClusters found_;
};

inline const SampleClusters& Sampler::Clusters(const int64_t* points, const DepthRange* ranges,
                                               size_t count) {
  // Neighbour by neighbour and epipolar line by epipolar line, since lines next to each other
  // cross the same chains, which then are in the caches.
  for (size_t n = 0; n < pairs_.size(); ++n) {
    hypotheses_[n].clear();
    seen_[n].assign(count, Seen());
    order_.clear();
    for (size_t s = 0; s < count; ++s) {
      order_.push_back({indexes_[n].Rank(RayIn(points[s], pairs_[n])), int32_t(s)});
    }
    std::sort(order_.begin(), order_.end());
    for (const auto& [rank, s] : order_) Collect(points[s], ranges[s], int32_t(n), &seen_[n][s]);
  }
  found_.offsets.resize(1), found_.clusters.clear(), found_.supports.clear();
  for (size_t s = 0; s < count; ++s) {
    Gather(s);
    ratios_.resize(candidates_.size());
    for (size_t u = 0; u < candidates_.size(); ++u) ratios_[u] = RatioOf(int64_t(u));
    AddBestClusters();
    found_.offsets.push_back(int32_t(found_.clusters.size()));
  }
  return found_;
}

// The hypotheses of a sample with all neighbours, sorted by inverse depth.
inline void Sampler::Gather(size_t sample) {
  candidates_.clear(), visible_.clear();
  for (size_t n = 0; n < pairs_.size(); ++n) {
    const Seen& seen = seen_[n][sample];
    if (seen.begin == seen.end) continue;
    visible_.push_back({int32_t(n), &seen});
    for (int32_t h = seen.begin; h < seen.end; ++h) {
      const Hypothesis& own = hypotheses_[n][h];
      candidates_.push_back(
          {own.inverse_depth, own.sigma, own.sigma * own.sigma, int32_t(n), &own});
    }
  }
  std::sort(candidates_.begin(), candidates_.end(), [](const Candidate& a, const Candidate& b) {
    if (a.inverse_depth != b.inverse_depth) return a.inverse_depth < b.inverse_depth;
    if (a.neighbor != b.neighbor) return a.neighbor < b.neighbor;
    return a.hypothesis->position < b.hypothesis->position;
  });
}

inline void Sampler::Collect(int64_t i, const DepthRange& range, int32_t neighbor, Seen* seen) {
  const Pair& pair = pairs_[neighbor];
  const EdgeIndex& view = *pair.view;
  const double f = view.focal();
  const Vec2& x = source_.point(i);
  const Vec2 toward = ImageDirection(pair.source_epipole, x, source_.focal());
  const double toward_norm = Norm(toward);
  const Vec2 &n0 = source_.normal(i), &tangent0 = source_.tangent(i);
  const double sin0 = std::abs(Cross(tangent0, toward)) / (toward_norm + 1e-300);
  if (sin0 < p_.min_angle_sin) return;
  const Sides& sides0 = source_.sides(i);
  const double polarity0 = Dot(n0, toward) / (toward_norm + 1e-300);
  const Vec3 a = RayIn(i, pair);
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
  std::vector<Hypothesis>& hypotheses = hypotheses_[neighbor];
  const size_t before = hypotheses.size();
  int64_t count = 0;
  double nearest = wide_high, farthest = wide_low;
  const bool wide = std::abs(u[0]) > std::abs(u[1]);
  indexes_[neighbor].VisitCrossings(a, wide_low, wide_high, &crossed_, [&](int64_t s, double t) {
    const int k = wide ? 0 : 1;
    const double q = view.point(s)[k], at = q + t * (view.point(view.Next(s))[k] - q);
    const double rho = (at * a[2] - f * a[k]) / (f * b[k] - at * b[2]);
    const double sin = std::abs(Cross(u, view.tangent(s)));
    const float likelihood = Likelihood(sides0, view.sides(s));
    // Few branches, since most of them would be unpredictable.
    const bool counted = (sin >= p_.min_angle_sin) & (rho >= wide_low) & (rho <= wide_high);
    count += counted;
    nearest = counted ? std::min(nearest, rho) : nearest;
    farthest = counted ? std::max(farthest, rho) : farthest;
    constexpr double kSure = 0.1;  // closer to the epipolar line, the sign is not reliable
    // The direction from the source's centre to the neighbour's is that of -u.
    const double polarity = -Dot(view.normal(s), u);
    const bool opposite =
        (polarity * polarity0 < 0) & (std::min(std::abs(polarity), std::abs(polarity0)) > kSure);
    if (!(counted & (rho >= low) & (rho <= high) & !opposite)) return;
    const double z = a[2] + rho * b[2];
    const double sigma = z * z / (speed * std::min(sin, sin0));
    hypotheses.push_back({rho, sigma, double(s) + t, view.polyline(s), likelihood});
  });
  if (hypotheses.size() == before) return;
  seen->begin = int32_t(before), seen->end = int32_t(hypotheses.size()), seen->ray = a;
  // n intersections span (n - 1) / (n + 1) of the visible part of the range on average. Half of
  // them have the wrong polarity.
  const double span = (farthest - nearest) * double(count + 1) / std::max(double(count - 1), 0.1);
  seen->density =
      0.5 * double(count) / std::clamp(span, 0.05 * (wide_high - wide_low), wide_high - wide_low);
}

// Writes to agree_ the nearest agreeing hypothesis of each neighbour for hypothesis u, and returns
// the number of such neighbours.
inline int Sampler::Agreeing(int64_t u) {
  const int64_t count = int64_t(candidates_.size());
  const Candidate& center = candidates_[u];
  std::fill(agree_.begin(), agree_.end(), -1);
  agree_[center.neighbor] = u;
  int num = 1;
  const double reach = 4 * p_.max_disagreement_px * center.sigma;
  for (int64_t v = u - 1; v >= 0; --v) {
    const Candidate& other = candidates_[v];
    const double gap = center.inverse_depth - other.inverse_depth;
    if (gap > reach) break;
    if (gap * gap > Window2(center, other) || agree_[other.neighbor] >= 0) continue;
    agree_[other.neighbor] = v, ++num;
  }
  for (int64_t v = u + 1; v < count; ++v) {
    const Candidate& other = candidates_[v];
    const double gap = other.inverse_depth - center.inverse_depth;
    if (gap > reach) break;
    if (gap * gap > Window2(center, other)) continue;
    int64_t& held = agree_[other.neighbor];
    if (held >= 0 && gap >= std::abs(candidates_[held].inverse_depth - center.inverse_depth)) {
      continue;
    }
    num += held < 0, held = v;
  }
  return num;
}

// Whether a sample at an inverse depth lies within the bounds of a neighbour's chains.
inline bool Sampler::Holds(int32_t neighbor, const Seen& seen, double inverse_depth) const {
  const Pair& pair = pairs_[neighbor];
  const Vec3 x = seen.ray + inverse_depth * pair.translation;
  const double scale = pair.view->focal() / x[2];
  return x[2] > 0 && pair.view->Reaches({scale * x[0], scale * x[1]}, 0);
}

// Likelihood ratio of the agreement with hypothesis u, true edge against chance; 0 if no path needs
// it. A neighbour agrees by chance with the probability x / (1 + x) for x expected intersections in
// the window of two hypotheses. Distances and side similarities are further factors. Neighbours
// that cannot see it say nothing.
inline double Sampler::RatioOf(int64_t u) {
  if (Agreeing(u) < 2) return 0;
  const double q = p_.detection_rate, v = p_.visibility_rate;
  const double window = std::sqrt(2.0) * p_.max_disagreement_px;
  const Candidate& own = candidates_[u];
  double ratio = 1;
  for (const auto& [n, with] : visible_) {
    const int64_t agreeing = agree_[n];
    if (agreeing < 0 && !Holds(n, *with, own.inverse_depth)) continue;
    const double sigma = agreeing >= 0 ? candidates_[agreeing].sigma : own.sigma;
    const double x = std::clamp(window * (own.sigma + sigma) * with->density, 0.02, 50.0);
    double seen = (1 - q) * (1 + x);
    if (agreeing >= 0) {
      const Candidate& other = candidates_[agreeing];
      seen = q * (1 + x) / x * other.hypothesis->likelihood;
      const double gap = other.inverse_depth - own.inverse_depth;
      if (agreeing != u) seen *= GapLikelihood(gap * gap / Window2(own, other));
    }
    ratio *= v * seen + 1 - v;
  }
  return ratio > least_ratio_ ? ratio : 0;
}

inline Cluster Sampler::MakeCluster(int64_t u) {
  Agreeing(u);
  Cluster cluster;
  cluster.score = std::log(ratios_[u]);
  cluster.begin = int32_t(found_.supports.size());
  double weights = 0, sum = 0;
  for (size_t n = 0; n < agree_.size(); ++n) {
    if (agree_[n] < 0) continue;
    const Candidate& c = candidates_[agree_[n]];
    weights += 1 / c.sigma2, sum += c.inverse_depth / c.sigma2;
    found_.supports.push_back({c.hypothesis->position, int32_t(n), c.hypothesis->polyline});
  }
  cluster.end = int32_t(found_.supports.size());
  cluster.inverse_depth = sum / weights, cluster.sigma = 1 / std::sqrt(weights);
  return cluster;
}

// Adds the best clusters of a sample, no two of which agree with each other.
inline void Sampler::AddBestClusters() {
  for (int count = 0; count < p_.max_clusters; ++count) {
    const int64_t best = std::max_element(ratios_.begin(), ratios_.end()) - ratios_.begin();
    if (best == int64_t(ratios_.size()) || ratios_[best] == 0) break;
    const Cluster cluster = MakeCluster(best);
    found_.clusters.push_back(cluster);
    const double reach = p_.max_disagreement_px * candidates_[best].sigma;
    ratios_[best] = 0;
    for (size_t v = 0; v < ratios_.size(); ++v) {
      if (std::abs(candidates_[v].inverse_depth - cluster.inverse_depth) < reach) ratios_[v] = 0;
    }
  }
}

// Number of neighbours in which two clusters lie on one chain, about `steps` points apart.
inline int CountFollowed(const Cluster& from, const Cluster& to, const Support* supports,
                         const std::vector<Pair>& pairs, double steps) {
  int count = 0;
  for (int32_t i = from.begin, j = to.begin; i < from.end && j < to.end;) {
    const Support &a = supports[i], &b = supports[j];
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

// Viterbi over the samples first to end - 1 of one chain: writes the selected cluster of each
// sample, or -1, to `picked`.
class Decoder {
 public:
  void Decode(const SampleClusters& found, int64_t first, int64_t end,
              const std::vector<Pair>& pairs, double steps, const ChainDepthParameters& p,
              int32_t* picked) {
    if (first == end) return;
    scores_.clear(), back_.clear();
    const int32_t* offsets = found.offsets.data();
    size_t before_begin = 0;
    for (int64_t t = first; t < end; ++t) {
      const size_t begin = scores_.size();
      const int n = offsets[t + 1] - offsets[t];
      const int before = t > first ? offsets[t] - offsets[t - 1] : -1;
      for (int k = 0; k <= n; ++k) {
        const Cluster* to = k < n ? &found.clusters[offsets[t] + k] : nullptr;
        double best = before >= 0 ? -std::numeric_limits<double>::infinity() : 0;
        int from = 0;
        for (int j = 0; j <= before; ++j) {
          double penalty = j == before && !to ? 0 : 0.5 * p.break_penalty;
          if (j < before && to) {
            const int followed = CountFollowed(found.clusters[offsets[t - 1] + j], *to,
                                               found.supports.data(), pairs, steps);
            penalty = followed >= 2 ? 0 : (followed == 1 ? 0.5 : 1.0) * p.break_penalty;
          }
          const double score = scores_[before_begin + j] - penalty;
          if (score > best) best = score, from = j;
        }
        scores_.push_back(best + (to ? to->score - p.min_log_likelihood_ratio : 0));
        back_.push_back(from);
      }
      before_begin = begin;
    }
    int k = int(std::max_element(scores_.begin() + before_begin, scores_.end()) -
                (scores_.begin() + before_begin));
    size_t begin = before_begin;
    for (int64_t t = end - 1; t >= first; --t) {
      picked[t - first] = k < offsets[t + 1] - offsets[t] ? offsets[t] + k : -1;
      k = back_[begin + k];
      if (t > first) begin -= offsets[t] - offsets[t - 1] + 1;
    }
  }

 private:
  std::vector<double> scores_;  // by sample: of its clusters, and of none
  std::vector<int> back_;
};

// Offsets of blocks of consecutive chains, with enough samples each that neighbouring epipolar
// lines are near, and few enough that the hypotheses of a block are small.
inline std::vector<int64_t> BlocksOfChains(const std::vector<int64_t>& sample_offsets) {
  constexpr int64_t kSamples = 2048;
  std::vector<int64_t> blocks{0};
  const int64_t num_chains = int64_t(sample_offsets.size()) - 1;
  for (int64_t chain = 1; chain <= num_chains; ++chain) {
    const int64_t count = sample_offsets[chain] - sample_offsets[blocks.back()];
    if (count >= kSamples || chain == num_chains) blocks.push_back(chain);
  }
  return blocks;
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
  const std::vector<int64_t> blocks = BlocksOfChains(sample_offsets);
  std::vector<ChainDepths> parts(blocks.size() - 1);
  struct Worker {
    Sampler sampler;
    Decoder decoder;
    std::vector<int32_t> picked;
  };
  std::vector<Worker> workers(std::max(1, num_threads),
                              Worker{Sampler(source, pairs, indexes, parameters), {}, {}});
  ParallelFor(int64_t(parts.size()), num_threads, [&](int64_t block, int worker) {
    auto& [sampler, decoder, picked] = workers[worker];
    const int64_t begin = sample_offsets[blocks[block]], end = sample_offsets[blocks[block + 1]];
    const SampleClusters& found =
        sampler.Clusters(samples.data() + begin, ranges.data() + begin, end - begin);
    picked.resize(end - begin);
    for (int64_t chain = blocks[block]; chain < blocks[block + 1]; ++chain) {
      const int64_t first = sample_offsets[chain] - begin;
      decoder.Decode(found, first, sample_offsets[chain + 1] - begin, pairs, steps, parameters,
                     picked.data() + first);
    }
    for (const int32_t k : picked) parts[block].Add(found, k);
  });
  ChainDepths result;
  for (const ChainDepths& part : parts) result.Append(part);
  return result;
}

}  // namespace colmap_edges
