// PEPC validation and 3D edge generation: choose the one selection that triangulates and can be
// followed, then follow the edge in all its views at once (paper: PEPC validation).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>
#include <vector>

#include "common/geometry.h"
#include "common/parallel.h"
#include "paper/agreement.h"
#include "paper/places.h"

namespace colmap_edges {

struct FollowSettings {
  double step_px;                  // distance of edge points in the leading view
  double max_error_px;             // maximum reprojection error of a valid triangulation
  double max_step_ratio;           // maximum step in another view, relative to the expected one
  double min_epipolar_sine;        // minimum sine of the angle between edge and epipolar line
  double full_triangulation_sine;  // sine of the triangulation angle from which views count fully
  double max_stretch;              // maximum 3D step, relative to a step seen frontally
  int min_views;                   // minimum number of views of every edge point
  int min_steps;                   // minimum number of steps of a valid selection
  int max_selections;              // maximum number of selections, and of triples of views of one
};

enum class StartOutcome : uint8_t {
  kAccepted,
  kCovered,      // on a stretch covered by an earlier 3D edge
  kTooFewViews,  // candidates in fewer than two other views
  kInvalid,      // no selection triangulates and can be followed
  kAmbiguous,    // several different selections can
  kDuplicate,    // the 3D point lies on an earlier 3D edge
  kNumOutcomes
};

// Observation of an edge in one view: the place, and the direction of the 3D edge along the chain
// (+1, -1, 0 unknown).
struct Strand {
  Place at;
  int sign;
};

struct EdgePoint3D {
  Vec3 position;
  std::vector<Place> track;  // one place per view
};

struct Edge3D {
  std::vector<EdgePoint3D> points;
  bool closed = false;
};

// The chain points, by view, that are covered by accepted 3D edges.
using Coverage = std::vector<std::vector<uint8_t>>;

inline bool IsCovered(const Place& at, const Coverage& covered) {
  return covered[at.view][int64_t(at.position)] != 0;
}

// Whether more than half of the places are covered, so that the edge is a duplicate.
inline bool MostlyCovered(const std::vector<Place>& track, const Coverage& covered) {
  size_t count = 0;
  for (const Place& at : track) count += IsCovered(at, covered);
  return 2 * count > track.size();
}

// Whether both places are on one polyline.
inline bool OnOnePolyline(const Views& views, const Place& a, const Place& b) {
  const EdgeIndex& chains = *views[a.view];
  return a.view == b.view &&
         chains.polyline(int64_t(a.position)) == chains.polyline(int64_t(b.position));
}

class EdgeTracer {
 public:
  EdgeTracer(const Views& views, const FollowSettings& settings, const Coverage& covered)
      : views_(views), settings_(settings), covered_(covered) {
    for (const EdgeIndex* chains : views) num_points_ += chains->num_points();
  }

  // Candidates must be grouped by view. If accepted, `edge` is the traced edge.
  StartOutcome Trace(Place start, const Place* candidates, int64_t num_candidates,
                     Edge3D* edge) const {
    if (IsCovered(start, covered_)) return StartOutcome::kCovered;
    const std::vector<Candidate> usable = UsableCandidates(start, candidates, num_candidates);
    if (usable.empty() || usable.back().group < 1) return StartOutcome::kTooFewViews;
    Selection selection;
    const int found = SelectUnique(start, usable, &selection);
    if (found != 1) return found ? StartOutcome::kAmbiguous : StartOutcome::kInvalid;
    Extend(usable, &selection);
    if (MostlyCovered(MakePoint(selection.point, selection.strands).track, covered_))
      return StartOutcome::kDuplicate;
    Follow(selection, edge);
    return int(edge->points.size()) > settings_.min_steps ? StartOutcome::kAccepted
                                                          : StartOutcome::kInvalid;
  }

 private:
  // A candidate, the direction of its chain that corresponds to ascending points of the start's
  // chain, its inverse distance along the start's ray, and the conditioning.
  struct Candidate {
    Place at;
    int32_t group;  // index of its view among those of the start's candidates
    int sign;
    double inverse_distance, px_per_inverse, score;
  };
  // Strands of one 3D edge point, that of the leading view first. Signs are relative to ascending
  // points of the leading strand.
  struct Selection {
    Vec3 point;
    double error = INFINITY;
    std::vector<Strand> strands;
  };
  struct StepResult {
    Vec3 point;
    double error = INFINITY;
    std::vector<Strand> strands;
  };

