// SPDX-License-Identifier: GPL-3.0-or-later
// Moves the vertices of a mesh within the noise of their measurements, until faces are smooth.
#pragma once

#include <array>
#include <vector>

#include "types.h"

namespace mesher {

// The elements xx, xy, xz, yy, yz, zz of a symmetric matrix.
using Symmetric = std::array<double, 6>;

struct RefinementInput {
  std::vector<Vec3> vertices;  // as measured
  std::vector<std::array<Index, 3>> faces;
  // Edges of the mesh across which nothing is smoothed, as pairs of vertices.
  std::vector<std::array<Index, 2>> creases;
  std::vector<Symmetric> information;  // inverse covariance of each vertex; 0 for one that stays
};

// Throws std::invalid_argument for faces or creases that do not fit the vertices.
void CheckFaces(const std::vector<std::array<Index, 3>>& faces,
                const std::vector<std::array<Index, 2>>& creases, std::size_t num_vertices);

// Throws std::invalid_argument for faces, creases or information that do not fit the vertices.
void CheckInput(const RefinementInput& input);

struct Smoothness {
  double strength;  // weight of the smoothness of normals
  double angle;     // between faces, in radians, up to which they are smoothed, besides by noise
};

// Minimises by turns, over positions x of vertices and unit normals n of faces,
//
//   sum over vertices of   rho((x - m)^T I (x - m))        measured at m with the information I
// + sum over corners of    w (n . (x - centre of face))^2  planes of faces
// + sum over faces of      c |n - normal of the face|^2    normals of faces
// + sum over neighbours of strength c c' s(|n - n'|^2)     smoothness, but not across creases
//
// docs/meshing.md explains the terms. Borders, and vertices where sheets of the surface touch,
// stay. `num_rounds` is the number of turns.
class Refiner {
 public:
  // Throws std::invalid_argument for faces, creases or information that do not fit the vertices.
  Refiner(RefinementInput input, int num_threads);

  // The refined positions. No triangle turns over or passes through another one.
  std::vector<Vec3> Refine(Smoothness smoothness, int num_rounds) const;

  // Squared errors, in variances, with which the surface predicts the positions of vertices, if
  // it is refined without their measurements. No two of them may share a face. -1 for those that
  // stay, and those whose neighbours span no plane.
  std::vector<double> HeldOutErrors(const std::vector<Index>& held_out, Smoothness smoothness,
                                    int num_rounds) const;

 private:
  struct Face;  // a face in a round

  std::vector<Vec3> Minimise(const RefinementInput& input, std::vector<Vec3> x,
                             Smoothness smoothness, int num_rounds) const;
  std::vector<Face> MeasuredFaces(const std::vector<Vec3>& x) const;
  void SmoothNormals(Smoothness smoothness, std::vector<Face>& faces) const;
  void MoveVertices(const RefinementInput& input, const std::vector<Face>& faces,
                    std::vector<Vec3>& x) const;
  template <typename Body>
  void Each(std::size_t count, const Body& body) const;

  RefinementInput input_;
  int num_threads_;
  std::vector<std::array<Index, 3>> across_;  // per face and side: the face across, or kNone
  Rows faces_of_;                             // vertex -> faces
  std::vector<Symmetric> covariances_;        // of the vertices; 0 for those that stay
  double typical_ = 0;                        // median of the mean information of a vertex
};

}  // namespace mesher
