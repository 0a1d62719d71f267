// Triangles in pictures: depths, what a view sees of each triangle, and colours painted over them.
// A pixel's centre is half a pixel from its corner, as in COLMAP.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <vector>

namespace colmap_edges {

struct Corner {
  double x = 0, y = 0;
};

// Barycentric coordinates in a triangle of a picture; they are linear in x and y.
class Plane2D {
 public:
  explicit Plane2D(const std::array<Corner, 3>& at) : at_(at) {
    twice_area_ =
        (at[1].x - at[0].x) * (at[2].y - at[0].y) - (at[1].y - at[0].y) * (at[2].x - at[0].x);
    for (int k = 0; k < 3; ++k) {
      const Corner &p = at[(k + 1) % 3], &q = at[(k + 2) % 3];
      along_x_[k] = (p.y - q.y) / twice_area_, along_y_[k] = (q.x - p.x) / twice_area_;
    }
  }
  double area() const { return std::abs(twice_area_) / 2; }
  bool IsDegenerate() const { return !(std::abs(twice_area_) > 1e-12); }
  std::array<double, 3> At(double x, double y) const {
    std::array<double, 3> weights{};
    for (int k = 1; k < 3; ++k)
      weights[k] = along_x_[k] * (x - at_[0].x) + along_y_[k] * (y - at_[0].y);
    weights[0] = 1 - weights[1] - weights[2];
    return weights;
  }
  double AlongX(int k) const { return along_x_[k]; }
  // How far a barycentric coordinate changes over a length.
  double Change(int k, double length) const {
    return length * std::hypot(along_x_[k], along_y_[k]);
  }

 private:
  std::array<Corner, 3> at_;
  double twice_area_ = 0;
  std::array<double, 3> along_x_{}, along_y_{};
};

// Calls body(row, column, barycentric coordinates) for each pixel whose centre lies inside of a
// triangle, or at most `margin` pixels from the lines through its sides.
template <typename Body>
void ForPixels(const std::array<Corner, 3>& at, int rows, int columns, double margin,
               const Body& body) {
  const Plane2D plane(at);
  if (plane.IsDegenerate()) return;
  const auto [left, right] = std::minmax({at[0].x, at[1].x, at[2].x});
  const auto [top, bottom] = std::minmax({at[0].y, at[1].y, at[2].y});
  const auto first = [](double low, int count) {
    return int(std::clamp(std::ceil(low - 0.5), 0.0, double(count)));
  };
  const auto last = [](double high, int count) {
    return int(std::clamp(std::floor(high - 0.5), -1.0, double(count - 1)));
  };
  std::array<double, 3> least{};  // of the coordinates
  for (int k = 0; k < 3; ++k) least[k] = -plane.Change(k, margin + 1e-9);
  for (int row = first(top - margin, rows); row <= last(bottom + margin, rows); ++row) {
    // Where along the row all coordinates are large enough.
    double low = left - margin, high = right + margin;
    const auto start = plane.At(0, row + 0.5);
    for (int k = 0; k < 3; ++k) {
      const double slope = plane.AlongX(k), bound = (least[k] - start[k]) / slope;
      if (slope > 0) {
        low = std::max(low, bound);
      } else if (slope < 0) {
        high = std::min(high, bound);
      } else if (start[k] < least[k]) {
        low = high + 1;
      }
    }
    for (int column = first(low, columns); column <= last(high, columns); ++column)
      body(row, column, plane.At(column + 0.5, row + 0.5));
  }
}

// A mesh as one view sees it: pixels of vertices and their inverse depths, which are linear in the
// pixels; triangles with a vertex without a pixel (NaN) are not drawn.
struct SeenMesh {
  const double* pixels;    // (V, 2)
  const double* inverses;  // (V,)
  const int32_t* faces;    // (F, 3)
  int64_t num_faces;