  const EdgeIndex& ChainsAt(Place at) const { return *views_[at.view]; }
  const PinholeView& ViewAt(Place at) const { return ChainsAt(at).pose(); }
  Vec2 PixelAt(Place at) const { return ChainsAt(at).At(at.position); }
  Sighting SightingOf(Place at) const { return {&ViewAt(at), PixelAt(at)}; }

  // Sine of the angle between the chain at `at` and a line.
  double SineTo(const Line2D& line, Place at) const {
    const Vec2 tangent = ChainsAt(at).tangent(int64_t(at.position));
    return std::abs(line.a * tangent.x + line.b * tangent.y);
  }

  // +1 if the bright side of the chain is to the left in the direction of ascending points, else
  // -1.
  int BrightSide(Place at) const {
    const EdgeIndex& chains = ChainsAt(at);
    const int64_t i = int64_t(at.position);
    const Vec2 tangent = chains.tangent(i), normal = chains.normal(i);
    return Cross(tangent, normal) >= 0 ? 1 : -1;
  }

  // Whether the bright sides of two strands are on the same side of the 3D edge.
  bool SameBrightSide(const Strand& a, const Strand& b) const {
    return a.sign * BrightSide(a.at) == b.sign * BrightSide(b.at);
  }

  // Direction of the chain at `at` that corresponds to ascending points at `start`: both leave the
  // epipolar plane to the same side.
  int SignAlong(Place start, Place at, const Vec3& epipolar_normal) const {
    const auto leaves = [&](Place place) {
      const Vec2 tangent = ChainsAt(place).tangent(int64_t(place.position));
      return Dot(epipolar_normal, ViewAt(place).RotateBack({tangent.x, tangent.y, 0})) >= 0;
    };
    return leaves(start) == leaves(at) ? 1 : -1;
  }

  // The well-conditioned candidates, by view. Candidates whose bright side is on the other side of
  // the 3D edge belong to another edge.
  std::vector<Candidate> UsableCandidates(Place start, const Place* candidates,
                                          int64_t num_candidates) const {
    std::vector<Candidate> usable;
    const PinholeView& from = ViewAt(start);
    const Vec3 ray = from.Ray(PixelAt(start));
    int32_t view = -1;
    bool defined = false;
    Line2D line{}, back{};
    Vec3 epipolar_normal;
    for (int64_t i = 0; i < num_candidates; ++i) {
      const Place at = candidates[i];
      const PinholeView& to = ViewAt(at);
      if (at.view != view) {  // all candidates of a view have the same epipolar plane
        view = at.view;
        defined = EpipolarLine(from, to, PixelAt(start), &line) &&
                  EpipolarLine(to, from, PixelAt(at), &back) &&
                  SineTo(back, start) >= settings_.min_epipolar_sine;
        epipolar_normal = Cross(to.center - from.center, ray);
      }
      const double sine = defined ? SineTo(line, at) : 0;
      if (!defined || sine < settings_.min_epipolar_sine) continue;
      const int sign = SignAlong(start, at, epipolar_normal);
      Candidate candidate{at, 0, sign, 0, 0, 0};
      if (!SameBrightSide({start, 1}, {at, sign}) ||
          !MeetRay(from.center, ray, to, PixelAt(at), &candidate.inverse_distance,
                   &candidate.px_per_inverse)) {
        continue;
      }
      const double parallax = Norm(Cross(ray, to.Ray(PixelAt(at))));
      candidate.score = std::min(sine, SineTo(back, start)) *
                        std::min(1.0, parallax / settings_.full_triangulation_sine);
      if (!usable.empty()) candidate.group = usable.back().group + (usable.back().at.view != view);
      usable.push_back(candidate);
    }
    return usable;
  }

