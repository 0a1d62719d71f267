"""The true curves of a surface, by kind, with the views that see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
from cad_objects.true_curves import curves_by_kind
from demo_scene.bodies import Body
from demo_scene.cameras import TrueCamera
from demo_scene.geometry import KINDS, Surface, chain_edges, sharp_edges, subdivide
from scipy.ndimage import map_coordinates

from zoo.render import Caster
from zoo.stage import Array

HIDDEN = 1e-3  # relative: what is hit nearer than that before a point hides it
MIN_VIEWS = 2
MIN_CONTRAST = 4.0  # gray levels by which the sides of a segment that is seen differ at least
NOISES = 3.0  # standard deviations of the noise by which they do
ASIDE_PX = 2.5  # from a segment to its sides, in the image


@dataclass(frozen=True, kw_only=True)
class TrueCurves:
    """Segments of curves that some views see.

    Attributes:
        points: (P, 3).
        edges: (E, 2) int32 segments between points.
        curve_id: (E,) curve of each segment: smooth, between corners.
        kind: (E,) index into `KINDS`: crease, contact of bodies, border of paint.
        curves: (E,) curve of each, cut where lines and bent curves meet.
        kinds: (C,) kind of each of these: line, arc, circle, elliptic arc, ellipse, other.
        radii: (C, 2); NaN where none.
        visible: (E, V) whether each view sees the middle of the segment: nothing hides it, and
            its sides differ in the image.
    """

    points: Array
    edges: np.ndarray
    curve_id: np.ndarray
    kind: np.ndarray
    curves: np.ndarray
    kinds: np.ndarray
    radii: Array
    visible: np.ndarray


def find_curves(
    surface: Surface,
    bodies: list[Body],
    cameras: list[TrueCamera],
    camera: pycolmap.Camera,
    spacing: float,
) -> TrueCurves:
    """The curves that at least two views see, in segments of at most `spacing`."""
    edges, kind = sharp_edges(surface, bodies)
    vertices = surface.vertices
    curves, kinds, radii = curves_by_kind(vertices, edges)
    curve_id = chain_edges(vertices, edges, kind)
    cut = subdivide(vertices, edges, np.arange(len(edges), dtype=np.int32), kind, spacing)
    whole = cut.curve_id  # the edge of the mesh that each segment is part of
    visible = seen_by(Caster(surface), cut.points[cut.edges].mean(axis=1), cameras, camera)
    kept = visible.sum(axis=1) >= MIN_VIEWS
    used, local = np.unique(cut.edges[kept], return_inverse=True)
    return TrueCurves(
        points=cut.points[used],
        edges=local.reshape(-1, 2).astype(np.int32),
        curve_id=curve_id[whole[kept]],
        kind=cut.kind[kept].astype(np.uint8),
        curves=curves[whole[kept]].astype(np.int32),
        kinds=kinds,
        radii=radii,
        visible=visible[kept],
    )


def shown(curves: TrueCurves, contrasts: Array, noise: float) -> TrueCurves:
    """The curves that at least two views show: (E, V) contrasts exceed the noise there."""
    visible = curves.visible & (contrasts > max(MIN_CONTRAST, NOISES * noise))
    kept = visible.sum(axis=1) >= MIN_VIEWS
    used, local = np.unique(curves.edges[kept], return_inverse=True)
    return TrueCurves(
        points=curves.points[used],
        edges=local.reshape(-1, 2).astype(np.int32),
        curve_id=curves.curve_id[kept],
        kind=curves.kind[kept],
        curves=curves.curves[kept],
        kinds=curves.kinds,
        radii=curves.radii,
        visible=visible[kept],
    )


def contrasts_in(
    image: np.ndarray, curves: TrueCurves, view: TrueCamera, camera: pycolmap.Camera
) -> Array:
    """(E,) largest difference of a channel of an image (H, W, 3) between the sides of segments."""
    ends = curves.points[curves.edges] @ view.cam_from_world[:, :3].T + view.cam_from_world[:, 3]
    depths = np.where(ends[..., 2:] > 0, ends[..., 2:], np.inf)
    pixels = np.asarray(camera.img_from_cam((ends / depths).reshape(-1, 3))).reshape(-1, 2, 2)
    along = pixels[:, 1] - pixels[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True) + 1e-12
    aside = ASIDE_PX * np.column_stack([-along[:, 1], along[:, 0]])
    middle = pixels.mean(axis=1) - 0.5  # OpenCV's first pixel is at (0, 0)
    one, other = (
        [
            map_coordinates(channel, (middle + way).T[::-1], order=1)
            for channel in np.moveaxis(image, 2, 0)
        ]
        for way in (aside, -aside)
    )
    return np.abs(np.array(one) - other).max(axis=0).astype(np.float64)


def seen_by(
    caster: Caster, points: Array, cameras: list[TrueCamera], camera: pycolmap.Camera
) -> np.ndarray:
    """(N, V) whether each view shows points (N, 3) of a surface."""
    seen = np.zeros((len(points), len(cameras)), bool)
    for v, view in enumerate(cameras):
        local = points @ view.cam_from_world[:, :3].T + view.cam_from_world[:, 3]
        inside = np.flatnonzero(in_image(camera, local))
        rays = points[inside] - view.centre()
        _, distance = caster.hits(view.centre(), rays)
        seen[inside, v] = distance > 1 - HIDDEN
    return seen


def in_image(camera: pycolmap.Camera, local: Array) -> np.ndarray:
    """(N,) whether points (N, 3) in the camera's frame are within its image."""
    front = local[:, 2] > 1e-9
    width, height = camera.width, camera.height
    corners = np.array([(0, 0), (width, 0), (0, height), (width, height)], float)
    limit = 1.2 * np.abs(camera.cam_from_img(corners)).max()
    at = local[:, :2] / np.where(front, local[:, 2], 1)[:, None]
    front &= (np.abs(at) < limit).all(axis=1)  # far outside, distortion would fold points inwards
    pixels = np.asarray(camera.img_from_cam(np.column_stack([at, np.ones(len(at))])))
    return front & (pixels > 1).all(axis=1) & (pixels < (width - 1, height - 1)).all(axis=1)


def as_arrays(curves: TrueCurves, surface: Surface, bodies: list[Body]) -> dict[str, np.ndarray]:
    """The content of curves.npz."""
    return {
        **curves.__dict__,
        "kind_names": np.array(KINDS),
        "face_body": surface.face_body.astype(np.int32),
        "body_names": np.array([body.name for body in bodies]),
        "body_materials": np.array([body.material for body in bodies]),
    }
