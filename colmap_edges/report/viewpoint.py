"""The first viewpoint of a scene: that of the photograph that observes most of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, FloatArray, owners_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import unit
from colmap_edges.core.upright import up_direction
from colmap_edges.report.contents import Contents

FOV = np.pi / 4  # vertical field of view
# Points beyond it are outliers: a share of their extent from the 2nd to the 98th percentile.
SHOWN_MARGIN = 0.15


@dataclass(frozen=True, kw_only=True)
class Viewpoint:
    """Position and direction of a view of the scene.

    Attributes:
        eye: (3,) position of the eye, world units.
        focus: (3,) point at the picture's centre, world units.
        up: (3,) upward direction of the picture.
        is_inside: whether the eye is inside the scene, such as in a room.
    """

    eye: FloatArray
    focus: FloatArray
    up: FloatArray
    is_inside: bool = False

    @property
    def axes(self) -> FloatArray:
        """(3, 3) unit vectors to the right, downwards and forwards, as rows."""
        forward = unit(self.focus - self.eye)
        right = unit(np.cross(forward, self.up))
        return np.stack([right, np.cross(forward, right), forward])


def bounds(model: Model, edges: Edges3D | None) -> tuple[FloatArray, FloatArray]:
    """Corners of the shown box: cameras, edges, and SfM points without outliers."""
    parts = [model.camera_centers]
    for points in (model.points3D_xyz, edges.points if edges is not None else np.zeros((0, 3))):
        if len(points):
            low, high = np.percentile(points, [2, 98], axis=0)
            margin = SHOWN_MARGIN * (high - low)
            parts.append(np.stack([low - margin, high + margin]))
    corners = np.concatenate(parts)
    low, high = corners.min(axis=0), corners.max(axis=0)
    margin = 0.02 * float((high - low).max()) + 1e-9
    return low - margin, high + margin


def viewpoint(contents: Contents, aspect: float) -> Viewpoint:
    """The view of the camera that observes most, moved back until the scene fits.

    A camera with more than a tenth of the scene behind it is inside a room or street. It is
    not moved back, since the outer sides of walls would block the view.

    Args:
        contents: the scene.
        aspect: width by height of the picture.
    """
    model = contents.model
    points, views, owners = subject(contents)
    if len(views) == 0:
        return overview(model, points if len(points) else model.camera_centers)
    best = int(np.bincount(views, minlength=len(model.views)).argmax())
    view, eye = model.views[best], model.camera_centers[best]
    own = points[owners[views == best]]
    forward = view.rotation[2]
    focus = eye + forward * max(float(np.median((own - eye) @ forward)), 1e-9)
    start = Viewpoint(eye=eye, focus=focus, up=-view.rotation[1])
    if is_within(points, start):
        return replace(start, is_inside=True)
    return fitted(own, start, aspect)


def subject(contents: Contents) -> tuple[FloatArray, NDArray[Any], NDArray[Any]]:
    """The points (N, 3) to show, and view and point of each of their (T,) observations."""
    model, edges = contents.model, contents.edges
    if edges is not None and edges.num_points:
        return edges.points, edges.observations.views, edges.observations.points
    return model.points3D_xyz, model.track_views, owners_of(model.track_offsets)


def is_within(points: FloatArray, view: Viewpoint) -> bool:
    """Whether more than a tenth of the scene is behind the eye."""
    behind: BoolArray = (points - view.eye) @ view.axes[2] < 0
    return bool(behind.mean() > 0.1)


def fitted(points: FloatArray, view: Viewpoint, aspect: float) -> Viewpoint:
    """The viewpoint moved along its direction so that the picture holds all but outliers."""
    local = (points - view.focus) @ view.axes.T
    low, high = np.percentile(local, [2, 98], axis=0)
    margin = SHOWN_MARGIN * (high - low)
    inliers = ((local >= low - margin) & (local <= high + margin)).all(axis=1)
    middle = (low + high) / 2 * np.array([1, 1, 0])
    right, down, forward = (local[inliers] - middle).T
    half = np.tan(FOV / 2) * np.array([aspect, 1.0])
    needed = np.maximum(np.abs(right) / half[0], np.abs(down) / half[1]) - forward
    # With a border around the scene.
    distance = 1.05 * max(float(needed.max(initial=0.0)), 1e-9)
    focus = view.focus + middle @ view.axes
    return Viewpoint(eye=focus - distance * view.axes[2], focus=focus, up=view.up)


def overview(model: Model, points: FloatArray) -> Viewpoint:
    """A viewpoint from the mean of all cameras, for models without observations."""
    focus = np.median(points, axis=0)
    reach = float(np.linalg.norm(points - focus, axis=1).max()) + 1e-9
    outward = unit(model.camera_centers.mean(axis=0) - focus)
    outward = outward if outward.any() else -model.views[0].rotation[2]
    up = up_direction(model.views)
    return Viewpoint(eye=focus + 2.6 * reach * outward, focus=focus, up=up)
