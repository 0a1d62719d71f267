// Links the pixels of a thinned edge image to chains.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "common/vectors.h"

namespace colmap_edges {

// Set pixels, row by row, and their neighbours: 4-neighbours, and diagonal neighbours without a
// common 4-neighbour that is set, so that chains follow staircases pixel by pixel.
class TouchingPixels {
 public:
  TouchingPixels(const uint8_t* map, int64_t width, int64_t height)
      : map_(map), width_(width), height_(height), index_(width * height, -1) {
    for (int64_t i = 0; i < width * height; ++i) {
      if (map[i] == 0) continue;
      index_[i] = int32_t(places_.size());
      places_.push_back(i);
    }
  }

  int32_t Count() const { return int32_t(places_.size()); }

  Vec2 Place(int32_t pixel) const {
    return {double(places_[pixel] % width_), double(places_[pixel] / width_)};
  }

  // The neighbours of a pixel, at most 4. Returns their number.
  int Around(int32_t pixel, std::array<int32_t, 4>* found) const {
    const int64_t x = places_[pixel] % width_, y = places_[pixel] / width_;
    int count = 0;
    for (const auto& [dx, dy] : {std::array{0, -1}, {-1, 0}, {1, 0}, {0, 1}}) {
      if (Set(x + dx, y + dy)) (*found)[count++] = index_[(y + dy) * width_ + x + dx];
    }
    for (const auto& [dx, dy] : {std::array{-1, -1}, {1, -1}, {-1, 1}, {1, 1}}) {
      if (Set(x + dx, y + dy) && !Set(x + dx, y) && !Set(x, y + dy)) {
        (*found)[count++] = index_[(y + dy) * width_ + x + dx];
      }
    }
    return count;
  }

 private:
  bool Set(int64_t x, int64_t y) const {
    return x >= 0 && y >= 0 && x < width_ && y < height_ && map_[y * width_ + x] != 0;
  }

  const uint8_t* map_;
  int64_t width_, height_;
  std::vector<int32_t> index_;   // of each place in the image, -1 if not set
  std::vector<int64_t> places_;  // place in the image of each set pixel
};

// Direction of a branch that leaves a pixel by a neighbour: towards the pixel `reach` steps away,
// or fewer if the branch ends or forks.
inline Vec2 BranchDirection(const TouchingPixels& pixels, int32_t from, int32_t by, int reach) {
  int32_t before = from, here = by;
  for (int step = 1; step < reach; ++step) {
    std::array<int32_t, 4> around;
    if (pixels.Around(here, &around) != 2) break;
    const int32_t next = around[0] == before ? around[1] : around[0];
    before = here, here = next;
  }
  const Vec2 way = pixels.Place(here) - pixels.Place(from);
  return (1 / std::max(Norm(way), 1.0)) * way;
}

// The two neighbours of a pixel that are connected through it: at a junction those of the smallest
// turn, the first ones if equal. -1 for missing ones.
inline std::array<int32_t, 2> PassedNeighbours(const TouchingPixels& pixels, int32_t pixel,
                                               int reach) {
  std::array<int32_t, 4> around;
  const int count = pixels.Around(pixel, &around);
  std::array<int32_t, 2> passed = {count > 0 ? around[0] : -1, count > 1 ? around[1] : -1};
  if (count < 3) return passed;
  std::array<Vec2, 4> ways;
  for (int k = 0; k < count; ++k) ways[k] = BranchDirection(pixels, pixel, around[k], reach);
  double best = 2;
  for (int a = 0; a < count; ++a) {
    for (int b = a + 1; b < count; ++b) {
      const double cosine = Dot(ways[a], ways[b]);
      if (cosine < best) best = cosine, passed = {around[a], around[b]};
    }
  }
  return passed;
}

// Links pixels to chains; each pixel is in one chain. At a junction, the two branches of the
// smallest turn form one chain, and the others end next to it. Writes (x, y) of the pixels and the
// offsets of the chains: open ones in the order of their first pixels, then closed ones.
inline void LinkPixels(const uint8_t* map, int64_t width, int64_t height, int reach,
                       std::vector<double>* places, std::vector<int64_t>* offsets) {
  const TouchingPixels pixels(map, width, height);
  std::vector<std::array<int32_t, 2>> links(pixels.Count());
  for (int32_t i = 0; i < pixels.Count(); ++i) links[i] = PassedNeighbours(pixels, i, reach);
  const auto passes = [&](int32_t i, int32_t by) {
    return by >= 0 && (links[by][0] == i || links[by][1] == i);
  };
  std::vector<std::array<int32_t, 2>> mutual(links.size());
  for (int32_t i = 0; i < pixels.Count(); ++i) {
    for (int k = 0; k < 2; ++k) mutual[i][k] = passes(i, links[i][k]) ? links[i][k] : -1;
  }
  std::vector<bool> seen(links.size());
  offsets->assign(1, 0);
  const auto trace = [&](int32_t start) {
    for (int32_t here = start; here >= 0;) {
      seen[here] = true;
      const Vec2 place = pixels.Place(here);
      places->push_back(place.x), places->push_back(place.y);
      const auto [a, b] = mutual[here];
      here = a >= 0 && !seen[a] ? a : b >= 0 && !seen[b] ? b : -1;
    }
    offsets->push_back(int64_t(places->size() / 2));
  };
  for (const bool open : {true, false}) {
    for (int32_t i = 0; i < pixels.Count(); ++i) {
      const bool is_end = mutual[i][0] < 0 || mutual[i][1] < 0;
      if (!seen[i] && (is_end || !open)) trace(i);
    }
  }
}

}  // namespace colmap_edges