  bool TriangulateStrands(const std::vector<Strand>& strands, Vec3* point, double* error,
                          int* worst = nullptr) const {
    std::vector<Sighting>& sightings = Sightings();
    sightings.clear();
    for (const Strand& strand : strands) sightings.push_back(SightingOf(strand.at));
    const int count = int(sightings.size());
    if (!Triangulate(sightings.data(), count, point)) return false;
    *error = MaxReprojectionError(sightings.data(), count, *point, worst);
    return true;
  }

  // Number of valid selections (at most 2); `best` becomes the one with most supporting views.
  // Others count if they have at most one supporting view fewer.
  int SelectUnique(Place start, const std::vector<Candidate>& usable, Selection* best) const {
    thread_local std::vector<DepthInterval> intervals;
    thread_local std::vector<AgreedDepth> agreed;
    intervals.clear();
    for (const Candidate& candidate : usable) {
      const double slack = settings_.max_error_px / candidate.px_per_inverse;
      intervals.push_back({candidate.inverse_distance - slack, candidate.inverse_distance + slack,
                           candidate.group});
    }
    FindAgreement(intervals, settings_.min_views - 1, &agreed);
    int tried = 0, num_views = 0;
    for (const AgreedDepth& depth : agreed) {
      const bool found = num_views > 0;
      if (found ? depth.num_views + 1 < num_views : tried++ == settings_.max_selections) break;
      Selection selection;
      if (!SelectAt(start, usable, depth.inverse_distance, &selection)) continue;
      if (found && !SamePoint(selection, *best)) return 2;
      if (!found) *best = selection, num_views = depth.num_views;
    }
    return num_views > 0;
  }

  // The first valid selection of the start and two candidates, the best conditioned first, of those
  // nearest to a point of the start's ray in each view. False if there is none.
  bool SelectAt(Place start, const std::vector<Candidate>& usable, double inverse_distance,
                Selection* selection) const {
    std::vector<const Candidate*> near = NearestOfViews(usable, inverse_distance);
    std::stable_sort(near.begin(), near.end(),
                     [](const auto* a, const auto* b) { return a->score > b->score; });
    int tried = 0;
    for (size_t sum = 1; sum + 2 <= 2 * near.size(); ++sum) {
      // Pairs (i, j), i < j, best scores first: (0,1), (0,2), (0,3), (1,2), ...
      for (size_t i = 0; 2 * i < sum; ++i) {
        if (sum - i >= near.size()) continue;
        if (tried++ == settings_.max_selections) return false;
        const Candidate &a = *near[i], &b = *near[sum - i];
        selection->strands = {{start, 1}, {a.at, a.sign}, {b.at, b.sign}};
        if (TriangulateStrands(selection->strands, &selection->point, &selection->error) &&
            selection->error <= settings_.max_error_px && CanFollow(*selection)) {
          return true;
        }
      }
    }
    return false;
  }

  // The candidate nearest to a point of the start's ray, for each consistent view.
  std::vector<const Candidate*> NearestOfViews(const std::vector<Candidate>& usable,
                                               double inverse_distance) const {
    std::vector<const Candidate*> nearest;
    const auto distance = [&](const Candidate& candidate) {
      return std::abs(candidate.inverse_distance - inverse_distance) * candidate.px_per_inverse;
    };
    for (const Candidate& candidate : usable) {
      if (distance(candidate) > settings_.max_error_px) continue;
      if (nearest.empty() || nearest.back()->group != candidate.group) {
        nearest.push_back(&candidate);
      } else if (distance(candidate) < distance(*nearest.back())) {
        nearest.back() = &candidate;
      }
    }
    return nearest;
  }

  // Whether two selections are one 3D point within the errors in the views of the first.
  bool SamePoint(const Selection& a, const Selection& b) const {
    for (const Strand& strand : a.strands) {
      Vec2 p, q;
      if (!ViewAt(strand.at).Project(a.point, &p) || !ViewAt(strand.at).Project(b.point, &q) ||
          Norm(p - q) > settings_.max_error_px) {
        return false;
      }
    }
    return true;
  }

  // Maximum step in another view for one step of the leading view at `point`.
  double Reach(const PinholeView& leader, const PinholeView& other, const Vec3& point) const {
    const double leader_scale = leader.focal_px / leader.FromWorld(point).z;
    const double other_scale = other.focal_px / other.FromWorld(point).z;
    return settings_.max_step_ratio * settings_.step_px * std::max(1.0, other_scale / leader_scale);
  }

