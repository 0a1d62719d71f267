"""The true curves of a surface, by kind, with the views that see them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.ndimage import map_coordinates

from zoo.camera import Rig, View
from zoo.casting import Caster
from zoo.curves import chain_edges, curves_by_kind, subdivide
from zoo.geometry import KINDS, Array, Body, Surface, sharp_edges, write_surface

HIDDEN = 1e-3  # relative: what is hit nearer than that before a point hides it
MIN_VIEWS = 2
MIN_CONTRAST = 4.0  # gray levels by which the sides of a segment that is seen differ at least
NOISES = 3.0  # standard deviations of the noise by which they do
ASIDE_PX = 2.5  # from a segment to its sides, in the image


@dataclass(frozen=True, kw_only=True)
class Curves:
    """Segments of the curves of a surface."""

    points: Array  # (P, 3)
    edges: np.ndarray  # (E, 2) int32 segments between points
    curve_id: np.ndarray  # (E,) curve of each segment: smooth, between corners
    kind: np.ndarray  # (E,) uint8 index into `KINDS`: crease, contact of bodies, border of paint


@dataclass(frozen=True, kw_only=True)
class TrueCurves(Curves):
    """Segments of curves that some views see."""

    curves: np.ndarray  # (E,) curve of each, cut where lines and bent curves meet
    kinds: np.ndarray  # (C,) kind of each of these: line, arc, circle, elliptic arc, ellipse, other
    radii: Array  # (C, 2); NaN where none
    # (E, V) whether each view sees the middle of the segment: nothing hides it, and its sides
    # differ in the image.
    visible: np.ndarray

    def seen(self, visible: np.ndarray) -> TrueCurves:
        """The segments that at least two views see, given what each view sees (E, V)."""
        kept = visible.sum(axis=1) >= MIN_VIEWS
        used, local = np.unique(self.edges[kept], return_inverse=True)
        return replace(
            self,
            points=self.points[used],
            edges=local.reshape(-1, 2).astype(np.int32),
            curve_id=self.curve_id[kept],
            kind=self.kind[kept],
            curves=self.curves[kept],
            visible=visible[kept],
        )


def cut_curves(
    surface: Surface, bodies: list[Body], spacing: float
) -> tuple[Curves, np.ndarray, np.ndarray]:
    """All curves in segments of at most `spacing`; (M, 2) edges of the mesh; (E,) whose part."""
    edges, kind = sharp_edges(surface, bodies)
    points, segments, own = subdivide(surface.vertices, edges, spacing)
    curve_id = chain_edges(surface.vertices, edges, kind)[own]
    return Curves(points=points, edges=segments, curve_id=curve_id, kind=kind[own]), edges, own


def find_curves(surface: Surface, bodies: list[Body], rig: Rig, spacing: float) -> TrueCurves:
    """The curves that at least two views see, in segments of at most `spacing`."""
    every, edges, own = cut_curves(surface, bodies, spacing)
    curves, kinds, radii = curves_by_kind(surface.vertices, edges)
    visible = seen_by(Caster(surface), every.points[every.edges].mean(axis=1), rig)
    by_kind = {"curves": curves[own].astype(np.int32), "kinds": kinds, "radii": radii}
    return TrueCurves(**every.__dict__, **by_kind, visible=visible).seen(visible)


def shown(curves: TrueCurves, contrasts: Array, noise: float) -> TrueCurves:
    """The curves that at least two views show: (E, V) contrasts exceed the noise there."""
    return curves.seen(curves.visible & (contrasts > max(MIN_CONTRAST, NOISES * noise)))


def contrasts_in(
    image: np.ndarray, curves: TrueCurves, view: View, camera: pycolmap.Camera
) -> Array:
    """(E,) largest difference of a channel of an image (H, W, 3) between the sides of segments."""
    ends = view.local(curves.points[curves.edges])
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


def seen_by(caster: Caster, points: Array, rig: Rig) -> np.ndarray:
    """(N, V) whether each view shows points (N, 3) of a surface."""
    seen = np.zeros((len(points), len(rig.views)), bool)
    for v, view in enumerate(rig.views):
        inside = np.flatnonzero(in_image(rig.camera, view.local(points)))
        _, distance = caster.hits(view.centre(), points[inside] - view.centre())
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


def write_truth(
    folder: Path, surface: Surface, bodies: list[Body], curves: Curves, **more: Any
) -> None:
    """Write surface.ply, and curves.npz with the bodies of the faces and `more`."""
    write_surface(folder / "surface.ply", surface)
    of_surface = {
        "kind_names": np.array(KINDS),
        "face_body": surface.face_body,
        "body_names": np.array([body.name for body in bodies]),
        "body_materials": np.array([body.material for body in bodies]),
    }
    np.savez_compressed(folder / "curves.npz", **{**curves.__dict__, **of_surface, **more})
