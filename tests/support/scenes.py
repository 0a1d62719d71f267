"""Synthetic scenes with known 3D curves: solids of flat faces and discs, rendered exactly.

Faces have one grey each, so that every visible border between two greys is the image of a known
3D curve and nothing else is an edge. Pictures are drawn at `SUPERSAMPLING` times the size and
averaged, which gives edges a step response symmetric about their true place; rays are cast, so
that lens distortion and occlusion are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pycolmap

from colmap_edges.colmap.model import load_model
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.options import PipelineOptions

SUPERSAMPLING = 4
BACKGROUND = 128
DISC_SAMPLES = 180
# Without the stages after tracing, which change no edge and take as long as all before.
EDGES_ALONE = PipelineOptions(use_faces=False, use_patches=False, use_sky=False)


@dataclass(frozen=True)
class Face:
    """A flat face: corners (K, 3) seen counter-clockwise from outside, a grey, discs painted on."""

    corners: np.ndarray
    gray: int
    discs: tuple[tuple[np.ndarray, int], ...] = ()

    @property
    def normal(self):
        a, b, c = self.corners[:3]
        normal = np.cross(b - a, c - a)
        return normal / np.linalg.norm(normal)


@dataclass(frozen=True)
class Scene:
    """A scene: true curves, the images by name, and the model with SfM points.

    Attributes:
        curves: (K, 3) polylines; straight edges have their two ends, closed curves return to
            their first point.
        samples: (S, 3) points every 0.02 on the curves, and
        sample_views: (S,) the number of views that see each: what recall is counted on.
        images: (H, W) uint8 by name.
        reconstruction: pycolmap.Reconstruction at the true poses.
    """

    curves: list
    samples: np.ndarray
    sample_views: np.ndarray
    images: dict
    reconstruction: pycolmap.Reconstruction

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Write images and model below `folder`; return image_path and input_path."""
        image_path, input_path = folder / "images", folder / "sparse"
        image_path.mkdir(parents=True)
        input_path.mkdir()
        for name, image in self.images.items():
            (image_path / name).parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(image_path / name), image)
        self.reconstruction.write(str(input_path))
        return image_path, input_path

    def distances(self, points):
        """Distance (N,) of each of (N, 3) points from the nearest true curve."""
        starts = np.concatenate([curve[:-1] for curve in self.curves])
        ends = np.concatenate([curve[1:] for curve in self.curves])
        best = np.full(len(points), np.inf)
        for a, b in zip(starts, ends, strict=True):
            t = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
            best = np.minimum(best, np.linalg.norm(points - (a + t[:, None] * (b - a)), axis=1))
        return best


def resample(curve, spacing):
    """Points on a polyline at most `spacing` apart."""
    parts = [curve[:1]]
    for a, b in pairwise(curve):
        steps = max(int(np.ceil(np.linalg.norm(b - a) / spacing)), 1)
        parts.append(a + np.linspace(0, 1, steps + 1)[1:, None] * (b - a))
    return np.concatenate(parts)


def disc(center, normal, radius):
    """Circle as (DISC_SAMPLES, 3) corners, counter-clockwise about `normal`."""
    u = np.cross(normal, [0.3, 0.5, 0.8])
    u /= np.linalg.norm(u)
    v = np.cross(normal, u)
    angle = np.linspace(0, 2 * np.pi, DISC_SAMPLES, endpoint=False)[:, None]
    return center + radius * (np.cos(angle) * u + np.sin(angle) * v)


def prism(outline, height, grays, offset, disc_radius=0.0):
    """Faces of an upright prism over a convex `outline` (K, 2), with a disc on each big face."""
    count = len(outline)
    low = np.column_stack([outline, np.zeros(count)]) + offset
    high = low + np.array([0, 0, height])
    corners = [high, low[::-1]]
    for i in range(count):
        j = (i + 1) % count
        corners.append(np.array([low[i], low[j], high[j], high[i]]))
    faces = []
    for index, face in enumerate(corners):
        gray = grays[index % len(grays)]
        bare = Face(face, gray)
        circle = disc(face.mean(axis=0), bare.normal, disc_radius)
        faces.append(Face(face, gray, ((circle, 255 - gray),)) if disc_radius else bare)
    return faces


