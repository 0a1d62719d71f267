// SPDX-License-Identifier: GPL-3.0-or-later
// A mesh of which some faces are replaced by others, with its creases and borders.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "refinement.h"

namespace mesher {

using Face = std::array<Index, 3>;
using Corners = std::array<Vec3, 3>;

struct EditedMesh {
  std::vector<Vec3> vertices;
  std::vector<Index> sources;                 // vertices of the input, or kNone for new ones
  std::vector<Face> faces;                    // of indices into `vertices`
  std::vector<std::array<Index, 2>> creases;  // pairs of indices into `vertices`
};

// A new vertex, before it has a number.
constexpr Index kAdded = -2;

// What replaces some faces by others.
struct Change {
  std::vector<Index> old_faces;
  std::vector<Face> faces;
  double gain = 0;        // decrease of the cost
  Index removed = kNone;  // a vertex that is left out, collapsed onto another one
  Index to = kNone;
  bool is_on_line = false;  // whether it is one of a crease or border,
  std::array<Index, 2>
      line{};  // and its neighbours there: a side between them replaces both pieces
  Vec3 added;  // the place of kAdded, and its information
  Symmetric information{};
};

inline double Quadratic(const Symmetric& a, const Vec3& d) {
  return d.x * (a[0] * d.x + 2 * (a[1] * d.y + a[2] * d.z)) + d.y * (a[3] * d.y + 2 * a[4] * d.z) +
         a[5] * d.z * d.z;
}

Vec3 ClosestOnSegment(const Vec3& p, const Vec3& a, const Vec3& b);

inline bool Has(const Face& face, Index v) { return face[0] == v || face[1] == v || face[2] == v; }

inline void SortUnique(std::vector<Index>& values) {
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
}

inline Vec3 Normal(const Corners& c) { return Cross(c[1] - c[0], c[2] - c[0]); }

inline std::uint64_t Key(Index a, Index b) {
  const auto low = static_cast<std::uint32_t>(a < b ? a : b);
  return static_cast<std::uint64_t>(low) << 32 | static_cast<std::uint32_t>(a < b ? b : a);
}

// Changes keep the topology and where creases branch; vertices where sheets of the surface touch
// stay.
class Editor {
 public:
  // Creases end where they did, unless `ends_move`: then they may become shorter.
  // Throws std::invalid_argument for faces or creases that do not fit the vertices.
  Editor(const std::vector<Vec3>& vertices, const std::vector<Face>& faces,
         const std::vector<std::array<Index, 2>>& creases, bool ends_move, int num_threads);
  EditedMesh Result() const;

 protected:
  // A piece of a crease or border, with the vertices of it that are left out.
  struct Line {
    bool is_crease;
    std::vector<Index> points;
  };

  const Vec3& At(Index v) const { return vertices_[v]; }
  Corners CornersOf(const Face& f) const { return {At(f[0]), At(f[1]), At(f[2])}; }
  Corners CornersOf(const Face& f, const Change& change) const;
  bool IsLine(Index a, Index b) const { return lines_.count(Key(a, b)) > 0; }
  Index FaceWithSide(Index a, Index b) const;
  bool CanCollapse(Index from, Index to) const;
  bool KeepsTopology(Index from, Index to) const;
  bool MakeCollapse(Index from, Index to, Change& change) const;
  void RemoveColliding(std::vector<Change>& changes) const;
  std::vector<Index> Replace(const Change& change);

  const int num_threads_;
  std::vector<Vec3> vertices_;
  std::vector<char> stays_;  // which vertices are neither left out nor connected with one another
  std::vector<std::vector<Index>> faces_of_, lines_of_;  // of vertices: faces, neighbours on lines
  std::unordered_map<std::uint64_t, Line> lines_;
  std::vector<Face> faces_;
  std::vector<char> is_alive_;  // which faces are not replaced

 private:
  void AddLine(Index a, Index b, bool is_crease);
  void RemoveFromLine(const Change& change);

  const bool ends_move_;
  const std::size_t num_given_;  // vertices
};

}  // namespace mesher
