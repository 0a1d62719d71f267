"""Refinement of a mesh within its noise: vertices move until faces are smooth, needles vanish."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View
from colmap_edges.surfaces.extension import load_extension
from colmap_edges.surfaces.information import Tracks, information_of, isotropic, mean_of
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.surfaces.shaping import shaped

# What is tried: the weight of smoothness, and the angle between neighbouring faces, in radians, up
# to which they are smoothed, besides by noise. The first keeps relief, the last is for plain walls.
SMOOTHNESS = ((16.0, 0.02), (4.0, 0.1), (16.0, 0.1))
# Turns between normals and vertices: when smoothness is learned, and of the refinement.
TRIAL_ROUNDS, ROUNDS = 4, 6
HELD_OUT_SHARE = 0.1  # of the vertices, which others predict
MIN_HELD_OUT = 30  # fewer predictions tell nothing
# Standard deviation of points of planar faces relative to that of the measured point next to them,
# since many points determine a plane.
FACE_SIGMA = 0.1


class Measured:
    """The information of all points that a mesh may be made of, in their order.

    SfM points, points of edges, of contours and of patches, and then points without a measurement.
    """

    def __init__(
        self,
        views: Sequence[View],
        sfm: Tracks,
        edges: Edges3D | None,
        contours: Edges3D | None,
        patch_sigmas: FloatArray,
    ) -> None:
        """Compute the information of measured points; that of patches by (P,) deviations."""
        parts = [information_of(views, sfm)] if len(sfm.points) else []
        if edges is not None:
            parts.append(information_of(views, Tracks.of_edges(edges)))
        self.num_certain = sum(map(len, parts))
        if contours is not None:
            # A contour moves over the body from view to view: no direction is better known.
            found = information_of(views, Tracks.of_edges(contours))
            parts.append(isotropic(mean_of(found)))
        parts.append(isotropic(1 / patch_sigmas**2))
        self.information = np.concatenate([*parts, np.zeros((0, 6))])

    def of_vertices(self, mesh: Mesh) -> tuple[FloatArray, BoolArray]:
        """(V, 6) information of the vertices of a mesh of point indices, (V,) which hold-outs are.

        Vertices without a measurement have that of the next measured vertex: those added by the
        mesher with its deviation, those of faces, which come after the measured points, with
        `FACE_SIGMA` times its deviation.
        """
        sources, last = mesh.point3D_ids, len(self.information)
        information = np.zeros((len(sources), 6))
        measured = (sources >= 0) & (sources < last)
        information[measured] = self.information[sources[measured]]
        measured &= mean_of(information) > 0
        if not measured.any():
            return information, measured
        nearest = cKDTree(mesh.vertices[measured]).query(mesh.vertices[~measured])[1]
        means = mean_of(information[measured])[nearest]
        means[sources[~measured] >= last] /= FACE_SIGMA**2
        information[~measured] = isotropic(means)
        return information, measured & (sources < self.num_certain)


def refined(mesh: Mesh, measured: Measured, num_threads: int) -> Mesh:
    """A mesh with smooth faces between edges and well-shaped triangles, within its noise.

    Args:
        mesh: a mesh whose `point3D_ids` are indices of points.
        measured: the information of these points.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The refined mesh; the given one if none of its vertices was measured.
    """
    information, certain = measured.of_vertices(mesh)
    if not information.any():
        return mesh
    return shaped(smoothed(mesh, information, certain, num_threads), information, num_threads)


def smoothed(mesh: Mesh, information: FloatArray, certain: BoolArray, num_threads: int) -> Mesh:
    """A mesh with its vertices moved within their noise, so that faces between edges are smooth.

    How smooth is learned: a tenth of the vertices is predicted from the others with each of
    `SMOOTHNESS`, and the one that predicts best is taken.

    Args:
        mesh: a mesh.
        information: (V, 6) information of its vertices.
        certain: (V,) which vertices may be predicted.
        num_threads: threads to use; the result does not depend on it.

    Returns:
        The mesh; the given one if it has too few measured vertices to learn from.
    """
    held_out = chosen_apart(certain, mesh.faces)
    if len(held_out) < MIN_HELD_OUT:
        return mesh
    refiner = load_extension().Refiner(
        mesh.vertices, mesh.faces, mesh.creases, information, num_threads
    )
    costs = [
        cost_of(refiner.held_out_errors(held_out, *smoothness, TRIAL_ROUNDS)[:, 0])
        for smoothness in SMOOTHNESS
    ]
    strength, angle = SMOOTHNESS[int(np.argmin(costs))]
    vertices = refiner.refine(strength, angle, ROUNDS)
    moved = int((vertices != mesh.vertices).any(axis=1).sum())
    stats = {"smooth_strength": strength, "smooth_angle_rad": angle, "vertices_moved": moved}
    return replace(mesh, vertices=vertices, stats={**mesh.stats, **stats})


def chosen_apart(candidates: BoolArray, faces: Int32Array) -> Int32Array:
    """Indices of about a tenth of the candidates (V,) of which no two share one of (F, 3) faces."""
    # Multiples of the golden ratio spread evenly, without a random number.
    order = np.arange(len(candidates)) * 0.6180339887498949 % 1
    chosen = candidates & (order < HELD_OUT_SHARE)
    sides: IntArray = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    both = sides[chosen[sides].all(axis=1)]
    chosen[np.where(order[both[:, 0]] < order[both[:, 1]], both[:, 1], both[:, 0])] = False
    return np.flatnonzero(chosen).astype(np.int32)


def cost_of(errors: FloatArray) -> float:
    """Mean cost of (H,) squared errors in variances, negative where there is no prediction.

    They count by their logarithm, as of a heavy-tailed distribution.
    """
    return float(np.log1p(np.maximum(errors, 0)).mean())
