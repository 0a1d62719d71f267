// Search of the depths and normals at which windows of a view agree with those of its neighbours.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

#include "patches/views.h"

namespace colmap_edges {

struct PatchOptions {
  int step;           // pixels between sites
  double flat;        // variance of gray, in levels squared, that is no texture
  double min_cosine;  // of the angle between normal and ray
  int num_sweeps;     // over all sites
  double believed;    // correlation of a view that shows the patch
};

// A patch at a site of a view: what is searched, and how sure it is.
struct FoundPatch {
  PatchPlane plane;
  double score = -1;     // mean correlation of the better half of the neighbours
  double sigma = 0;      // standard deviation of the inverse depth
  double unit = 0;       // change of the inverse depth that moves it a pixel in a neighbour
  uint32_t showing = 0;  // neighbours that show it, a bit each
};

// Sites of a view on a grid. Hypotheses: inverse depths and slopes, NAN for none.
struct PatchSites {
  int rows = 0, columns = 0;
  const uint8_t* active = nullptr;    // (rows, columns)
  const float* hypotheses = nullptr;  // (rows, columns, num_hypotheses, 3)
  int num_hypotheses = 0;
  double low = 0, high = 0;  // range of random inverse depths

  int count() const { return rows * columns; }
};

class PatchSearch {
 public:
  PatchSearch(const std::vector<PatchView>& views, int view, const std::vector<int>& neighbors,
              const PatchSites& sites, const PatchOptions& options, uint64_t seed)
      : view_(views[view]),
        sites_(sites),
        options_(options),
        state_(seed * 2654435761u + view + 1),
        patches_(sites.count()) {
    for (const int other : neighbors) {
      others_.push_back(&views[other]);
      relatives_.emplace_back(view_, views[other]);
    }
  }

  std::vector<FoundPatch> Run() {
    if (others_.empty()) return std::move(patches_);
    for (int site = 0; site < sites_.count(); ++site)
      if (sites_.active[site]) Begin(site);
    for (int sweep = 0; sweep < options_.num_sweeps; ++sweep)
      for (int i = 0; i < sites_.count(); ++i) {
        const int site = sweep % 2 ? sites_.count() - 1 - i : i;
        if (sites_.active[site]) Improve(site, sweep);
      }
    for (int site = 0; site < sites_.count(); ++site)
      if (sites_.active[site]) Finish(site);
    return std::move(patches_);
  }

 private:
  static constexpr int kMaxOthers = 32;

  int XOf(int site) const { return kWindowRadius + site % sites_.columns * options_.step; }
  int YOf(int site) const { return kWindowRadius + site / sites_.columns * options_.step; }
  float flat() const { return float(options_.flat); }

  // Uniform in [0, 1).
  double Random() {
    state_ ^= state_ << 13, state_ ^= state_ >> 7, state_ ^= state_ << 17;
    return double(state_ >> 11) / 9007199254740992.0;
  }

  // Mean correlation of the better half of the neighbours.
  double ScoreOf(int site, const Window& window, const PatchPlane& plane) const {
    std::array<float, kMaxOthers> found;
    Correlations<kHalfCount>(site, window, plane, found);
    const int count = int(others_.size()), half = (count + 1) / 2;
    std::partial_sort(found.begin(), found.begin() + half, found.begin() + count,
                      std::greater<float>());
    double sum = 0;
    for (int i = 0; i < half; ++i) sum += found[i];
    return sum / half;
  }

  template <int kCount>
  void Correlations(int site, const Window& window, const PatchPlane& plane,
                    std::array<float, kMaxOthers>& found) const {
    WindowPlaces<kCount> places;
    for (size_t i = 0; i < others_.size(); ++i)
      found[i] = places.Set(relatives_[i], XOf(site), YOf(site), plane, *others_[i])
                     ? window.Correlation(places, *others_[i], flat())
                     : -1;
  }

  bool IsPossible(int site, const PatchPlane& plane) const {
    return plane.inverse > 0 && CosineOf(view_, XOf(site), YOf(site), plane) > options_.min_cosine;
  }