  // Whether a selection can be followed for min_steps (1 or 2: in one or both directions).
  bool CanFollow(const Selection& selection) const {
    std::vector<Strand> strands = selection.strands;
    int valid = 0;
    for (int way = 0; way < 2; ++way, Reverse(&strands)) {
      StepResult step;
      valid += Step(strands, selection.point, &step);
      if (valid + 1 - way < settings_.min_steps) return false;
    }
    return valid >= settings_.min_steps;
  }

  static void Reverse(std::vector<Strand>* strands) {
    for (Strand& strand : *strands) strand.sign = -strand.sign;
  }

  bool Step(Place from, int sign, Place* to) const {
    to->view = from.view;
    return Walk(ChainsAt(from), from.position, sign, settings_.step_px, &to->position);
  }

  // Moves a strand to its first intersection with the epipolar line of the leader's new place.
  bool MoveToLine(const Strand& lead, const Vec3& point, Strand* strand) const {
    Line2D line;
    const PinholeView &from = ViewAt(lead.at), &to = ViewAt(strand->at);
    if (!EpipolarLine(from, to, PixelAt(lead.at), &line)) return false;
    Place at = strand->at;
    if (!FirstCrossing(ChainsAt(at), at.position, strand->sign, line, Reach(from, to, point),
                       &at.position) ||
        SineTo(line, at) < settings_.min_epipolar_sine) {
      return false;
    }
    strand->at = at;
    return SameBrightSide(lead, *strand);
  }

  // False for a 3D step much longer than its projection in a view: an edge along the viewing ray is
  // usually a jump in depth.
  bool Plausible(const Vec3& from, const Vec3& to, const std::vector<Strand>& strands) const {
    double longest = 0, frontal = 0;
    for (const Strand& strand : strands) {
      const PinholeView& view = ViewAt(strand.at);
      Vec2 a, b;
      if (!view.Project(from, &a) || !view.Project(to, &b)) return false;
      longest = std::max(longest, Norm(b - a));
      frontal = std::max(frontal, Norm(to - from) * view.focal_px / view.FromWorld(to).z);
    }
    return frontal <= settings_.max_stretch * longest;
  }

  // One step of all strands. Views whose chains end or disagree are dropped while min_views remain.
  // If the leading chain ends, the next view leads.
  bool Step(const std::vector<Strand>& strands, const Vec3& point, StepResult* step) const {
    for (size_t leader = 0; leader + settings_.min_views <= strands.size(); ++leader) {
      Place lead;
      if (!Step(strands[leader].at, strands[leader].sign, &lead)) continue;
      step->strands = {{lead, strands[leader].sign}};
      for (size_t i = leader + 1; i < strands.size(); ++i) {
        Strand strand = strands[i];
        if (MoveToLine(step->strands[0], point, &strand)) step->strands.push_back(strand);
      }
      if (Reconcile(step) && Plausible(point, step->point, step->strands)) return true;
    }
    return false;
  }

  // Triangulates, dropping the worst strand while the error is too large.
  bool Reconcile(StepResult* step) const {
    while (int(step->strands.size()) >= settings_.min_views) {
      int worst = 0;
      if (!TriangulateStrands(step->strands, &step->point, &step->error, &worst)) return false;
      if (step->error <= settings_.max_error_px) return true;
      step->strands.erase(step->strands.begin() + worst);
    }
    return false;
  }

  // Adds candidates of further views that are consistent with the point and the edge's directions.
  void Extend(const std::vector<Candidate>& usable, Selection* selection) const {
    std::array<StepResult, 2> steps;
    std::array<bool, 2> stepped;
    for (int k = 0; k < 2; ++k) {
      std::vector<Strand> strands = selection->strands;
      if (k == 1) Reverse(&strands);
      stepped[k] = Step(strands, selection->point, &steps[k]);
    }
    for (size_t i = 0; i < usable.size();) {
      Selection best;
      const int32_t view = usable[i].at.view;
      const bool seen = SeenFrom(view, selection->strands);
      for (; i < usable.size() && usable[i].at.view == view; ++i) {
        const Place at = usable[i].at;
        Vec2 pixel;
        if (seen || !ViewAt(at).Project(selection->point, &pixel) ||
            Norm(pixel - PixelAt(at)) > 4 * settings_.max_error_px) {
          continue;
        }
        Selection extended = *selection;
        extended.strands.push_back({at, usable[i].sign});
        if (TriangulateStrands(extended.strands, &extended.point, &extended.error) &&
            extended.error <= settings_.max_error_px && extended.error < best.error &&
            FitsSteps(extended.strands.back(), steps, stepped)) {
          best = extended;
        }
      }
      if (!best.strands.empty()) *selection = best;
    }
  }