def solids():
    """A cube with discs on its faces and a three-sided prism, apart from each other."""
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * 0.5
    triangle = np.array([[-0.5, -0.4], [0.5, -0.4], [0.0, 0.5]])
    cube = prism(square, 1.0, (235, 20, 60, 190, 90, 160), np.array([-0.9, 0.1, -0.5]), 0.3)
    wedge = prism(triangle, 0.8, (215, 40, 70, 180, 30), np.array([0.9, -0.1, -0.5]))
    return [cube, wedge]


def look_at(center, target, roll):
    """cam_from_world of a camera at `center` that looks at `target`, rolled about its axis."""
    z = (target - center) / np.linalg.norm(target - center)
    x = np.cross(z, [0, 0, 1.0])
    x /= np.linalg.norm(x)
    y = np.cross(z, x)
    turn = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    rotation = turn @ np.array([x, y, z])
    return rotation, -rotation @ center


def poses(count):
    """Poses on an arc of 150 degrees at two heights."""
    angles = np.deg2rad(np.linspace(-75, 75, count))
    result = []
    for i, angle in enumerate(angles):
        height = (1.2, 2.4)[i % 2]
        center = np.array([4 * np.sin(angle), -4 * np.cos(angle), height])
        result.append(look_at(center, np.zeros(3), 0.05 * (i % 3 - 1)))
    return result


def make_camera(model, width, height):
    """A camera of one of COLMAP's models, with moderate distortion where it has any."""
    camera = pycolmap.Camera.create_from_model_name(1, model, 1.1 * width, width, height)
    distortion = {
        "SIMPLE_RADIAL": {3: -0.05},
        "OPENCV": {4: -0.06, 5: 0.02, 6: 0.001, 7: -0.001},
        "OPENCV_FISHEYE": {4: 0.02, 5: -0.01},
        "RADIAL": {3: -0.05, 4: 0.02},
        "SIMPLE_RADIAL_FISHEYE": {3: 0.02},
        "RADIAL_FISHEYE": {3: 0.02, 4: -0.01},
        "FULL_OPENCV": {4: -0.06, 5: 0.02, 6: 0.001, 9: 0.01},
        "FOV": {4: 0.4},
        "THIN_PRISM_FISHEYE": {4: 0.02, 6: 0.001, 10: 0.001},
        "RAD_TAN_THIN_PRISM_FISHEYE": {4: 0.02, 10: 0.001, 12: 0.001},
        "SIMPLE_DIVISION": {3: -0.05},
        "DIVISION": {4: -0.05},
        "EUCM": {4: 0.4, 5: 1.1},
    }
    params = np.array(camera.params)
    for index, value in distortion.get(model, {}).items():
        params[index] = value
    camera.params = params
    return camera


def project(camera, pose, points):
    """(N, 2) image pixels of (N, 3) world points."""
    rotation, translation = pose
    return np.asarray(camera.img_from_cam(points @ rotation.T + translation)).reshape(-1, 2)


def supersampled_rays(camera):
    """Directions x, y (H * S, W * S) at z = 1 through the centres of the finer pixels."""
    shape = (camera.height * SUPERSAMPLING, camera.width * SUPERSAMPLING)
    rows, columns = np.indices(shape, np.float64)
    pixels = np.stack([columns.ravel() + 0.5, rows.ravel() + 0.5], axis=1) / SUPERSAMPLING
    x, y = np.asarray(camera.cam_from_img(pixels)).reshape(-1, 2).T.reshape(2, *shape)
    return np.ascontiguousarray(x), np.ascontiguousarray(y)


def dot(x, y, direction):
    """Products of vectors (x, y, 1) with one direction; without BLAS, whose threads cost more."""
    products = x * direction[0]
    products += y * direction[1]
    products += direction[2]
    return products


def window_of(camera, pose, corners):
    """Slices of the supersampled image that hold the projection of a polygon."""
    pixels = project(camera, pose, resample(np.vstack([corners, corners[:1]]), 0.05))
    low, high = pixels.min(axis=0) - 2, pixels.max(axis=0) + 2
    bounds = (np.stack([low, high]) * SUPERSAMPLING).astype(int).clip(0)
    return slice(*bounds[:, 1]), slice(*bounds[:, 0])


