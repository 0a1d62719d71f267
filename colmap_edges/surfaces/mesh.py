"""A triangle mesh with the point3D ids and colours of its vertices."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from colmap_edges.core.arrays import BoolArray, ByteArray, FloatArray, Int32Array, IntArray, Picture
from colmap_edges.core.checks import check_arrays, check_points, check_values
from colmap_edges.errors import check_type
from colmap_edges.images.files import decode

if TYPE_CHECKING:
    from colmap_edges.colmap.model import Model


@dataclass(frozen=True, kw_only=True)
class Texture:
    """A picture on a mesh.

    Attributes:
        jpeg: the picture as JPEG, as files hold it.
        points: (N, 2) float64 places in the picture, from 0 at its left and upper border to 1.
        corners: (F, 3) int32 indices into `points`, of the corners of the mesh's triangles.
    """

    jpeg: bytes
    points: Annotated[FloatArray, "N", 2]
    corners: Annotated[Int32Array, "F", 3]

    @cached_property
    def picture(self) -> Picture:
        """(H, W, 3) uint8 RGB."""
        return np.ascontiguousarray(
            decode(np.frombuffer(self.jpeg, np.uint8), Path("texture.jpg"))[:, :, ::-1]
        )

    def joined(self, faces: Int32Array) -> tuple[IntArray, IntArray, Int32Array]:
        """Pairs of a vertex and a point that triangles (F, 3) have at their corners.

        Returns:
            (M,) vertices and (M,) points of the pairs, and (F, 3) indices of the pairs.
        """
        keys = faces.astype(np.int64) * len(self.points) + self.corners
        pairs, corners = np.unique(keys, return_inverse=True)
        vertices, points = np.divmod(pairs, len(self.points))
        return vertices, points, corners.reshape(-1, 3).astype(np.int32)

    def colors(self) -> ByteArray:
        """(N, 3) uint8 colours of the picture at its points."""
        height, width = self.picture.shape[:2]
        places = np.clip(self.points * [width, height], 0, np.array([width, height]) - 1)
        columns, rows = places.astype(np.int64).T
        return np.asarray(self.picture[rows, columns])


@dataclass(frozen=True, kw_only=True)
class Mesh:
    """A triangle mesh with the 3D points of its vertices.

    Attributes:
        vertices: (V, 3) float64, world units.
        faces: (F, 3) int32 indices into `vertices`, counter-clockwise seen from free space.
        point3D_ids: (V,) int64; -1 for edge points and for vertices added by the mesher.
        colors: (V, 3) uint8.
        creases: (C, 2) int32 pairs of vertices: edges of the mesh that lie on 3D edges.
        stats: numbers of inputs, kept and dropped items, and seconds per step.
        texture: its texture, or None.
    """

    vertices: Annotated[FloatArray, "V", 3]
    faces: Annotated[Int32Array, "F", 3]
    point3D_ids: Annotated[IntArray, "V"]
    colors: Annotated[ByteArray, "V", 3]
    creases: Annotated[Int32Array, "C", 2] = field(
        default_factory=lambda: np.zeros((0, 2), np.int32)
    )
    stats: Mapping[str, float] = field(default_factory=dict)
    texture: Texture | None = None

    def __repr__(self) -> str:
        """The numbers of triangles and vertices, in one line."""
        return f"<Mesh: {len(self.faces):,} triangles, {len(self.vertices):,} vertices>"

    def rebuilt(
        self,
        vertices: FloatArray,
        sources: Int32Array,
        faces: Int32Array,
        creases: Int32Array,
        **stats: float,
    ) -> Mesh:
        """The mesh of other vertices, with the (V', 1) vertices of this one that they were.

        New vertices, whose source is -1, have the id -1 and colour 0.
        """
        rows = sources[:, 0]
        return replace(
            self,
            vertices=vertices,
            faces=faces,
            creases=creases,
            point3D_ids=np.where(rows >= 0, self.point3D_ids[rows], -1),
            colors=np.where(rows[:, None] >= 0, self.colors[rows], np.uint8(0)),
            stats={**self.stats, **stats},
        )

    def check(self, name: str = "mesh") -> None:
        """Check shapes, dtypes and values, as all functions of the Python interface do.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_arrays(name, self)
        check_points(f"{name}.vertices", self.vertices)
        check_values(f"{name}.faces", self.faces, 0, len(self.vertices) - 1)
        check_values(f"{name}.creases", self.creases, 0, len(self.vertices) - 1)
        if self.texture is not None:
            texture = self.texture
            check_type(f"{name}.texture.jpeg", texture.jpeg, (bytes,))
            check_arrays(f"{name}.texture", texture, F=len(self.faces))
            check_values(f"{name}.texture.corners", texture.corners, 0, len(texture.points) - 1)


def with_model_attributes(mesh_of_indices: Mesh, model: Model) -> Mesh:
    """Replace the point indices in `point3D_ids` by the model's ids, and add colours.

    Vertices that have a colour keep it.
    """
    sources = mesh_of_indices.point3D_ids
    is_sfm = (sources >= 0) & (sources < len(model.point3D_ids))
    ids = np.full(len(sources), -1, np.int64)
    ids[is_sfm] = model.point3D_ids[sources[is_sfm]]
    colors = mesh_of_indices.colors.copy()
    colors[is_sfm] = model.points3D_rgb[sources[is_sfm]]
    colors = spread_colors(colors, is_sfm | colors.any(axis=1), mesh_of_indices.faces)
    return replace(mesh_of_indices, point3D_ids=ids, colors=colors)


def spread_colors(colors: ByteArray, is_known: BoolArray, faces: Int32Array) -> ByteArray:
    """Assign to vertices of unknown colour the mean of their known neighbours, ring by ring.

    Args:
        colors: (V, 3) uint8.
        is_known: (V,) whether a vertex's colour is known.
        faces: (F, 3) triangles.

    Returns:
        (V, 3) uint8; vertices not connected to a known vertex keep their colours.
    """
    values, known = colors.astype(np.float64), is_known.copy()
    # Edges of unknown vertices only, as single numbers, which sort much faster than pairs.
    corners = faces.T.astype(np.int64)
    keys = [
        starts[~known[starts]] * len(known) + ends[~known[starts]]
        for starts, ends in ((corners, np.roll(corners, step, axis=0)) for step in (-1, 1))
    ]
    sides = np.column_stack(np.divmod(np.unique(np.concatenate(keys)), max(len(known), 1)))
    while True:
        useful = sides[~known[sides[:, 0]] & known[sides[:, 1]]]
        if not len(useful):
            return np.rint(values).astype(np.uint8)
        counts = np.bincount(useful[:, 0], minlength=len(values))
        for channel in range(3):
            weights = values[useful[:, 1], channel]
            sums = np.bincount(useful[:, 0], weights, minlength=len(values))
            values[counts > 0, channel] = sums[counts > 0] / counts[counts > 0]
        known |= counts > 0