  bool Try(int site, const Window& window, const PatchPlane& plane) {
    if (!IsPossible(site, plane)) return false;
    const double score = ScoreOf(site, window, plane);
    if (!(score > patches_[site].score)) return false;
    patches_[site].plane = plane, patches_[site].score = score;
    return true;
  }

  void Begin(int site) {
    const Window window(view_, XOf(site), YOf(site));
    // The first is the best one nearly always.
    for (int i = 0; i < sites_.num_hypotheses && patches_[site].score < options_.believed; ++i) {
      const float* of = sites_.hypotheses + (size_t(site) * sites_.num_hypotheses + i) * 3;
      if (std::isfinite(of[0])) Try(site, window, {of[0], of[1], of[2]});
    }
    if (patches_[site].score < options_.believed) TryRandom(site, window, 2);
  }

  bool TryRandom(int site, const Window& window, int count) {
    bool found = false;
    for (int i = 0; i < count; ++i)
      found |= Try(site, window, {sites_.low + Random() * (sites_.high - sites_.low), 0, 0});
    return found;
  }

  // Takes over what the sites visited before found, and moves it to where gray agrees best.
  void Improve(int site, int sweep) {
    const int row = site / sites_.columns, column = site % sites_.columns;
    const int before = sweep % 2 ? 1 : -1;
    const Window window(view_, XOf(site), YOf(site));
    bool is_new = sweep == 0;
    for (const auto& [down, right] : {std::array<int, 2>{0, before}, {before, 0}}) {
      const int r = row + down, c = column + right;
      if (r < 0 || c < 0 || r >= sites_.rows || c >= sites_.columns) continue;
      const FoundPatch& other = patches_[r * sites_.columns + c];
      if (other.score < kUseful) continue;
      const PatchPlane moved = other.plane.Moved(-right * options_.step, -down * options_.step);
      if (patches_[site].score >= options_.believed &&
          std::abs(moved.inverse - patches_[site].plane.inverse) <
              kSamePx * UnitOf(site, moved.inverse))
        continue;
      is_new |= Try(site, window, moved);
    }
    if (patches_[site].score < options_.believed) is_new |= TryRandom(site, window, 2);
    if (!is_new || patches_[site].score < kUseful) return;
    PatchPlane plane = patches_[site].plane;
    if (Step(site, window, plane, nullptr)) Try(site, window, plane);
  }

  // Median over neighbours of the change of inverse depth that moves a place by a pixel.
  double UnitOf(int site, double inverse) const {
    std::array<double, kMaxOthers> moves;
    const size_t count = others_.size();
    for (size_t i = 0; i < count; ++i)
      moves[i] = Norm(relatives_[i].Parallax(XOf(site), YOf(site), inverse));
    std::nth_element(moves.begin(), moves.begin() + count / 2, moves.begin() + count);
    return 1 / moves[count / 2];
  }

  struct Normals {
    std::array<double, 6> matrix{};  // upper triangle: 00 01 02 11 12 22
    std::array<double, 3> right{};
    double squares = 0;  // sum of squared differences
    int count = 0;
  };

  // A step of Gauss and Newton on the differences of gray, each brightness and contrast apart, in
  // all neighbours that show the patch. `sigma`, if wanted, of the inverse depth.
  bool Step(int site, const Window& window, PatchPlane& plane, double* sigma) const {
    Normals sums;
    WindowPlaces<kWindowCount> places;
    for (size_t i = 0; i < others_.size(); ++i) {
      if (!places.Set(relatives_[i], XOf(site), YOf(site), plane, *others_[i])) continue;
      AddDifferences(window, places, relatives_[i], *others_[i], sums);
    }
    if (sums.count == 0) return false;
    const double unit = UnitOf(site, plane.inverse);
    const double variance = std::max(sums.squares / std::max(sums.count - 5, 1), options_.flat);
    // Slopes of more than about a pixel of parallax per pixel are rare.
    auto& m = sums.matrix;
    m[3] += variance / (unit * unit), m[5] += variance / (unit * unit);
    const double c00 = m[3] * m[5] - m[4] * m[4], c01 = m[2] * m[4] - m[1] * m[5],
                 c02 = m[1] * m[4] - m[2] * m[3];
    const double determinant = m[0] * c00 + m[1] * c01 + m[2] * c02;
    if (!(determinant > 0)) return false;
    const double c11 = m[0] * m[5] - m[2] * m[2], c12 = m[1] * m[2] - m[0] * m[4],
                 c22 = m[0] * m[3] - m[1] * m[1];
    const auto& r = sums.right;
    plane.inverse += (c00 * r[0] + c01 * r[1] + c02 * r[2]) / determinant;
    plane.slope_x += (c01 * r[0] + c11 * r[1] + c12 * r[2]) / determinant;
    plane.slope_y += (c02 * r[0] + c12 * r[1] + c22 * r[2]) / determinant;
    if (sigma) *sigma = std::sqrt(variance * c00 / determinant);
    return true;
  }

