"""Known 3D curves seen by posed cameras, as edge graphs without images: every place is exact."""

from __future__ import annotations

from dataclasses import dataclass

import curves as known
import numpy as np
import pycolmap

FOCAL_PX, WIDTH, HEIGHT = 800.0, 1000, 800


def make_view(index, center, target=(0.0, 0.0, 0.0), roll=0.0):
    forward = np.subtract(target, center) / np.linalg.norm(np.subtract(target, center))
    right = np.cross([np.sin(roll), np.cos(roll), 0.0], forward)
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(forward, right), forward])
    camera = pycolmap.Camera(
        model="PINHOLE",
        width=WIDTH,
        height=HEIGHT,
        params=[FOCAL_PX, FOCAL_PX, WIDTH / 2, HEIGHT / 2],
    )
    return known.make_view(rotation, -rotation @ np.asarray(center, float), index, camera)


def ring_of_views(count=7, distance=6.0, spread_deg=70.0):
    """Views on an arc, alternately higher and lower so that no edge runs along all baselines."""
    angles = np.radians(np.linspace(-spread_deg / 2, spread_deg / 2, count))
    return tuple(
        make_view(
            i,
            (distance * np.sin(a), (-1.2, 0.9, -0.2)[i % 3], -distance * np.cos(a)),
            roll=0.1 * (i % 2),
        )
        for i, a in enumerate(angles)
    )


@dataclass(frozen=True)
class Curve:
    """A dense 3D polyline; a closed one does not repeat its first point."""

    points: np.ndarray
    closed: bool = False


def line(start, end, count=2000):
    share = np.linspace(0, 1, count)[:, None]
    return Curve((1 - share) * np.array(start, float) + share * np.array(end, float))


def circle(center, radius, tilt=0.4, count=4000):
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    u, v = np.array([1.0, 0, 0]), np.array([0, np.cos(tilt), np.sin(tilt)])
    ring = np.outer(np.cos(angles), u) + np.outer(np.sin(angles), v)
    return Curve(np.asarray(center, float) + radius * ring, closed=True)


def helix(count=3000):
    t = np.linspace(0, 1.5 * np.pi, count)
    return Curve(np.column_stack([0.7 * np.cos(t) - 1.2, 0.25 * t - 0.7, 0.7 * np.sin(t)]))


def graph_of(view, curves, noise_px=0.0, rng=None):
    """The edge graph of one view: each curve a polyline of points about 1 px apart."""
    chains = []
    for curve in curves:
        undistorted, depths = view.project_undistorted(curve.points)
        assert np.all(depths > 0)
        steps = np.linalg.norm(np.diff(undistorted, axis=0), axis=1)
        arc = np.concatenate([[0], np.cumsum(steps)])
        wanted = np.linspace(0, arc[-1], max(int(arc[-1]), 2))
        chain = np.column_stack([np.interp(wanted, arc, undistorted[:, k]) for k in range(2)])
        chains.append(chain)
    undistorted = np.concatenate([np.zeros((0, 2)), *chains])
    normals = np.concatenate([np.zeros((0, 2)), *(left_of(chain) for chain in chains)])
    if noise_px:
        undistorted = undistorted + rng.normal(scale=noise_px, size=undistorted.shape)
    return known.bare_graph(
        view.image_from_undistorted(undistorted),
        [len(chain) for chain in chains],
        [curve.closed for curve in curves],
        undistorted=undistorted,
        normals=normals,
    )


def left_of(chain):
    """(N, 2) unit normals to the left of a chain: its curve is bright on that side in all views."""
    tangents = np.gradient(chain, axis=0)
    return tangents[:, ::-1] * (-1, 1) / np.linalg.norm(tangents, axis=1, keepdims=True)


def distances_to_curves(points, curves):
    """(N,) distance of points to the nearest of the dense curves."""
    samples = np.concatenate([curve.points for curve in curves])
    from scipy.spatial import cKDTree

    return cKDTree(samples).query(points)[0]