  bool Corners(int64_t face, std::array<Corner, 3>& at, std::array<double, 3>& inverse) const {
    for (int k = 0; k < 3; ++k) {
      const int64_t vertex = faces[3 * face + k];
      at[k] = {pixels[2 * vertex], pixels[2 * vertex + 1]}, inverse[k] = inverses[vertex];
      if (!std::isfinite(at[k].x + at[k].y) || !(inverse[k] > 0)) return false;
    }
    return true;
  }
};

inline double Mixed(const std::array<double, 3>& weights, const std::array<double, 3>& values) {
  return weights[0] * values[0] + weights[1] * values[1] + weights[2] * values[2];
}

// The largest inverse depth of all triangles at each pixel; 0 where there is none.
inline void DrawDepths(const SeenMesh& mesh, int rows, int columns, float* nearest) {
  std::fill(nearest, nearest + size_t(rows) * columns, 0.f);
  std::array<Corner, 3> at;
  std::array<double, 3> inverse;
  for (int64_t face = 0; face < mesh.num_faces; ++face) {
    if (!mesh.Corners(face, at, inverse)) continue;
    ForPixels(at, rows, columns, 0, [&](int row, int column, const auto& weights) {
      float& there = nearest[size_t(row) * columns + column];
      there = std::max(there, float(Mixed(weights, inverse)));
    });
  }
}

// What a view sees of each triangle: its area in pixels, the shares of it that nothing hides and
// that nothing around it hides, and means of the channels of the picture over it. A pixel is hidden
// by what is nearer by more than `tolerance` of its depth and the triangle's own slope.
struct Tally {
  static constexpr int kChannels = 4;
  std::vector<float> areas, shares, means;
  explicit Tally(int64_t count) : areas(count), shares(2 * count), means(kChannels * count) {}
};

// `nearest` holds the largest inverse depth at each pixel, `around` that within `reach` pixels.
struct ViewPicture {
  int rows, columns;
  const float *nearest, *around;
  const float* channels;  // (rows, columns, kChannels)
  const uint8_t* usable;  // (rows, columns) whether a pixel shows the scene
  double tolerance, reach;
};

inline Tally TallyOf(const SeenMesh& mesh, const ViewPicture& view) {
  Tally tally(mesh.num_faces);
  std::array<Corner, 3> at;
  std::array<double, 3> inverse;
  for (int64_t face = 0; face < mesh.num_faces; ++face) {
    if (!mesh.Corners(face, at, inverse)) continue;
    const auto in = [&](const Corner& c) {
      return c.x >= 0.5 && c.y >= 0.5 && c.x <= view.columns - 0.5 && c.y <= view.rows - 0.5;
    };
    if (!in(at[0]) || !in(at[1]) || !in(at[2])) continue;
    const Plane2D plane(at);
    double slope = 0;  // change of the inverse depth from a pixel to the next, at most
    for (int k = 0; k < 3; ++k)
      slope += std::abs(inverse[k] - inverse[(k + 1) % 3]) * plane.Change(k, 1);
    int64_t count = 0, seen = 0, clear = 0;
    std::array<double, Tally::kChannels> sums{};
    const auto visit = [&](int row, int column, double own) {
      const size_t place = size_t(row) * view.columns + column;
      const double limit = own * (1 + view.tolerance) + slope;
      ++count;
      seen += view.usable[place] && view.nearest[place] <= limit;
      clear += view.usable[place] && view.around[place] <= limit + slope * view.reach;
      for (int c = 0; c < Tally::kChannels; ++c)
        sums[c] += view.channels[Tally::kChannels * place + c];
    };
    ForPixels(at, view.rows, view.columns, 0, [&](int row, int column, const auto& weights) {
      visit(row, column, Mixed(weights, inverse));
    });
    if (!count) {
      const double x = (at[0].x + at[1].x + at[2].x) / 3, y = (at[0].y + at[1].y + at[2].y) / 3;
      visit(int(y), int(x), (inverse[0] + inverse[1] + inverse[2]) / 3);
    }
    tally.areas[face] = float(plane.area());
    tally.shares[2 * face] = float(seen) / float(count);
    tally.shares[2 * face + 1] = float(clear) / float(count);
    for (int c = 0; c < Tally::kChannels; ++c)
      tally.means[Tally::kChannels * face + c] = float(sums[c] / double(count));
  }
  return tally;
}

// Adds colours to a picture (rows, columns, 3): those of the triangles' corners, linearly between
// them. Then extends each triangle by `margin` pixels where there is none.
inline void AddColors(const double* corners, const float* colors, int64_t num_faces, int rows,
                      int columns, double margin, uint8_t* picture, uint8_t* covered) {
  const auto paint = [&](int64_t face, double width, uint8_t mark) {
    std::array<Corner, 3> at;
    for (int k = 0; k < 3; ++k) at[k] = {corners[6 * face + 2 * k], corners[6 * face + 2 * k + 1]};
    ForPixels(at, rows, columns, width, [&](int row, int column, std::array<double, 3> weights) {
      const size_t place = size_t(row) * columns + column;
      if (covered[place]) return;
      covered[place] = mark;
      for (double& weight : weights) weight = std::clamp(weight, 0.0, 1.0);
      const double sum = weights[0] + weights[1] + weights[2];
      for (int c = 0; c < 3; ++c) {
        double value = picture[3 * place + c];
        for (int k = 0; k < 3; ++k) value += weights[k] / sum * colors[9 * face + 3 * k + c];
        picture[3 * place + c] = uint8_t(std::clamp(std::lround(value), 0L, 255L));
      }
    });
  };
  for (int64_t face = 0; face < num_faces; ++face) paint(face, 0, 1);
  for (int64_t face = 0; face < num_faces; ++face) paint(face, margin, 2);
}

}  // namespace colmap_edges
