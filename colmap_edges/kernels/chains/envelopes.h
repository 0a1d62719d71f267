// Depths and radii of outlines of smooth bodies along the chains of one view.
//
// The viewing ray of an outline touches the body. Any section of the body by a plane through the
// ray is a curve that touches the ray, too, of the radius R s (Meusnier), where R is that of the
// section across the chain and s the cosine between the plane's normal to the ray and the surface's
// normal. In the epipolar plane of a neighbour, the neighbour's ray touches the same circle. With
// k = R / depth, each intersection of the epipolar line with a chain is thus a straight line of
// inverse depth over k, rho = at + k * per_radius, and outlines are points where lines of many
// neighbours meet; k = 0 is a fixed edge (Cipolla, Blake 1992; Vaillant, Faugeras 1992).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "chains/chain_depths.h"
#include "chains/epipolar_index.h"
#include "common/edge_index.h"
#include "common/parallel.h"

namespace colmap_edges {

// A hypothesis of a sample: a radius of 0 is a fixed edge; no support where there is none.
struct Envelope {
  double inverse_depth = 0;
  double radius = 0;        // over the depth; positive if the bright side is outside the body
  double sigma = 0;         // of the inverse depth if chains are moved by 1 px
  double radius_sigma = 0;  // of the radius
  double residual = 0;      // root mean square, pixels
  double score = 0;         // log likelihood ratio against accidental agreement
  int32_t num_supports = 0;
  bool goes_on = false;  // from the previous sample, on the same chains
};

namespace envelopes_internal {

// Source pixels; between two of them outlines move by about a pixel.
inline std::vector<double> RadiiPx() {
  constexpr double kFirst = 8, kGrowth = 1.35;
  constexpr int kCount = 10;
  std::vector<double> radii{0};
  double radius = 0, step = kFirst;
  for (int i = 0; i < kCount; ++i, step *= kGrowth) {
    radius += step;
    radii.push_back(radius), radii.push_back(-radius);
  }
  return radii;
}

// An intersection: the inverse depth is at + radius * per_radius.
struct Line {
  double at, per_radius, sigma, weight;  // weight: 1 / sigma, which is that for 1 px
  int32_t neighbor, polyline;
  float likelihood;
  bool across;  // both chains cross the epipolar line at more than 30 degrees
};

struct Choice {
  Envelope envelope;
  std::vector<std::array<int32_t, 2>> chains;  // neighbours and polylines of the supports
};

class EnvelopeSampler {
 public:
  EnvelopeSampler(const EdgeIndex& source, const std::vector<Pair>& pairs,
                  const std::vector<EpipolarIndex>& indexes, const ChainDepthParameters& p)
      : source_(source), pairs_(pairs), indexes_(indexes), p_(p), radii_(RadiiPx()) {}

  // The best hypotheses of the sample at a point.
  std::vector<Choice> Choices(int64_t point, const DepthRange& range) {
    lines_.clear(), densities_.assign(pairs_.size(), 0);
    for (size_t n = 0; n < pairs_.size(); ++n) Collect(point, range, int32_t(n));
    std::vector<Choice> found;
    // Among many lines some meet anywhere.
    const size_t most = kMostLines * pairs_.size();
    if (int(lines_.size()) < kLeastSupports || lines_.size() > most) return found;
    starts_.clear();
    for (const double radius : radii_) AddStarts(radius / source_.focal());
    std::sort(starts_.begin(), starts_.end(), [](const Start& a, const Start& b) {
      if (a.count != b.count) return a.count > b.count;
      if (a.spread != b.spread) return a.spread < b.spread;
      return a.inverse_depth < b.inverse_depth;
    });
    for (size_t i = 0; i < std::min(starts_.size(), kMostStarts); ++i) {
      const Choice fitted = Fitted(starts_[i], range);
      if (fitted.envelope.score < p_.min_log_likelihood_ratio - p_.break_penalty) continue;
      const bool known = std::any_of(found.begin(), found.end(), [&](const Choice& other) {
        return std::abs(other.envelope.inverse_depth - fitted.envelope.inverse_depth) <
                   1e-6 * fitted.envelope.inverse_depth &&
               other.chains == fitted.chains;
      });
      if (!known) found.push_back(fitted);
    }
    std::stable_sort(found.begin(), found.end(), [](const Choice& a, const Choice& b) {
      return a.envelope.score > b.envelope.score;
    });
    if (int(found.size()) > p_.max_clusters) found.resize(p_.max_clusters);
    return found;
  }

 private:
  static constexpr int kLeastSupports = 3;
  static constexpr size_t kMostStarts = 16;
  static constexpr size_t kMostLines = 5;  // of a neighbour, in the mean

  struct Start {
    double radius, inverse_depth, spread;
    int count;
  };

