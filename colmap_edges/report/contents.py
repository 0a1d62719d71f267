"""The contents of a report, and arrays in the form read by the page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.report.packing import coordinates
from colmap_edges.surfaces.faces.outlines import Face
from colmap_edges.surfaces.mesh import Mesh

# Data of the page as JSON, with arrays that are packed.
Packed = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class ImagePicture:
    """The picture of one view.

    Attributes:
        view: index of the view.
        photo: the reduced image, JPEG.
        detected: its 2D edge graph, transparent PNG of the same size; empty if it has no lines.
        dropped: detected edges that are not in the graph, or None.
        shape: height and width, pixels.
    """

    view: int
    photo: bytes
    detected: bytes
    dropped: bytes | None
    shape: tuple[int, int]

    @property
    def num_bytes(self) -> int:
        """Bytes of the picture and its layers."""
        return len(self.photo) + len(self.detected) + len(self.dropped or b"")


@dataclass(frozen=True, kw_only=True)
class Contents:
    """The results of a run.

    Attributes:
        model: the input model.
        pictures: of the images, where edges were detected.
        edges: the 3D edges, where they were traced.
        curves: the curves that they consist of.
        mesh: the mesh, where one was made.
        faces: the planar faces, or empty.
        up: (3,) unit upward direction of the scene.
    """

    model: Model
    pictures: Sequence[ImagePicture] = ()
    edges: Edges3D | None = None
    curves: Curves3D | None = None
    mesh: Mesh | None = None
    faces: Sequence[Face] = ()
    up: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))


def xyz(points: FloatArray) -> Packed:
    """The coordinates (N, 3) of a layer."""
    return {axis: coordinates(points[:, i]) for i, axis in enumerate("xyz")}


def evenly_spread(count: int, most: int) -> IntArray:
    """Up to `most` of the indices 0..count-1, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
