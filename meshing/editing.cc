// SPDX-License-Identifier: GPL-3.0-or-later
#include "editing.h"

#include <algorithm>

#include "intersections.h"

namespace mesher {

Vec3 ClosestOnSegment(const Vec3& p, const Vec3& a, const Vec3& b) {
  const Vec3 side = b - a;
  const double square = Dot(side, side);
  return a + (square > 0 ? std::clamp(Dot(p - a, side) / square, 0.0, 1.0) : 0) * side;
}

Editor::Editor(const std::vector<Vec3>& vertices, const std::vector<Face>& faces,
               const std::vector<std::array<Index, 2>>& creases, bool ends_move, int num_threads)
    : num_threads_(num_threads),
      vertices_(vertices),
      stays_(vertices.size()),
      faces_of_(vertices.size()),
      lines_of_(vertices.size()),
      faces_(faces),
      is_alive_(faces.size(), 1),
      ends_move_(ends_move),
      num_given_(vertices.size()) {
  CheckFaces(faces_, creases, vertices_.size());
  const auto first = FirstAtPlace(vertices_);
  for (std::size_t v = 0; v < first.size(); ++v)
    if (first[v] != static_cast<Index>(v)) stays_[v] = stays_[first[v]] = 1;
  for (std::size_t f = 0; f < faces_.size(); ++f)
    for (const Index v : faces_[f]) faces_of_[v].push_back(static_cast<Index>(f));
  for (const auto& [a, b] : creases) AddLine(a, b, true);
  for (const Face& face : faces_)
    for (int k = 0; k < 3; ++k) {
      const Index a = face[k], b = face[(k + 1) % 3];
      const auto count = std::count_if(faces_of_[a].begin(), faces_of_[a].end(),
                                       [&](Index f) { return Has(faces_[f], b); });
      if (count == 1) AddLine(a, b, false);
      if (count > 2) stays_[a] = stays_[b] = 1;
    }
}

Corners Editor::CornersOf(const Face& f, const Change& change) const {
  Corners corners;
  for (int k = 0; k < 3; ++k) corners[k] = f[k] == kAdded ? change.added : At(f[k]);
  return corners;
}

void Editor::AddLine(Index a, Index b, bool is_crease) {
  if (!lines_.emplace(Key(a, b), Line{is_crease, {}}).second) return;
  lines_of_[a].push_back(b);
  lines_of_[b].push_back(a);
}

// The face of which corner b follows corner a, or kNone.
Index Editor::FaceWithSide(Index a, Index b) const {
  if (a == kAdded || b == kAdded) return kNone;
  const auto& around = faces_of_[a].size() < faces_of_[b].size() ? faces_of_[a] : faces_of_[b];
  for (const Index f : around)
    for (int k = 0; k < 3; ++k)
      if (faces_[f][k] == a && faces_[f][(k + 1) % 3] == b) return f;
  return kNone;
}

// Whether a vertex can move along its line, if it is on one, and no line ends or branches there.
bool Editor::CanCollapse(Index from, Index to) const {
  if (stays_[from]) return false;
  const auto& ends = lines_of_[from];
  if (ends.empty()) return true;
  if (!IsLine(from, to)) return false;
  if (ends.size() == 1) return ends_move_;
  if (ends.size() != 2) return false;
  return !IsLine(ends[0], ends[1]) &&
         lines_.at(Key(from, ends[0])).is_crease == lines_.at(Key(from, ends[1])).is_crease;
}

// Whether the common neighbours of two vertices are the corners of the faces between them, and no
// new face would be the back of another one.
bool Editor::KeepsTopology(Index from, Index to) const {
  thread_local std::vector<Index> around, common;
  around.clear(), common.clear();
  std::size_t num_shared = 0;
  for (const Index f : faces_of_[from]) {
    num_shared += Has(faces_[f], to);
    around.insert(around.end(), faces_[f].begin(), faces_[f].end());
  }
  SortUnique(around);
  for (const Index f : faces_of_[to])
    for (const Index v : faces_[f])
      if (v != from && v != to && std::binary_search(around.begin(), around.end(), v))
        common.push_back(v);
  SortUnique(common);
  const auto stays = [&](Index v) { return v != from && v != to && stays_[v]; };
  if (stays_[to] && std::any_of(around.begin(), around.end(), stays)) return false;
  if (num_shared == 0 || common.size() != num_shared) return false;
  for (const Index f : faces_of_[from])
    for (int k = 0; k < 3 && !Has(faces_[f], to); ++k) {
      const Index a = faces_[f][k], b = faces_[f][(k + 1) % 3];
      if (a == from || b == from) continue;
      const Index across = FaceWithSide(b, a);
      if (across != kNone && Has(faces_[across], to)) return false;
    }
  return true;
}

bool Editor::MakeCollapse(Index from, Index to, Change& change) const {
  if (!CanCollapse(from, to) || !KeepsTopology(from, to)) return false;
  change.removed = from;
  change.to = to;
  const auto& ends = lines_of_[from];
  change.is_on_line = !ends.empty();
  if (change.is_on_line) change.line = {ends[0], ends.size() > 1 ? ends[1] : kNone};
  for (const Index f : faces_of_[from]) {
    change.old_faces.push_back(f);
    Face face = faces_[f];
    if (Has(face, to)) continue;
    std::replace(face.begin(), face.end(), from, to);
    change.faces.push_back(face);
  }
  return !change.faces.empty();
}

void Editor::RemoveColliding(std::vector<Change>& changes) const {
  std::vector<Index> replaced_by(faces_.size(), kNone), groups, replaced;
  Faces3 new_faces, faces;
  for (std::size_t i = 0; i < changes.size(); ++i) {
    for (const Index f : changes[i].old_faces) replaced_by[f] = static_cast<Index>(i);
    new_faces.insert(new_faces.end(), changes[i].faces.begin(), changes[i].faces.end());
    groups.resize(new_faces.size(), static_cast<Index>(i));
  }
  for (std::size_t f = 0; f < faces_.size(); ++f)
    if (is_alive_[f]) {
      faces.push_back(faces_[f]);
      replaced.push_back(replaced_by[f]);
    }
  const auto collides = Collisions(new_faces, groups, faces, replaced, vertices_, num_threads_);
  std::vector<Change> kept;
  for (std::size_t i = 0; i < changes.size(); ++i)
    if (!collides[i]) kept.push_back(std::move(changes[i]));
  changes = std::move(kept);
}

// Replaces faces and lines, but not the vertices' places; returns where the new faces are.
std::vector<Index> Editor::Replace(const Change& change) {
  for (const Index f : change.old_faces) {
    for (const Index v : faces_[f]) {
      auto& around = faces_of_[v];
      around.erase(std::find(around.begin(), around.end(), f));
    }
    is_alive_[f] = 0;
  }
  std::vector<Index> places = change.old_faces;
  for (std::size_t i = places.size(); i < change.faces.size(); ++i) {
    places.push_back(static_cast<Index>(faces_.size()));
    faces_.emplace_back();
    is_alive_.emplace_back();
  }
  places.resize(change.faces.size());
  for (std::size_t i = 0; i < places.size(); ++i) {
    faces_[places[i]] = change.faces[i];
    is_alive_[places[i]] = 1;
    for (const Index v : change.faces[i]) faces_of_[v].push_back(places[i]);
  }
  if (change.is_on_line) RemoveFromLine(change);
  return places;
}

void Editor::RemoveFromLine(const Change& change) {
  const auto [a, b] = change.line;
  Line line{false, {change.removed}};
  for (const Index end : change.line) {
    if (end == kNone) continue;
    const auto old = lines_.find(Key(change.removed, end));
    line.is_crease = old->second.is_crease;
    line.points.insert(line.points.end(), old->second.points.begin(), old->second.points.end());
    lines_.erase(old);
    auto& ends = lines_of_[end];
    const auto place = std::find(ends.begin(), ends.end(), change.removed);
    if (b == kNone)
      ends.erase(place);
    else
      *place = end == a ? b : a;
  }
  lines_of_[change.removed].clear();
  if (b != kNone) {
    lines_.emplace(Key(a, b), std::move(line));
  } else if (!lines_of_[a].empty()) {
    auto& points = lines_.at(Key(a, lines_of_[a][0])).points;
    points.insert(points.end(), line.points.begin(), line.points.end());
  }
}

EditedMesh Editor::Result() const {
  EditedMesh result;
  std::vector<Index> ids(vertices_.size(), kNone);
  for (std::size_t v = 0; v < ids.size(); ++v) {
    if (faces_of_[v].empty()) continue;
    ids[v] = static_cast<Index>(result.vertices.size());
    result.vertices.push_back(vertices_[v]);
    result.sources.push_back(v < num_given_ ? static_cast<Index>(v) : kNone);
  }
  for (std::size_t f = 0; f < faces_.size(); ++f)
    if (is_alive_[f])
      result.faces.push_back({ids[faces_[f][0]], ids[faces_[f][1]], ids[faces_[f][2]]});
  for (std::size_t a = 0; a < lines_of_.size(); ++a)
    for (const Index b : lines_of_[a])
      if (static_cast<Index>(a) < b && ids[a] != kNone && ids[b] != kNone &&
          lines_.at(Key(static_cast<Index>(a), b)).is_crease)
        result.creases.push_back({ids[a], ids[b]});
  std::sort(result.creases.begin(), result.creases.end());
  return result;
}

}  // namespace mesher