  bool SeenFrom(int32_t view, const std::vector<Strand>& strands) const {
    return std::any_of(strands.begin(), strands.end(),
                       [&](const Strand& s) { return s.at.view == view; });
  }

  // Whether a new strand also observes the neighbouring 3D points, if there are any.
  bool FitsSteps(const Strand& strand, const std::array<StepResult, 2>& steps,
                 const std::array<bool, 2>& stepped) const {
    int fits = 0;
    for (int k = 0; k < 2; ++k) {
      if (!stepped[k]) continue;
      Strand next{strand.at, k == 0 ? strand.sign : -strand.sign};
      Vec2 pixel;
      if (MoveToLine(steps[k].strands[0], steps[k].point, &next) &&
          ViewAt(next.at).Project(steps[k].point, &pixel)) {
        fits += Norm(pixel - PixelAt(next.at)) <= settings_.max_error_px;
      }
    }
    return fits > 0;
  }

  static EdgePoint3D MakePoint(const Vec3& position, const std::vector<Strand>& strands) {
    EdgePoint3D point{position, {}};
    for (const Strand& strand : strands) point.track.push_back(strand.at);
    return point;
  }

  // Follows the selection forward, then backward.
  void Follow(const Selection& selection, Edge3D* edge) const {
    std::vector<EdgePoint3D> forward, backward;
    edge->points.clear();
    edge->closed = FollowOneWay(selection, &forward);
    if (!edge->closed) {
      Selection reversed = selection;
      Reverse(&reversed.strands);
      FollowOneWay(reversed, &backward);
    }
    edge->points.assign(backward.rbegin(), backward.rend());
    edge->points.push_back(MakePoint(selection.point, selection.strands));
    edge->points.insert(edge->points.end(), forward.begin(), forward.end());
  }

  // Returns whether the edge is closed.
  bool FollowOneWay(const Selection& selection, std::vector<EdgePoint3D>* points) const {
    std::vector<Strand> strands = selection.strands;
    Vec3 point = selection.point;
    StepResult step;
    while (int64_t(points->size()) < num_points_ && Step(strands, point, &step)) {
      EdgePoint3D next = MakePoint(step.point, step.strands);
      if (MostlyCovered(next.track, covered_)) return false;
      if (points->size() > 1 && CameRound(strands, step.strands, selection)) return true;
      strands = step.strands;
      point = step.point;
      points->push_back(std::move(next));
    }
    return false;
  }

  // Whether the last step of the leader on a closed polyline passed its start; the first leader may
  // have been dropped meanwhile.
  bool CameRound(const std::vector<Strand>& before, const std::vector<Strand>& after,
                 const Selection& selection) const {
    const Place now = after[0].at;
    const EdgeIndex& chains = ChainsAt(now);
    const int32_t polyline = chains.polyline(int64_t(now.position));
    const auto place_on_it = [&](const std::vector<Strand>& strands) {
      return std::find_if(strands.begin(), strands.end(), [&](const Strand& strand) {
        return OnOnePolyline(views_, strand.at, now);
      });
    };
    const auto begun = place_on_it(selection.strands), previous = place_on_it(before);
    if (!chains.closed(polyline) || begun == selection.strands.end() || previous == before.end()) {
      return false;
    }
    const double size = double(chains.last(polyline) - chains.first(polyline) + 1);
    const auto ahead =
        [&](Place at) {  // points after the last place, in the direction of following
          const double delta = at.position - previous->at.position;
          return std::fmod(after[0].sign * delta + 2 * size, size);
        };
    return ahead(begun->at) <= ahead(now);
  }

