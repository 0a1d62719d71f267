"""A face of revolution that views show, as it is written and read."""

from __future__ import annotations

from dataclasses import dataclass, replace

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.similarity import Similarity

KINDS = ("cylinder", "cone", "sphere", "torus", "revolution")


@dataclass(frozen=True, kw_only=True)
class RoundFace:
    """A face of revolution: a profile that is turned around an axis.

    The profile of a cylinder or cone has two points, its ends. That of a sphere or torus has three
    points of an arc: its ends and one between them. That of any other face is a smooth curve.

    Attributes:
        kind: one of `KINDS`.
        point: (3,) point on the axis.
        direction: (3,) unit direction of the axis.
        profile: (n, 2) places along the axis from the point, and radii, world units.
        views: indices of the views that show outlines on both sides of it.
    """

    kind: str
    point: FloatArray
    direction: FloatArray
    profile: FloatArray
    views: IntArray


def moved_round(face: RoundFace, moved: Similarity) -> RoundFace:
    """A face of revolution in a new frame."""
    return replace(
        face,
        point=moved.points(face.point[None])[0],
        direction=moved.rotation @ face.direction,
        profile=moved.scale * face.profile,
    )
