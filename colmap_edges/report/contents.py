"""What a report shows, and arrays in the form that the page reads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.report.packing import coordinates
from colmap_edges.surfaces.mesh import Mesh

# What a figure is to plotly.js: traces and layout as JSON, whose arrays are packed for the page.
Trace = dict[str, Any]


@dataclass(frozen=True, kw_only=True)
class ImagePicture:
    """The picture of one view.

    Attributes:
        view: index of the view.
        photo: the image made small, JPEG.
        detected: its 2D edge graph, transparent WebP of the same size.
        dropped: detected edges that are not in the graph; None when all are.
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
    """What a run made.

    Attributes:
        model: the input model.
        pictures: of the images, where edges were detected.
        edges: the 3D edges, where they were traced.
        mesh: the mesh, where one was made.
    """

    model: Model
    pictures: Sequence[ImagePicture] = ()
    edges: Edges3D | None = None
    mesh: Mesh | None = None


def xyz(points: FloatArray) -> Trace:
    """The coordinates (N, 3) of a trace."""
    return {axis: coordinates(points[:, i]) for i, axis in enumerate("xyz")}


def evenly_spread(count: int, most: int) -> IntArray:
    """Up to `most` of the indices 0..count-1, evenly spread."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))