  // Adds the differences of a window from what a neighbour shows, if that is alike.
  void AddDifferences(const Window& window, const WindowPlaces<kWindowCount>& at,
                      const RelativeView& relative, const PatchView& other, Normals& sums) const {
    const WindowGray<kWindowCount> there(other, at);
    const std::array<float, kWindowCount>& gray = there.gray;
    std::array<float, kWindowCount> change;
    const float sx = float(relative.shift.x), sy = float(relative.shift.y),
                sz = float(relative.shift.z);
    for (int i = 0; i < kWindowCount; ++i)
      change[i] = (there.right[i] * (sx - at.x[i] * sz) + there.down[i] * (sy - at.y[i] * sz)) *
                  at.scale[i];
    const float sum = SumOf(gray), sum_squares = ProductOf(gray, gray);
    const float products = ProductOf(window.gray, gray);
    const float squares = sum_squares - sum * sum / kWindowCount;
    if (!(squares > flat() * kWindowCount) ||
        !(products > kUseful * std::sqrt(squares * window.squares)))
      return;
    const float gain = std::sqrt(window.squares / squares), mean = sum / kWindowCount;
    // Changes by inverse depth and slopes, and the differences.
    std::array<std::array<float, kWindowCount>, 4> of;
    for (int i = 0; i < kWindowCount; ++i) {
      of[0][i] = gain * change[i];
      of[1][i] = kPixels.dx[i] * of[0][i], of[2][i] = kPixels.dy[i] * of[0][i];
      of[3][i] = window.gray[i] - gain * (gray[i] - mean);
    }
    for (int k = 0; k < 3; ++k) {
      const float mean_change = SumOf(of[k]) / kWindowCount;
      for (float& value : of[k]) value -= mean_change;
    }
    int at_matrix = 0;
    for (int k = 0; k < 3; ++k) {
      for (int l = k; l < 3; ++l) sums.matrix[at_matrix++] += ProductOf(of[k], of[l]);
      sums.right[k] += ProductOf(of[k], of[3]);
    }
    sums.squares += ProductOf(of[3], of[3]), sums.count += kWindowCount;
  }

  // The standard deviation, and which neighbours show the patch.
  void Finish(int site) {
    FoundPatch& patch = patches_[site];
    if (patch.score < options_.believed) return;
    const Window window(view_, XOf(site), YOf(site));
    for (int i = 0; i < 2; ++i) {
      PatchPlane plane = patch.plane;
      if (!Step(site, window, plane, &patch.sigma)) break;
      const double moved = std::abs(plane.inverse - patch.plane.inverse);
      if (!Try(site, window, plane) || moved < kStillPx * UnitOf(site, plane.inverse)) break;
    }
    patch.unit = UnitOf(site, patch.plane.inverse);
    std::array<float, kMaxOthers> found;
    Correlations<kWindowCount>(site, window, patch.plane, found);
    for (size_t i = 0; i < others_.size(); ++i)
      if (found[i] >= options_.believed) patch.showing |= uint32_t{1} << i;
  }

  static constexpr double kSamePx = 0.1;    // parallax between planes of which one is tried
  static constexpr double kStillPx = 0.02;  // parallax of a step after which none follows
  static constexpr float kUseful = 0.5f;    // correlation from which a place may be near

  const PatchView& view_;
  const PatchSites& sites_;
  const PatchOptions& options_;
  uint64_t state_;
  std::vector<FoundPatch> patches_;
  std::vector<const PatchView*> others_;
  std::vector<RelativeView> relatives_;
};

}  // namespace colmap_edges
