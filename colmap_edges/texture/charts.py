"""Charts of an atlas: neighbouring triangles of one view, and plain colours of unseen triangles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import ByteArray, FloatArray, Int32Array, IntArray
from colmap_edges.core.groups import linked_groups
from colmap_edges.surfaces.mesh import Mesh, spread_colors
from colmap_edges.texture.gains import gained
from colmap_edges.texture.seen_faces import SeenFaces


@dataclass(frozen=True, kw_only=True)
class Charts:
    """The charts of a mesh and their points: vertices, once for each chart that has them.

    Attributes:
        owners: (F,) chart of each triangle; those of unseen triangles come last.
        views: (K,) view of each chart; -1 of plain colours.
        colors: (K, 3) colours of plain charts, BGR.
        corners: (F, 3) points of the triangles.
        vertices: (N,) vertex of each point.
        charts: (N,) chart of each point, in which it is once.
    """

    owners: IntArray
    views: IntArray
    colors: ByteArray
    corners: Int32Array
    vertices: IntArray
    charts: IntArray


def make_charts(
    mesh: Mesh, seen: SeenFaces, gains: FloatArray, chosen: IntArray, pairs: Int32Array
) -> Charts:
    """Join neighbouring triangles of one view.

    Args:
        mesh: the mesh.
        seen: pairs of triangles and views.
        gains: (V, 3) gains of the views.
        chosen: (F,) chosen pair of each triangle, or -1.
        pairs: (P, 2) neighbouring triangles.
    """
    is_seen = chosen >= 0
    views = np.full(len(chosen), -1)
    views[is_seen] = seen.views[chosen[is_seen]]
    joined = pairs[(views[pairs[:, 0]] == views[pairs[:, 1]]) & is_seen[pairs[:, 0]]]
    pieces = linked_groups(joined, len(views))
    _, first, of_seen = np.unique(pieces[is_seen], return_index=True, return_inverse=True)
    plain, of_unseen = plain_colors(mesh, seen, gains, chosen)
    owners = np.empty(len(views), np.int64)
    owners[is_seen], owners[~is_seen] = of_seen, len(first) + of_unseen
    num_charts = len(first) + len(plain)
    keys = mesh.faces.astype(np.int64) * max(num_charts, 1) + owners[:, None]
    points, corners = np.unique(keys, return_inverse=True)
    vertices, charts = np.divmod(points, max(num_charts, 1))
    return Charts(
        owners=owners,
        views=np.concatenate([views[is_seen][first], np.full(len(plain), -1)]),
        colors=np.concatenate([np.zeros((len(first), 3), np.uint8), plain]),
        corners=corners.reshape(-1, 3).astype(np.int32),
        vertices=vertices,
        charts=charts,
    )


def plain_colors(
    mesh: Mesh, seen: SeenFaces, gains: FloatArray, chosen: IntArray
) -> tuple[ByteArray, IntArray]:
    """(L, 3) colours of unseen triangles, BGR, and the colour of each unseen triangle.

    They are those of seen triangles nearby, or of the mesh's vertices where none is connected.
    """
    is_seen = chosen >= 0
    rows = chosen[is_seen]
    seen_colors = gained(seen.colors[rows], gains[seen.views[rows]])
    at = mesh.faces[is_seen].ravel()
    counts = np.bincount(at, minlength=len(mesh.vertices))
    colors = mesh.colors[:, ::-1].astype(float)
    for channel in range(3):
        sums = np.bincount(at, np.repeat(seen_colors[:, channel], 3), len(mesh.vertices))
        colors[counts > 0, channel] = sums[counts > 0] / counts[counts > 0]
    spread = spread_colors(np.clip(colors, 0, 255).astype(np.uint8), counts > 0, mesh.faces)
    means = spread[mesh.faces[~is_seen]].mean(axis=1).reshape(-1, 3)
    # Colours are rounded, so that many triangles share one.
    levels = np.minimum((means / 4).round() * 4, 255).astype(np.uint8)
    found, owners = np.unique(levels, axis=0, return_inverse=True)
    return found, owners.ravel()
