"""The sparse model of a scene as SfM would give it: points with tracks, noise and pose errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from zoo.camera import Grid, Rig, View
from zoo.geometry import Array, Random, unit
from zoo.light import LampLit
from zoo.materials import painted
from zoo.truth import TrueCurves, seen_by

MIN_TRACK = 3
MIN_FACING = 0.25  # cosine between a face's normal and the rays of views that match it
MAX_TURN = np.cos(np.radians(35))  # between the rays of the views of a track and its first one
MATCHED = 0.7  # share of the views that could match a point and do
WRONG = 0.01  # share of observations that are off by up to `MAX_ERROR` pixels
MAX_ERROR = 4.0  # of COLMAP's filter
TEXTURED = 0.1  # minimum contrast of materials with points on them
ITERATIONS = 5


@dataclass(frozen=True, kw_only=True)
class Tracks:
    """Points with observations: (N, 3) points, (N, 3) colours, (M,) points and views, (M, 2) px."""

    points: Array
    colours: np.ndarray
    point: np.ndarray
    view: np.ndarray
    pixels: Array


def find_tracks(
    random: Random, lit: LampLit, curves: TrueCurves, rig: Rig, count: int, noise_px: float
) -> Tracks:
    """At most `count` points on textures and at corners with observations at least in 3 views."""
    places, normals, colours = candidates(random, lit, rig, 4 * count)
    corners = corner_points(curves)
    places = np.concatenate([places, corners])
    normals = np.concatenate([normals, np.zeros_like(corners)])  # seen from anywhere
    colours = np.concatenate([colours, np.full(corners.shape, 0.5)])
    matched = match(random, lit, places, normals, rig)
    kept = np.flatnonzero(matched.sum(axis=1) >= MIN_TRACK)
    kept = np.sort(random.choice(kept, min(count, len(kept)), replace=False))
    point, view = np.nonzero(matched[kept])
    exact = project(places[kept][point], view, rig)
    pixels = exact + random.normal(0, noise_px, exact.shape)
    wrong = random.random(len(pixels)) < WRONG
    pixels[wrong] += random.uniform(-MAX_ERROR, MAX_ERROR, (int(wrong.sum()), 2)) / np.sqrt(2)
    inside = np.clip(pixels, 0.5, np.array([rig.camera.width, rig.camera.height]) - 0.5)
    shown = np.rint(255 * np.clip(colours[kept], 0, 1) ** (1 / 2.2)).astype(np.uint8)
    return Tracks(points=places[kept], colours=shown, point=point, view=view, pixels=inside)


def candidates(random: Random, lit: LampLit, rig: Rig, count: int) -> tuple[Array, Array, Array]:
    """Places (N, 3) on textures that random pixels of all views show, normals and colours."""
    found: list[tuple[Array, Array, Array]] = []
    stage = lit.stage
    materials = [stage.materials[body.material] for body in stage.bodies]
    textured = np.array([material.contrast >= TEXTURED for material in materials])
    face_body = lit.caster.surface.face_body
    centers = Grid.of(rig.camera).centers
    for view in rig.views:
        at = centers[random.integers(len(centers), size=count // len(rig.views) + 1)]
        rays = view.rays(at)
        faces, distance = lit.caster.hits(view.centre(), rays)
        hit = np.flatnonzero((faces >= 0) & textured[face_body[faces]])
        places = view.centre() + distance[hit, None] * rays[hit]
        body = face_body[faces[hit]]
        colours = np.zeros(places.shape)
        for i in np.unique(body):
            own = body == i
            colours[own] = painted(materials[i], places[own], int(i), np.zeros(own.sum()))
        found.append((places, lit.caster.normals[faces[hit]], colours))
    places, normals, colours = (np.concatenate(x) for x in zip(*found, strict=True))
    return places, normals, colours


def corner_points(curves: TrueCurves) -> Array:
    """(N, 3) points where curves end or meet."""
    ends = np.column_stack([curves.edges.ravel(), np.repeat(curves.curve_id, 2)])
    pairs, times = np.unique(ends, axis=0, return_counts=True)
    return curves.points[np.unique(pairs[times == 1, 0])]


def match(random: Random, lit: LampLit, places: Array, normals: Array, rig: Rig) -> np.ndarray:
    """(N, V) which views observe which points: near one of the views that see it, most of them."""
    seen = seen_by(lit.caster, places, rig)
    ways = unit((np.array([view.centre() for view in rig.views]) - places[:, None]).reshape(-1, 3))
    ways = ways.reshape(*seen.shape, 3)
    cosine = np.einsum("ijk,ik->ij", ways, normals)
    seen &= (cosine > MIN_FACING) | ~normals.any(axis=1)[:, None]
    first = np.argmax(seen * random.random(seen.shape), axis=1)
    near = np.einsum("ijk,ik->ij", ways, ways[np.arange(len(places)), first]) > MAX_TURN
    return seen & near & (random.random(seen.shape) < MATCHED)


def project(points: Array, view: np.ndarray, rig: Rig) -> Array:
    """(N, 2) pixels of points (N, 3) in their views (N,)."""
    poses = np.array([each.cam_from_world for each in rig.views])[view]
    local = np.einsum("ijk,ik->ij", poses[..., :3], points) + poses[..., 3]
    return np.asarray(rig.camera.img_from_cam(local)).reshape(-1, 2)


def disturb(random: Random, view: View, error: float, distance: float) -> View:
    """A view whose pose is off so that points at a distance move by `error` (in focal lengths)."""
    turn = Rotation.from_rotvec(random.normal(0, error / 2, 3)).as_matrix()
    shift = random.normal(0, error * distance / 2, 3)
    pose = turn @ view.cam_from_world
    pose[:, 3] += shift
    return View(name=view.name, cam_from_world=pose)


def triangulated(tracks: Tracks, rig: Rig) -> Array:
    """(N, 3) points that fit their observations best in the given views, by Gauss and Newton."""
    at = np.asarray(rig.camera.cam_from_img(tracks.pixels)).reshape(-1, 2)
    poses = np.array([view.cam_from_world for view in rig.views])[tracks.view]
    points = tracks.points.copy()
    for _ in range(ITERATIONS):
        local = np.einsum("ijk,ik->ij", poses[..., :3], points[tracks.point]) + poses[..., 3]
        depth = local[:, 2:]
        residual = at - local[:, :2] / depth
        slope = poses[:, :2, :3] - (local[:, :2] / depth)[..., None] * poses[:, 2:, :3]
        slope /= depth[..., None]
        normal, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
        np.add.at(normal, tracks.point, np.einsum("nij,nik->njk", slope, slope))
        np.add.at(right, tracks.point, np.einsum("nij,ni->nj", slope, residual))
        points += np.linalg.solve(normal, right[..., None])[..., 0]
    return points


def posed_model(rig: Rig, keypoints: list[Array] | None = None) -> pycolmap.Reconstruction:
    """The COLMAP model of views without points, with (N, 2) keypoints in each."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(rig.camera)
    for v, view in enumerate(rig.views):
        own = keypoints[v] if keypoints else np.empty((0, 2))
        image = pycolmap.Image(name=view.name, keypoints=own, camera_id=1, image_id=v + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(view.cam_from_world))
    return model


def model_of(tracks: Tracks, points: Array, rig: Rig) -> pycolmap.Reconstruction:
    """The COLMAP model of views and points."""
    order = np.argsort(tracks.view, kind="stable")
    starts = np.searchsorted(tracks.view[order], np.arange(len(rig.views) + 1))
    place_in_view = np.empty(len(order), int)
    place_in_view[order] = np.arange(len(order)) - starts[tracks.view[order]]
    keypoints = np.split(tracks.pixels[order], starts[1:-1])
    model = posed_model(rig, keypoints)
    bounds = np.searchsorted(tracks.point, np.arange(len(points) + 1))
    for i, point in enumerate(points):
        track = pycolmap.Track()
        for j in range(bounds[i], bounds[i + 1]):
            track.add_element(int(tracks.view[j]) + 1, int(place_in_view[j]))
        model.add_point3D(point, track, tracks.colours[i])
    model.update_point_3d_errors()
    return model
