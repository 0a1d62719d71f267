"""Pictures of a run on a scene: edges on an image, the mesh from two places, an error map."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from colmap_edges.core.arrays import Picture
from colmap_edges.core.view import View
from colmap_edges.evaluation import pictures
from colmap_edges.evaluation.metrics import depth
from colmap_edges.evaluation.metrics.raycasting import RayCaster, load_mesh
from colmap_edges.evaluation.readers.arrays import read_arrays
from colmap_edges.evaluation.readers.curves import Curves
from colmap_edges.images.files import read_image
from trials import judging

STRIDE = 2  # pixels between rays
LARGEST = 0.02  # of depth, at the end of error maps
HIDDEN = 0.01  # of depth, by which what is hidden lies behind the surface
CLEAR = 0.3  # of the scene's depth, before a place from which it is looked at
EDGE, BACKGROUND = (60, 220, 60), (255, 220, 200)


def draw(scene: Path, run: Path) -> Picture:
    """Edges on the image and the error map above the mesh from there and from another place."""
    found = read_arrays(run)
    caster = judging.caster_of(found, "patches")
    truths = [t for t in judging.truth_of(scene, stride=STRIDE) if t.reference.known.any()]
    worst = max(truths, key=lambda truth: wrong_share(caster, truth.reference))
    reference = worst.reference
    view = reference.view
    errors = judging.relative(depth.depth_errors(caster, reference))
    surface = load_mesh(scene / "surface.ply")  # a mesh with holes does not hide what is behind
    truth = RayCaster(surface.vertices, surface.faces)
    image = on_image(read_image(view, scene / "images"), view, judging.found_curves(found), truth)
    place = other_place([truth.reference for truth in truths], view)
    error_map = pictures.error_map(errors, LARGEST, "error / depth")
    size = (view.width // STRIDE, view.height // STRIDE)
    parts = [image, error_map[: -(16 + 36)], shaded(caster, view), shaded(caster, place)]
    parts = [cv2.resize(part, size, interpolation=cv2.INTER_AREA) for part in parts]
    return np.vstack([np.hstack(parts[:2]), np.hstack(parts[2:])]).astype(np.uint8)


def wrong_share(caster: RayCaster, reference: depth.ReferenceDepth) -> float:
    """Share of a view's pixels at which the mesh is more than 1 % off."""
    return 1 - depth.depth_errors(caster, reference).record()["right_1_percent"]


def on_image(image: Picture, view: View, edges: Curves, caster: RayCaster) -> Picture:
    """The darkened image with the edges that a surface does not hide there."""
    pixels, depths = view.project(edges.points)
    # Distortion folds what lies far outside the image back into it.
    offsets = view.undistorted_from_image(pixels) - view.project_undistorted(edges.points)[0]
    inside = view.holds(pixels, depths) & (np.abs(offsets).max(axis=1, initial=0) < 1)
    front = np.full(len(pixels), np.inf)
    front[inside] = np.nan_to_num(caster.depth_at(view, pixels[inside]), nan=np.inf)
    seen = inside & (depths <= front * (1 + HIDDEN))
    chosen = edges.segments[seen[edges.segments].all(axis=1)]
    lines = np.rint((pixels[chosen] - 0.5) * 8).astype(np.int32)
    canvas = image // 2
    cv2.polylines(canvas, list(lines.reshape(-1, 2, 1, 2)), False, EDGE, 1, cv2.LINE_AA, 3)
    return np.asarray(canvas, np.uint8)


def shaded(caster: RayCaster, view: View) -> Picture:
    """The mesh seen by a view, (H, W, 3), lit from the camera."""
    shape = (view.height // STRIDE, view.width // STRIDE)
    rows, columns = np.indices(shape) * STRIDE + STRIDE / 2
    rays = view.rays(np.column_stack([columns.ravel(), rows.ravel()]))
    hits = caster.hits(view.center, rays)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    light = -np.einsum("ij,ij->i", hits.normals, rays)
    gray = np.repeat(40 + 200 * np.nan_to_num(light)[:, None], 3, axis=1)
    gray[np.isnan(light)] = BACKGROUND
    return gray.reshape(*shape, 3).astype(np.uint8)


def other_place(references: list[depth.ReferenceDepth], view: View) -> View:
    """A view from between the given ones, as far as possible from them, with room before it."""
    centers = np.array([reference.view.center for reference in references])
    target = surface_points(references, view)
    surface = np.concatenate([surface_points(references, each.view) for each in references])
    room = CLEAR * np.linalg.norm(target.mean(axis=0) - view.center)
    places = (centers[:, None] + centers[None]).reshape(-1, 3) / 2
    alone = np.linalg.norm(places[:, None] - centers[None], axis=2).min(axis=1)
    clear = np.linalg.norm(places[:, None] - surface[None], axis=2).min(axis=1)
    best = places[np.argmax(np.where(clear >= room, alone, -clear.max() + clear))]
    return looking(view, best, np.median(target, axis=0))


def surface_points(
    references: list[depth.ReferenceDepth], view: View, step: int = 16
) -> np.ndarray:
    """Some true surface points (N, 3) that a view sees."""
    reference = next(each for each in references if each.view is view)
    depths = np.where(reference.known, reference.depth, np.nan)[::step, ::step].ravel()
    rays = view.rays(reference.pixels[::step, ::step].reshape(-1, 2))
    points = view.center + rays * depths[:, None]
    return points[np.isfinite(depths)]


def looking(view: View, center: np.ndarray, target: np.ndarray) -> View:
    """The view moved to a centre and turned to a target, upright as it was."""
    ahead = target - center
    ahead /= np.linalg.norm(ahead)
    right = np.cross(view.rotation[1], ahead)
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(ahead, right), ahead])
    return replace(view, rotation=rotation, translation=-rotation @ center)
