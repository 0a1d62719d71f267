"""Vertices of a mesh move along their normals to where patches measured the surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import LinearOperator, cg

from colmap_edges.core.arrays import BoolArray, FloatArray, offsets_of
from colmap_edges.core.polylines import unit
from colmap_edges.core.view import View, views_with_rows
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.surfaces.extension import load_extension
from colmap_edges.surfaces.information import COLUMNS, MIN_COSINE, ROWS
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.surfaces.patches.depths import Depths

# Standard deviations of vertices over those of their tracks, for what tracks do not tell, such as
# rounded edges; 1 leaves half of the gain, 10 makes planes of exact points rough.
VERTEX_FACTOR = 3.0
MAX_SIGMAS = 8.0  # of a depth from the mesh; beyond, it is of another surface
FREEDOM = 8.0  # degrees of freedom of Student's t distribution of depths
NUM_ROUNDS = 3  # of weights


class Differences(NamedTuple):
    """What depths tell of offsets of vertices along their normals.

    Attributes:
        changes: (D, V) sparse change of the mesh's depth by each offset, three in a row.
        depths: (D,) depths, less those of the mesh.
        sigmas: (D,) their standard deviations.
    """

    changes: csr_matrix
    depths: FloatArray
    sigmas: FloatArray


def fitted(
    mesh: Mesh, information: FloatArray, views: Sequence[View], depths: Depths, num_threads: int
) -> Mesh:
    """A mesh with its vertices moved along their normals to where patches measured the surface.

    Minimises, over the offsets, the costs of the differences of depths between patches and mesh,
    in their deviations, and the squares of the offsets in deviations of the vertices. Vertices
    where sheets of the surface touch stay, and no face turns over or passes through another one.

    Args:
        mesh: a mesh.
        information: (V, 6) information of its vertices.
        views: the views.
        depths: depths that these measured.
        num_threads: threads to use; the result does not depend on it.
    """
    normals = normals_of_vertices(mesh)
    precisions = along(information, normals) / VERTEX_FACTOR**2
    differences = differences_of(mesh, normals, views, depths, num_threads)
    if not len(differences.depths) or not precisions.any():
        return mesh
    precisions = np.maximum(precisions, 1e-9 * float(precisions.max()))
    offsets = np.where(are_repeated(mesh.vertices), 0.0, best_offsets(differences, precisions))
    moved = mesh.vertices + offsets[:, None] * normals
    vertices = load_extension().taken_back(mesh.vertices, moved, mesh.faces, num_threads)
    return replace(
        mesh, vertices=vertices, stats={**mesh.stats, "depths_fitted": len(differences.depths)}
    )


def are_repeated(points: FloatArray) -> BoolArray:
    """(N,) whether (N, 3) points are there more than once."""
    order = np.lexsort(points.T)  # sorts ten times as fast as `np.unique` of rows
    same = np.concatenate([[False], (np.diff(points[order], axis=0) == 0).all(axis=1), [False]])
    repeated = np.zeros(len(points), bool)
    repeated[order] = same[1:] | same[:-1]
    return repeated


def best_offsets(differences: Differences, precisions: FloatArray) -> FloatArray:
    """(V,) offsets of least cost, of vertices with (V,) inverse variances.

    By Student's t distribution, with weights that are computed anew in each round.
    """
    changes, wanted, sigmas = differences
    backward, squares = changes.T, changes.data**2
    offsets = np.zeros(len(precisions))
    for _ in range(NUM_ROUNDS):
        errors = (wanted - changes @ offsets) / sigmas
        weights = 1 / (1 + errors**2 / FREEDOM) / sigmas**2
        own = np.bincount(changes.indices, squares * np.repeat(weights, 3), len(offsets))
        diagonal = precisions + own

        def normal_matrix(x: FloatArray, weights: FloatArray = weights) -> FloatArray:
            product: FloatArray = precisions * x + backward @ (weights * (changes @ x))
            return product

        def scaled(x: FloatArray, diagonal: FloatArray = diagonal) -> FloatArray:
            return x / diagonal

        shape = (len(offsets), len(offsets))
        offsets, _ = cg(
            LinearOperator(shape, normal_matrix, dtype=np.float64),
            backward @ (weights * wanted),
            x0=offsets,
            rtol=1e-2,  # within 5 steps
            M=LinearOperator(shape, scaled, dtype=np.float64),
        )
    return offsets


def differences_of(
    mesh: Mesh, normals: FloatArray, views: Sequence[View], depths: Depths, num_threads: int
) -> Differences:
    """The differences between depths and the mesh, where they are of the same surface.

    Args:
        mesh: the mesh.
        normals: (V, 3) of its vertices.
        views: the views.
        depths: depths that these measured.
        num_threads: threads.
    """
    inverse, faces = _kernels.mesh_depths(
        np.array([view.rotation for view in views]).reshape(-1, 3, 3),
        np.array([view.translation for view in views]).reshape(-1, 3),
        np.ascontiguousarray(mesh.vertices, np.float64),
        np.ascontiguousarray(mesh.faces, np.int32),
        offsets_of(np.bincount(depths.views, minlength=len(views))),
        np.ascontiguousarray(depths.rays),
        num_threads,
    )
    with np.errstate(divide="ignore"):
        wanted = depths.depths - 1 / inverse
    rows = np.flatnonzero(np.abs(wanted) <= MAX_SIGMAS * depths.sigmas)
    wanted, sigmas, faces = wanted[rows], depths.sigmas[rows], faces[rows]
    rays, hits = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
    for view, own in views_with_rows(views, depths.views[rows]):
        local = np.column_stack([depths.rays[rows[own]], np.ones(len(own))])
        rays[own] = local @ view.rotation
        hits[own] = view.center + rays[own] / inverse[rows[own], None]
    corners = mesh.vertices[mesh.faces[faces]]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Areas opposite the corners.
    shares = np.stack(
        [
            dots(np.cross(corners[:, k - 2] - hits, corners[:, k - 1] - hits), across)
            for k in range(3)
        ],
        axis=1,
    )
    # Of needles without an area, rounding leaves any shares.
    shares = np.clip(shares / np.maximum(shares.sum(axis=1), 1e-300)[:, None], 0, 1)
    lengths = np.linalg.norm(rays, axis=1)
    across = unit(across)
    cosines = dots(across, rays)
    cosines = np.copysign(np.maximum(np.abs(cosines), MIN_COSINE * lengths), cosines)
    ends = mesh.faces[faces]
    changes = shares * np.einsum("nki,ni->nk", normals[ends], across) / cosines[:, None]
    starts = np.arange(len(rows) + 1) * 3
    matrix = csr_matrix(
        (changes.ravel(), ends.ravel(), starts), shape=(len(rows), len(mesh.vertices))
    )
    return Differences(matrix, wanted, sigmas)


def normals_of_vertices(mesh: Mesh) -> FloatArray:
    """(V, 3) unit normals, means over faces weighted by their angles; 0 without faces."""
    corners = mesh.vertices[mesh.faces]
    normals = unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    sums = np.zeros_like(mesh.vertices)
    for k in range(3):
        one, other = (unit(corners[:, k - i] - corners[:, k]) for i in (1, 2))
        angles = np.arccos(np.clip(dots(one, other), -1, 1))
        for axis in range(3):
            sums[:, axis] += np.bincount(
                mesh.faces[:, k], angles * normals[:, axis], len(mesh.vertices)
            )
    return unit(sums)


def along(information: FloatArray, normals: FloatArray) -> FloatArray:
    """(V,) inverse variances along (V, 3) normals, of (V, 6) information."""
    full = np.zeros((len(information), 3, 3))
    full[:, ROWS, COLUMNS] = full[:, COLUMNS, ROWS] = information
    return np.asarray(np.einsum("vi,vij,vj->v", normals, full, normals))


def dots(a: FloatArray, b: FloatArray) -> FloatArray:
    """(N,) dot products of (N, 3) vectors."""
    return np.asarray(np.einsum("ni,ni->n", a, b))