def render(camera, pose, bodies, rays):
    """Image (H, W) uint8 and supersampled ids of faces, 0 for background, by ray casting.

    `rays` are `supersampled_rays` of the camera.
    """
    shape = rays[0].shape
    image = np.full(shape, BACKGROUND, np.uint8)
    ids = np.zeros(shape, np.uint8)
    depths = np.full(shape, np.inf)
    center = -pose[0].T @ pose[1]
    for number, face in enumerate((f for body in bodies for f in body), 1):
        offset = face.normal @ (face.corners[0] - center)
        if offset >= 0:
            continue  # seen from behind
        window = window_of(camera, pose, face.corners)
        x, y = (along[window] for along in rays)
        depth = offset / np.minimum(dot(x, y, pose[0] @ face.normal), -1e-12)
        hit = depth < depths[window]
        for a, b in zip(face.corners, np.roll(face.corners, -1, axis=0), strict=True):
            outward = np.cross(b - a, face.normal)
            hit &= depth * dot(x, y, pose[0] @ outward) <= (a - center) @ outward
        x, y, depth = x[hit], y[hit], depth[hit]
        grays = np.full(len(depth), face.gray, np.uint8)
        for circle, gray in face.discs:
            middle = circle.mean(axis=0)
            radius = np.linalg.norm(circle[0] - middle)
            points = (
                depth * np.stack([x, y, np.ones(len(x))]) - (pose[0] @ (middle - center))[:, None]
            )
            grays[np.linalg.norm(points, axis=0) <= radius] = gray
        image[window][hit], ids[window][hit], depths[window][hit] = grays, number, depth
    blocks = image.reshape(camera.height, SUPERSAMPLING, camera.width, SUPERSAMPLING)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8), ids


def faces_seen(face, number, points, ids, views):
    """(N, V) whether each view sees points of a face, by the rendered face ids."""
    inner = points + 0.02 * (face.corners.mean(axis=0) - points)
    seen = np.zeros((len(points), len(views)), bool)
    for column, (image_id, (camera, pose)) in enumerate(views.items()):
        at = np.floor(project(camera, pose, inner) * SUPERSAMPLING).astype(int)
        rows = np.flatnonzero(((at >= 0) & (at < np.array(ids[image_id].shape[::-1]))).all(axis=1))
        seen[rows, column] = ids[image_id][at[rows, 1], at[rows, 0]] == number
    return seen


def sfm_points(face, rng, per_edge, inside):
    """Points of a face: corners, points on its borders and circles, points inside."""
    rings = [face.corners, *(circle[::6] for circle, _ in face.discs)]
    parts = [face.corners]
    for ring in rings:
        after = np.roll(ring, -1, axis=0)
        t = rng.random((per_edge, 1, 1))
        parts.append((ring + t * (after - ring)).reshape(-1, 3))
    weights = rng.dirichlet(np.ones(len(face.corners)), inside)
    parts.append(weights @ face.corners)
    return np.concatenate(parts)


def add_points(reconstruction, bodies, ids, views, rng, noise_px):
    """Add SfM points with tracks of the images that see them."""
    for number, face in enumerate((f for body in bodies for f in body), 1):
        xyz = sfm_points(face, rng, per_edge=3, inside=20)
        seen = faces_seen(face, number, xyz, ids, views)
        pixels = {v: project(*views[v], xyz) for v in views}
        for row, point in enumerate(xyz):
            observations = [
                (image_id, pixels[image_id][row] + rng.normal(0, noise_px, 2))
                for image_id, visible in zip(views, seen[row], strict=True)
                if visible
            ]
            if len(observations) >= 2:
                add_point(reconstruction, point, observations)


def seen_samples(bodies, ids, views, spacing):
    """Points (S, 3) on the true curves and the number (S,) of views that see each."""
    seen_by = {}
    for number, face in enumerate((f for body in bodies for f in body), 1):
        for ring in (face.corners, *(circle for circle, _ in face.discs)):
            points = resample(np.vstack([ring, ring[:1]]), spacing)[:-1]
            for point, seen in zip(
                points, faces_seen(face, number, points, ids, views), strict=True
            ):
                key = tuple(np.round(point, 6) + 0.0)
                seen_by[key] = seen_by.get(key, False) | seen
    counts = np.array([seen.sum() for seen in seen_by.values()])
    return np.array(list(seen_by)), counts