  void Collect(int64_t i, const DepthRange& range, int32_t n);
  void AddStarts(double radius);
  Choice Fitted(const Start& start, const DepthRange& range);
  void Associate(double radius, double inverse_depth, double window_px);
  double Score(double window_px) const;

  const EdgeIndex& source_;
  const std::vector<Pair>& pairs_;
  const std::vector<EpipolarIndex>& indexes_;
  const ChainDepthParameters& p_;
  const std::vector<double> radii_;
  // All are members to reuse their memory.
  std::vector<Line> lines_;
  std::vector<double> densities_;                   // by neighbour
  std::vector<std::pair<double, int32_t>> sorted_;  // inverse depths of lines at a radius
  std::vector<int32_t> nearest_;                    // by neighbour: its nearest line, or -1
  std::vector<double> gaps_;                        // by neighbour: to that line, pixels
  std::vector<char> counted_;                       // by neighbour: whether it supports a start
  std::vector<Start> starts_;
  std::vector<EpipolarIndex::Crossed> crossed_;
};

inline void EnvelopeSampler::Collect(int64_t i, const DepthRange& range, int32_t n) {
  const Pair& pair = pairs_[n];
  const EdgeIndex& view = *pair.view;
  const double f = view.focal(), f0 = source_.focal();
  const Vec2 x = source_.point(i), t0 = source_.tangent(i), n0 = source_.normal(i);
  const Vec3 ray{x[0] / f0, x[1] / f0, 1}, &e = pair.source_epipole;
  const Vec2 toward = chain_depths_internal::ImageDirection(e, x, f0);
  const double sin0 = std::abs(Cross(t0, toward)) / (Norm(toward) + 1e-300);
  if (sin0 < p_.min_angle_sin) return;
  Vec3 surface = Cross(ray, Vec3{t0[0], t0[1], 0});
  surface = (surface.x * n0[0] + surface.y * n0[1] < 0 ? -1 : 1) / Norm(surface) * surface;
  const double length = Norm(ray);
  Vec3 out = e - Dot(e, ray) / (length * length) * ray;
  out = (Dot(out, surface) < 0 ? -1 : 1) / (Norm(out) + 1e-300) * out;
  const double cosine = Dot(out, surface);
  const Vec3 around = 1 / length * Cross(ray, out);
  const Vec3 a = Multiply(pair.rotation, ray), &b = pair.translation;
  const Vec2 gradient{f * (b[0] * a[2] - a[0] * b[2]), f * (b[1] * a[2] - a[1] * b[2])};
  const double speed = Norm(gradient);
  if (!(speed > 0)) return;
  const Vec2 u = 1 / speed * gradient;
  const double polarity0 = Dot(n0, toward) / (Norm(toward) + 1e-300);
  int64_t count = 0;
  indexes_[n].VisitCrossings(a, range.low, range.high, &crossed_, [&](int64_t s, double t) {
    const Vec2 p = view.point(s), q = p + t * (view.point(view.Next(s)) - p);
    const int k = std::abs(u[0]) > std::abs(u[1]) ? 0 : 1;
    const double rho = (q[k] * a[2] - f * a[k]) / (f * b[k] - q[k] * b[2]);
    const double sin = std::abs(Cross(u, view.tangent(s))), z = a[2] + rho * b[2];
    const Sides &own = source_.sides(i), &other = view.sides(s);
    const float likelihood = p_.side_likelihoods[256 * std::abs(int(own[0]) - int(other[0])) +
                                                 std::abs(int(own[1]) - int(other[1]))];
    if (!(sin >= p_.min_angle_sin) || !(z > 0)) return;
    if (!(rho >= range.low && rho <= range.high)) return;
    ++count;
    constexpr double kSure = 0.1;  // closer to the epipolar line, the sign is not reliable
    const double polarity = -Dot(view.normal(s), u);
    if (polarity * polarity0 < 0 && std::min(std::abs(polarity), std::abs(polarity0)) > kSure) {
      return;
    }
    const Vec3 seen = MultiplyTransposed(pair.rotation, {q[0] / f, q[1] / f, 1});
    Vec3 other_out = Cross(around, seen);
    other_out = 1 / Norm(other_out) * other_out;
    const double per_radius = cosine * (1 - Dot(other_out, out)) / Dot(other_out, e);
    const double sigma = z * z / (speed * std::min(sin, sin0));
    lines_.push_back({rho, per_radius, sigma, 1 / sigma, n, view.polyline(s), likelihood,
                      std::min(sin, sin0) > 0.5});
  });
  densities_[n] = 0.5 * double(std::max<int64_t>(count, 1)) / (range.high - range.low);
}

// Adds the depths at a radius where lines of enough neighbours are within their windows.
inline void EnvelopeSampler::AddStarts(double radius) {
  sorted_.clear();
  for (size_t l = 0; l < lines_.size(); ++l) {
    sorted_.push_back({lines_[l].at + radius * lines_[l].per_radius, int32_t(l)});
  }
  std::sort(sorted_.begin(), sorted_.end());
  const double window = std::sqrt(2.0) * p_.max_disagreement_px;
  for (size_t u = 0; u < sorted_.size(); ++u) {
    if (!lines_[sorted_[u].second].across) continue;
    const double at = sorted_[u].first, reach = window * lines_[sorted_[u].second].sigma;
    int count = 0;
    double spread = 0;
    counted_.assign(pairs_.size(), false);
    const auto add = [&](size_t v) {
      const Line& line = lines_[sorted_[v].second];
      const double gap = std::abs(sorted_[v].first - at);
      if (gap > std::max(reach, window * line.sigma) || counted_[line.neighbor]) return;
      counted_[line.neighbor] = true, ++count, spread += gap / (reach + window * line.sigma);
    };
    add(u);
    for (size_t v = u; v-- > 0 && at - sorted_[v].first < 2 * reach;) add(v);
    for (size_t v = u + 1; v < sorted_.size() && sorted_[v].first - at < 2 * reach; ++v) add(v);
    if (count >= kLeastSupports) starts_.push_back({radius, at, spread, count});
  }
}

// Writes the nearest line of each neighbour within a window to nearest_, and their distances.
inline void EnvelopeSampler::Associate(double radius, double inverse_depth, double window_px) {
  nearest_.assign(pairs_.size(), -1), gaps_.assign(pairs_.size(), window_px);
  for (size_t l = 0; l < lines_.size(); ++l) {
    const Line& line = lines_[l];
    const double gap = std::abs(line.at + radius * line.per_radius - inverse_depth) * line.weight;
    if (gap < gaps_[line.neighbor])
      gaps_[line.neighbor] = gap, nearest_[line.neighbor] = int32_t(l);
  }
}

// Log likelihood ratio of the nearest lines, as of clusters of fixed edges.
inline double EnvelopeSampler::Score(double window_px) const {
  const double q = p_.detection_rate, v = p_.visibility_rate;
  double ratio = 1;
  for (size_t n = 0; n < pairs_.size(); ++n) {
    if (densities_[n] == 0) continue;
    const bool agrees = nearest_[n] >= 0;
    const double sigma = agrees ? 1 / lines_[nearest_[n]].weight : 0;
    const double x = std::clamp(2 * window_px * sigma * densities_[n], 0.02, 50.0);
    const double share = gaps_[n] / window_px;
    const double seen = agrees ? q * (1 + x) / x * lines_[nearest_[n]].likelihood *
                                     chain_depths_internal::GapLikelihood(share * share)
                               : (1 - q) * (1 + x);
    ratio *= v * seen + 1 - v;
  }
  return std::log(ratio);
}

// Least squares of inverse depth and radius on the nearest lines.
inline Choice EnvelopeSampler::Fitted(const Start& start, const DepthRange& range) {
  constexpr int kSteps = 3;
  Choice best;
  double rho = start.inverse_depth, radius = start.radius;
  double s1 = 0, sg = 0, sgg = 0, information = 0;
  for (int step = 0; step < kSteps; ++step) {
    Associate(radius, rho, (step == 0 ? std::sqrt(2.0) : 1.0) * p_.max_disagreement_px);
    double sr = 0, sgr = 0;
    s1 = sg = sgg = 0;
    for (const int32_t l : nearest_) {
      if (l < 0) continue;
      const double w = lines_[l].weight * lines_[l].weight, g = lines_[l].per_radius;
      s1 += w, sg += w * g, sgg += w * g * g, sr += w * lines_[l].at, sgr += w * g * lines_[l].at;
    }
    information = sgg - sg * sg / (s1 + 1e-300);
    if (!(s1 > 0) || !(information > 1e-9 * sgg)) return best;
    radius = -(sgr - sg * sr / s1) / information;
    rho = (sr + radius * sg) / s1;
  }
  if (!(rho >= range.low && rho <= range.high)) return best;
  Associate(radius, rho, p_.max_disagreement_px);
  best.envelope.score = Score(p_.max_disagreement_px);
  double squares = 0;
  for (const int32_t l : nearest_) {
    if (l < 0) continue;
    const Line& line = lines_[l];
    const double gap = (line.at + radius * line.per_radius - rho) * line.weight;
    squares += gap * gap, ++best.envelope.num_supports;
    best.chains.push_back({line.neighbor, line.polyline});
  }
  best.envelope.inverse_depth = rho, best.envelope.radius = radius;
  best.envelope.radius_sigma = 1 / std::sqrt(information);
  best.envelope.sigma = std::sqrt(sgg / (s1 * information));
  best.envelope.residual = std::sqrt(squares / std::max(best.envelope.num_supports - 2, 1));
  return best;
}

constexpr int64_t kCoarse = 4;  // samples; less than those of the shortest outline

// Whether the radius is significant.
inline bool IsCurved(const Choice& choice) {
  constexpr double kSignificant = 3;
  const Envelope& e = choice.envelope;
  return std::abs(e.radius) > kSignificant * e.radius_sigma;
}

// Number of chains that two hypotheses share.
inline int Shared(const Choice& a, const Choice& b) {
  int count = 0;
  for (const auto& chain : a.chains) {
    count += int(std::count(b.chains.begin(), b.chains.end(), chain));
  }
  return count;
}

// Best path through the hypotheses of consecutive samples (dynamic programming).
inline void Decode(const std::vector<std::vector<Choice>>& choices, const ChainDepthParameters& p,
                   Envelope* found) {
  constexpr int kLeastShared = 2;
  // State 0 is no envelope; state k + 1 is choice k.
  std::vector<std::vector<double>> scores(choices.size());
  std::vector<std::vector<int>> from(choices.size());
  const auto breaks = [&](size_t s, int before, int now) {
    return before == 0 || now == 0 ||
           Shared(choices[s - 1][before - 1], choices[s][now - 1]) < kLeastShared;
  };
  for (size_t s = 0; s < choices.size(); ++s) {
    scores[s].assign(choices[s].size() + 1, 0), from[s].assign(choices[s].size() + 1, 0);
    for (size_t k = 0; k < scores[s].size(); ++k) {
      const double own = k == 0 ? 0 : choices[s][k - 1].envelope.score - p.min_log_likelihood_ratio;
      if (s == 0) {
        scores[s][k] = own;
        continue;
      }
      double best = -INFINITY;
      for (size_t j = 0; j < scores[s - 1].size(); ++j) {
        const bool broken = (j || k) && breaks(s, int(j), int(k));
        const double score = scores[s - 1][j] - (broken ? p.break_penalty : 0);
        if (score > best) best = score, from[s][k] = int(j);
      }
      scores[s][k] = best + own;
    }
  }
  if (choices.empty()) return;
  int state =
      int(std::max_element(scores.back().begin(), scores.back().end()) - scores.back().begin());
  for (size_t s = choices.size(); s-- > 0;) {
    const int before = from[s][state];
    if (state > 0) {
      found[s] = choices[s][state - 1].envelope;
      found[s].goes_on = s > 0 && !breaks(s, before, state);
    }
    state = before;
  }
}

}  // namespace envelopes_internal

// The hypothesis of each sample on the best path along its chain.
// Arguments as of ComputeChainDepths.
inline std::vector<Envelope> FindEnvelopes(const EdgeIndex& source,
                                           const std::vector<const EdgeIndex*>& neighbors,
                                           const std::vector<int64_t>& samples,
                                           const std::vector<int64_t>& sample_offsets,
                                           const std::vector<DepthRange>& ranges,
                                           const ChainDepthParameters& parameters,
                                           int num_threads) {
  using namespace envelopes_internal;
  std::vector<Pair> pairs;
  for (const EdgeIndex* neighbor : neighbors) pairs.push_back(MakePair(source, *neighbor));
  std::vector<EpipolarIndex> indexes(pairs.size());
  ParallelFor(int64_t(pairs.size()), num_threads, [&](int64_t n, int) {
    indexes[n] = EpipolarIndex(pairs[n], parameters.min_angle_sin);
  });
  std::vector<Envelope> found(samples.size());
  std::vector<EnvelopeSampler> samplers(std::max(1, num_threads),
                                        EnvelopeSampler(source, pairs, indexes, parameters));
  ParallelFor(int64_t(sample_offsets.size()) - 1, num_threads, [&](int64_t chain, int worker) {
    const int64_t first = sample_offsets[chain], count = sample_offsets[chain + 1] - first;
    std::vector<std::vector<Choice>> choices(count);
    const auto choose = [&](int64_t s) {
      choices[s] = samplers[worker].Choices(samples[first + s], ranges[first + s]);
    };
    // Every kCoarse-th sample tells where others are worth it.
    for (int64_t s = kCoarse / 2; s < count; s += kCoarse) choose(s);
    const auto promises = [&](int64_t s) {
      return s >= 0 && s < count && std::any_of(choices[s].begin(), choices[s].end(), IsCurved);
    };
    std::vector<int64_t> others;
    for (int64_t s = 0; s < count; ++s) {
      const int64_t after = (s + kCoarse / 2) % kCoarse;
      if (after && (promises(s - after) || promises(s - after + kCoarse))) others.push_back(s);
    }
    for (const int64_t s : others) choose(s);
    Decode(choices, parameters, found.data() + first);
  });
  return found;
}

}  // namespace colmap_edges