  static std::vector<Sighting>& Sightings() {
    thread_local std::vector<Sighting> sightings;
    return sightings;
  }

  const Views& views_;
  const FollowSettings& settings_;
  const Coverage& covered_;
  int64_t num_points_ = 0;
};

// Marks the chain points between two places on one polyline; on a closed one, the shorter way.
inline void MarkStretch(const EdgeIndex& chains, double a, double b,
                        std::vector<uint8_t>* covered) {
  const int32_t polyline = chains.polyline(int64_t(a));
  const int64_t low = int64_t(std::min(a, b)), high = int64_t(std::max(a, b));
  const int64_t first = chains.first(polyline), last = chains.last(polyline);
  const auto mark = [&](int64_t from, int64_t to) {
    std::fill(covered->begin() + from, covered->begin() + to + 1, uint8_t(1));
  };
  if (chains.closed(polyline) && 2 * (high - low) > last - first + 1) {
    mark(high, last), mark(first, low);
  } else {
    mark(low, high);
  }
}

// Marks the chain points covered by an edge in every view that observes consecutive points.
inline void MarkEdge(const Views& views, const Edge3D& edge, Coverage* covered) {
  const size_t count = edge.points.size();
  for (size_t i = 0; i + 1 < count + (edge.closed ? 1 : 0); ++i) {
    for (const Place& a : edge.points[i].track) {
      for (const Place& b : edge.points[(i + 1) % count].track) {
        if (!OnOnePolyline(views, a, b)) continue;
        MarkStretch(*views[a.view], a.position, b.position, &(*covered)[a.view]);
      }
    }
  }
}

// Whether the last changes of `covered` affect an edge traced before them.
inline bool RunsIntoCovered(const Edge3D& edge, const Coverage& covered) {
  return std::any_of(edge.points.begin(), edge.points.end(),
                     [&](const EdgePoint3D& point) { return MostlyCovered(point.track, covered); });
}

struct Pepcs {
  const Place* starts;
  int64_t num_starts;
  const int64_t* offsets;  // CSR of the candidates by start, those of a start grouped by view
  const Place* candidates;
};

inline Coverage NothingCovered(const Views& views) {
  Coverage covered;
  for (const EdgeIndex* chains : views) covered.emplace_back(chains->num_points());
  return covered;
}

// Validates PEPCs in order, follows accepted ones on uncovered chains and marks the chains that
// they cover. They are traced in parallel in batches, with the coverage at the start of the batch.
// A PEPC near chains covered by an earlier one of its batch is traced again, so the result is that
// of one thread.
inline std::vector<Edge3D> TraceEdges(const Views& views, const Pepcs& pepcs,
                                      const FollowSettings& settings, int num_threads,
                                      Coverage* covered, std::vector<StartOutcome>* outcomes) {
  constexpr int64_t kBatch = 256;
  const EdgeTracer tracer(views, settings, *covered);
  std::vector<Edge3D> edges, batch(kBatch);
  outcomes->assign(pepcs.num_starts, StartOutcome::kCovered);
  const auto trace = [&](int64_t i, Edge3D* edge) {
    (*outcomes)[i] = tracer.Trace(pepcs.starts[i], pepcs.candidates + pepcs.offsets[i],
                                  pepcs.offsets[i + 1] - pepcs.offsets[i], edge);
  };
  for (int64_t begin = 0; begin < pepcs.num_starts; begin += kBatch) {
    const int64_t count = std::min(kBatch, pepcs.num_starts - begin);
    ParallelBlocks(count, num_threads, 8, [&](int64_t k) { trace(begin + k, &batch[k]); });
    for (int64_t k = 0; k < count; ++k) {
      const int64_t i = begin + k;
      if ((*outcomes)[i] != StartOutcome::kAccepted) continue;
      if (IsCovered(pepcs.starts[i], *covered) || RunsIntoCovered(batch[k], *covered)) {
        trace(i, &batch[k]);
        if ((*outcomes)[i] != StartOutcome::kAccepted) continue;
      }
      MarkEdge(views, batch[k], covered);
      edges.push_back(std::move(batch[k]));
    }
  }
  return edges;
}

}  // namespace colmap_edges