def add_point(reconstruction, xyz, observations):
    """Add one point with its observations by pycolmap's own API."""
    track = pycolmap.Track()
    for image_id, pixel in observations:
        points2D = reconstruction.images[image_id].points2D
        track.add_element(image_id, len(points2D))
        points2D.append(pycolmap.Point2D(pixel))
    reconstruction.add_point3D(xyz, track, np.array([90, 90, 90], np.uint8))


def true_curves(bodies):
    """Borders of faces (once each) and circles as polylines."""
    curves, known = [], set()
    for face in (f for body in bodies for f in body):
        for a, b in zip(face.corners, np.roll(face.corners, -1, axis=0), strict=True):
            key = frozenset((tuple(np.round(a, 9)), tuple(np.round(b, 9))))
            if key not in known:
                known.add(key)
                curves.append(np.array([a, b]))
        curves += [np.vstack([circle, circle[:1]]) for circle, _ in face.discs]
    return curves


@cache
def make_scene(
    num_views=10, width=480, height=360, camera_model="PINHOLE", noise_px=0.2, seed=0
) -> Scene:
    """Make a scene; the same arguments give the same scene, which must not be changed."""
    rng = np.random.default_rng(seed)
    bodies = solids()
    reconstruction = pycolmap.Reconstruction()
    camera = make_camera(camera_model, width, height)
    reconstruction.add_camera_with_trivial_rig(camera)
    images, ids, views = {}, {}, {}
    rays = supersampled_rays(camera)
    for image_id, pose in enumerate(poses(num_views), 1):
        name = f"view_{image_id:03d}.png"
        image = pycolmap.Image(name, [], 1, image_id)
        rigid = pycolmap.Rigid3d(np.column_stack(pose))
        reconstruction.add_image_with_trivial_frame(image, rigid)
        images[name], ids[image_id] = render(camera, pose, bodies, rays)
        views[image_id] = (camera, pose)
    add_points(reconstruction, bodies, ids, views, rng, noise_px)
    reconstruction.update_point_3d_errors()
    samples, sample_views = seen_samples(bodies, ids, views, spacing=0.02)
    return Scene(true_curves(bodies), samples, sample_views, images, reconstruction)


def true_edges(model, scene, spacing=0.05, noise_px=0.0, seed=0) -> Edges3D:
    """The true curves as 3D edges, each point observed in a random half of the views."""
    rng = np.random.default_rng(seed)
    points, offsets, views, pixels, tracks = [], [0], [], [], [0]
    closed = [bool(np.allclose(curve[0], curve[-1])) for curve in scene.curves]
    for curve, is_closed in zip(scene.curves, closed, strict=True):
        samples = resample(curve, spacing)[: -1 if is_closed else None]
        points.append(samples)
        offsets.append(offsets[-1] + len(samples))
        for point in samples:
            half = rng.permutation(len(model.views))[: max(len(model.views) // 2, 2)]
            chosen = np.sort(half)
            views.append(chosen)
            projected = [model.views[v].project(point[None])[0][0] for v in chosen]
            pixels.append(np.array(projected) + rng.normal(0, noise_px, (len(chosen), 2)))
            tracks.append(tracks[-1] + len(chosen))
    xyz = np.concatenate(points)
    return Edges3D(
        points=xyz,
        edge_offsets=np.array(offsets, np.int64),
        closed=np.array(closed),
        observations=Observations.of_pixels(
            offsets=np.array(tracks, np.int64),
            views=np.concatenate(views).astype(np.int32),
            pixels=np.concatenate(pixels),
        ),
        sigmas=np.full(len(xyz), np.nan),
        end_nodes=np.full((len(closed), 2), -1, np.int32),
        colors=rng.integers(0, 256, (len(xyz), 3)).astype(np.uint8),
    )


def load_scene_model(scene: Scene, folder: Path):
    """Write the scene's model and load it as arrays."""
    _, input_path = scene.write(folder)
    return load_model(input_path)
