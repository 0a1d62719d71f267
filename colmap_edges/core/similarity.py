"""Similarity transforms of points, edges and curves: one frame from another."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D

Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # from z up, as glTF has it


@dataclass(frozen=True, kw_only=True)
class Similarity:
    """The transform scale * rotation @ x + translation, of one frame into another.

    Attributes:
        scale: length in the new frame of a length of 1 in the old one.
        rotation: (3, 3) rotation.
        translation: (3,) position of the old origin in the new frame.
    """

    scale: float
    rotation: FloatArray
    translation: FloatArray

    @classmethod
    def identity(cls) -> Similarity:
        """The transform that changes nothing."""
        return cls(scale=1.0, rotation=np.eye(3), translation=np.zeros(3))

    def after(self, first: Similarity) -> Similarity:
        """This transform, of what `first` gives."""
        return Similarity(
            scale=self.scale * first.scale,
            rotation=self.rotation @ first.rotation,
            translation=self.points(first.translation[None])[0],
        )

    def points(self, points: FloatArray) -> FloatArray:
        """(N, 3) points in the new frame; those of an identity are the same to the bit."""
        return np.asarray(self.vectors(points) + self.translation)

    def vectors(self, vectors: FloatArray) -> FloatArray:
        """(..., 3) differences of points in the new frame."""
        if np.array_equal(self.rotation, np.eye(3)):
            return np.asarray(self.scale * vectors)
        return np.asarray(self.scale * (vectors @ self.rotation.T))

    def edges(self, edges: Edges3D) -> Edges3D:
        """3D edges in the new frame."""
        nodes = replace(
            edges.nodes,
            points=self.points(edges.nodes.points),
            sigmas=self.scale * edges.nodes.sigmas,
        )
        points, sigmas = self.points(edges.points), self.scale * edges.sigmas
        return replace(edges, points=points, sigmas=sigmas, nodes=nodes)

    def curves(self, curves: Curves3D) -> Curves3D:
        """Curves in the new frame."""
        frames = self.vectors(curves.frames)
        has_origin = np.diff(curves.knot_offsets) == 0  # frames of splines are 0
        frames[has_origin, 0] += self.translation
        return replace(
            curves,
            frames=frames,
            knots=self.scale * curves.knots,
            spans=np.where(has_origin[:, None], curves.spans, self.scale * curves.spans),
            control_points=self.points(curves.control_points),
            position_sigmas=self.scale * curves.position_sigmas,
            radius_sigmas=self.scale * curves.radius_sigmas,
            control_sigmas=self.scale * curves.control_sigmas,
        )


def to_z_up(up: FloatArray) -> FloatArray:
    """(3, 3) the smallest rotation that turns a (3,) direction to z."""
    x, y, z = up / np.linalg.norm(up)
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    # Rodrigues' formula, whose axis is up x z = (y, -x, 0).
    k = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    return np.asarray(np.eye(3) + k + k @ k / (1 + z))
