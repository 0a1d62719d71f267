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

// The vertices that minimise, over positions x and unit normals n of faces, by turns,
//
//   sum over vertices of  rho(x - m) with the information of the vertex (m: as measured)
// + sum over corners of   (n . (x - centre of the face))^2, in typical variances of a vertex
// + sum over faces of     c |n - normal of the face|^2
// + strength * sum over neighbouring faces of  c c' w(|n - n'|)
//
// docs/meshing.md explains the terms. Borders, and vertices where sheets of the surface touch, stay.
// `strengths` has one entry per vertex; `num_rounds` is the number of turns.
class Refiner {
 public:
  // Throws std::invalid_argument for faces, creases or information that do not fit the vertices.
  Refiner(RefinementInput input, int num_threads);

  // The refined positions. No triangle turns over or passes through another one.
  std::vector<Vec3> Refine(const std::vector<double>& strengths, int num_rounds) const;

  // Squared errors, in variances, with which the surface predicts the positions of vertices, if
  // it is refined without their measurements. No two of them may share a face. -1 for those that
  // stay, and those whose neighbours span no plane.
  std::vector<double> HeldOutErrors(const std::vector<Index>& held_out,
                                    const std::vector<double>& strengths, int num_rounds) const;

 private:
  struct Face;  // a face in a round

  std::vector<Vec3> Minimise(const RefinementInput& input, std::vector<Vec3> x,
                             const std::vector<double>& strengths, int num_rounds) const;
  std::vector<Face> MeasuredFaces(const std::vector<Vec3>& x) const;
  void SmoothNormals(const std::vector<double>& strengths, std::vector<Face>& faces) const;
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
