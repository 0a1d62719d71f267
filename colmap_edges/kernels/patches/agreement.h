// Agreement of the patches of several views.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "patches/search.h"
#include "patches/views.h"

namespace colmap_edges {

struct AgreementOptions {
  int step;
  double max_off_px;  // maximum distance of agreeing patches, in pixels of parallax
};

// A patch as several views see it.
struct AgreedPatch {
  double inverse = 0, sigma = 0;  // mean of those that agree, and its standard deviation
  int through = 0;                // views that see what is behind it
  bool is_best = false;           // no agreeing view sees it with more pixels
  std::vector<int32_t> views;     // that agree, without its own
};

class Agreement {
 public:
  Agreement(const std::vector<PatchView>& views, const std::vector<PatchSites>& sites,
            const std::vector<std::vector<FoundPatch>>& patches, const AgreementOptions& options)
      : views_(views), sites_(sites), patches_(patches), options_(options) {}

  AgreedPatch Of(int v, int site, const std::vector<int>& others) const {
    const PatchView& view = views_[v];
    const FoundPatch& patch = patches_[v][site];
    const Vec2 pixel = PixelOf(v, site);
    const Vec3 ray = view.LocalRay(pixel.x, pixel.y);
    const auto place = [&](double inverse) {
      return view.pose.RotateBack((1 / inverse) * ray - view.pose.t);
    };
    const Vec3 normal = view.pose.RotateBack(LocalNormal(view, pixel.x, pixel.y, patch.plane));
    const double floor = kFloorPx * patch.unit;
    const double variance = patch.sigma * patch.sigma + floor * floor;
    double weights = 1 / variance, sum = patch.plane.inverse / variance;
    AgreedPatch agreed;
    agreed.is_best = true;
    const Vec3 here = place(patch.plane.inverse);
    const double size = SizeOf(view, here, normal);
    for (const int other : others) {
      const int found = SiteAt(other, here);
      if (found < 0) continue;
      const double off = Off(other, found, here);
      const double slope = (Off(other, found, place(1.0001 * patch.plane.inverse)) - off) /
                           (0.0001 * patch.plane.inverse);
      if (!(std::abs(slope) > 0)) continue;
      const FoundPatch& theirs = patches_[other][found];
      const double noise = theirs.sigma / slope;
      const double its = noise * noise + floor * floor, away = off / slope;
      const double most = options_.max_off_px * patch.unit;
      if (std::abs(away) > most) {
        agreed.through += off > 0 && std::abs(away) > 2 * most;
        continue;
      }
      const Vec2 at = PixelOf(other, found);
      const Vec3 their_normal =
          views_[other].pose.RotateBack(LocalNormal(views_[other], at.x, at.y, theirs.plane));
      agreed.views.push_back(other);
      sum += (patch.plane.inverse - away) / its, weights += 1 / its;
      const double their_size = SizeOf(views_[other], here, their_normal);
      if (their_size < size || (their_size == size && other < v)) agreed.is_best = false;
    }
    agreed.inverse = sum / weights, agreed.sigma = std::sqrt(1 / weights);
    return agreed;
  }

  Vec2 PixelOf(int view, int site) const {
    const int columns = sites_[view].columns;
    return {double(kWindowRadius + site % columns * options_.step),
            double(kWindowRadius + site / columns * options_.step)};
  }

 private:
  static constexpr double kFloorPx = 0.05;  // what poses and interpolation of gray leave

  // Size on the surface of a pixel of a view.
  static double SizeOf(const PatchView& view, const Vec3& point, const Vec3& normal) {
    const Vec3 away = point - view.pose.center;
    const double cosine = std::abs(Dot(away, normal)) / (Norm(away) * Norm(normal));
    return Norm(away) / view.pose.focal_px / std::max(cosine, 0.05);
  }

  // The found site nearest to where a view sees a place; -1 without any.
  int SiteAt(int v, const Vec3& point) const {
    Vec2 pixel;
    double depth;
    if (!views_[v].Project(point, &pixel, &depth)) return -1;
    const PatchSites& sites = sites_[v];
    const double column = (pixel.x - kWindowRadius) / options_.step,
                 row = (pixel.y - kWindowRadius) / options_.step;
    if (!(column > -1 && row > -1 && column < sites.columns && row < sites.rows)) return -1;
    int best = -1;
    double least = 1e300;
    for (int r = int(std::floor(row)); r <= int(std::floor(row)) + 1; ++r) {
      for (int c = int(std::floor(column)); c <= int(std::floor(column)) + 1; ++c) {
        if (r < 0 || c < 0 || r >= sites.rows || c >= sites.columns) continue;
        const int site = r * sites.columns + c;
        const double away = (r - row) * (r - row) + (c - column) * (c - column);
        if (patches_[v][site].unit > 0 && away < least) least = away, best = site;
      }
    }
    return best;
  }

  // Inverse depth of a place in a view, less that of the plane of a patch there.
  double Off(int v, int site, const Vec3& point) const {
    Vec2 pixel;
    double depth;
    if (!views_[v].Project(point, &pixel, &depth)) return NAN;
    const Vec2 away = pixel - PixelOf(v, site);
    return 1 / depth - patches_[v][site].plane.At(away.x, away.y);
  }

  const std::vector<PatchView>& views_;
  const std::vector<PatchSites>& sites_;
  const std::vector<std::vector<FoundPatch>>& patches_;
  const AgreementOptions& options_;
};

}  // namespace colmap_edges
