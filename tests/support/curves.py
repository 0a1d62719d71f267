"""Views and edge graphs without images: known 3D curves projected densely and without noise.

Every curve has its bright side on one side of its direction in every view, as an edge between
two surfaces has for all views of the same side.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
import scenes

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import ChainObservations, Observations
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges3d.chains.tracing_input import TracingInput, make_input
from colmap_edges.edges3d.chains.view_selection import Neighborhood

WIDTH, HEIGHT, FOCAL = 640, 480, 600.0


def make_view(rotation, translation, index=0, camera=None) -> View:
    """A view of a pinhole camera, or of the one given."""
    if camera is None:
        camera = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", FOCAL, WIDTH, HEIGHT)
    return View(
        image_id=index + 1,
        name=f"view_{index:03d}.png",
        width=camera.width,
        height=camera.height,
        camera=camera,
        rotation=np.asarray(rotation, float),
        translation=np.asarray(translation, float),
    )


def looking(center, target=(0, 0, 0), index=0, roll=0.0) -> View:
    """A view at `center` that looks at `target`; not straight up or down."""
    return make_view(*scenes.look_at(np.array(center, float), np.array(target, float), roll), index)


def ring(count, radius=4.0, heights=(2.5, 3.5), arc_deg=120.0) -> tuple[View, ...]:
    """Views on an arc around the origin, above the plane z = 0, that look at the origin."""
    angles = np.radians(np.linspace(-arc_deg / 2, arc_deg / 2, count))
    return tuple(
        looking(
            (radius * np.sin(a), -radius * np.cos(a), heights[i % len(heights)]),
            index=i,
            roll=0.05 * (i % 3 - 1),
        )
        for i, a in enumerate(angles)
    )


def row(count, step=0.4, depth=5.0) -> tuple[View, ...]:
    """Views side by side along x, all looking along +z, `depth` before the plane z = 0."""
    return tuple(make_view(np.eye(3), (-step * i, 0, depth), i) for i in range(count))


def line(start, end):
    """A straight curve as a function of (N,) parameters in [0, 1]."""
    start, end = np.array(start, float), np.array(end, float)
    return lambda t: start + np.asarray(t)[:, None] * (end - start)


def circle(center, radius, u=(1, 0, 0), v=(0, 1, 0)):
    """A circle in the plane of the orthonormal u and v."""
    center, u, v = (np.array(x, float) for x in (center, u, v))

    def at(t):
        angle = 2 * np.pi * np.asarray(t)[:, None]
        return center + radius * (np.cos(angle) * u + np.sin(angle) * v)

    return at


def is_closed(curve) -> bool:
    start, end = curve(np.array([0.0, 1.0]))
    return bool(np.allclose(start, end))


def dense_parameters(view, curve, spacing_px=1.0):
    """Parameters of points on the curve about `spacing_px` apart in the view."""
    t = np.linspace(0, 1, 4001)
    pixels, depths = view.project_undistorted(curve(t))
    assert (depths > 0).all(), "the curve must lie in front of the view"
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(pixels, axis=0), axis=1))])
    count = int(along[-1] / spacing_px) + 1
    closed = is_closed(curve)
    at = np.linspace(0, along[-1], count + 1, endpoint=not closed)
    return np.interp(at, along, t)


def graph_of(view, curves, sides=None) -> EdgeGraph:
    """The edge graph of known curves; `sides` +1 or -1 each, where each is bright."""
    sides = [1] * len(curves) if sides is None else sides
    undistorted, normals, lengths, closed = [], [], [], []
    for curve, side in zip(curves, sides, strict=True):
        t = dense_parameters(view, curve)
        pixels, _ = view.project_undistorted(curve(t))
        ahead, _ = view.project_undistorted(curve(t + 1e-6))
        behind, _ = view.project_undistorted(curve(t - 1e-6))
        tangent = ahead - behind
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        undistorted.append(pixels)
        normals.append(side * np.column_stack([-tangent[:, 1], tangent[:, 0]]))
        lengths.append(len(t))
        closed.append(is_closed(curve))
    return graph_from_undistorted(view, undistorted, normals, closed)


def graph_from_undistorted(view, undistorted, normals, closed) -> EdgeGraph:
    """An edge graph of polylines given in undistorted pixels; no two of them touch."""
    offsets = offsets_of(np.array([len(part) for part in undistorted], np.int64))
    joined = np.concatenate([np.zeros((0, 2)), *undistorted])
    points = view.image_from_undistorted(joined)
    return bare_graph(
        points,
        np.diff(offsets),
        closed,
        undistorted=joined,
        normals=np.concatenate([np.zeros((0, 2)), *normals]),
        sides=np.tile(np.array([[60, 180]], np.uint8), (len(points), 1)),
    )


def bare_graph(points, lengths, closed=False, **arrays) -> EdgeGraph:
    """A graph of polylines of so many points."""
    count, offsets = len(lengths), offsets_of(np.array(lengths, np.int64))
    plain = {
        "points": points,
        "undistorted": points,
        "normals": np.zeros_like(points),
        "sides": np.zeros(points.shape, np.uint8),
        "colors": np.zeros((len(points), 3), np.uint8),
        "polyline_offsets": offsets,
        "closed": np.broadcast_to(closed, count).astype(bool),
    }
    return EdgeGraph(**plain | arrays)


def unplaced(offsets, views) -> Observations:
    """Observations by these views, at unknown positions."""
    nowhere = np.full(len(views), np.nan)
    found = ChainObservations(offsets=offsets, views=views, positions=nowhere)
    return Observations.of_positions(found)


def observed_edges(pieces, observing, sigmas=0.0, closed=False) -> Edges3D:
    """Edges of (n, 3) points, each observed by some views, at no known pixels."""
    points, lengths = np.concatenate(pieces), np.array([len(piece) for piece in pieces])
    observing = np.array(list(observing), np.int32)
    offsets = len(observing) * np.arange(len(points) + 1)
    return replace(
        Edges3D.of_polylines(points, lengths),
        observations=unplaced(offsets, np.tile(observing, len(points))),
        sigmas=np.repeat(np.full(len(pieces), sigmas), lengths),
        closed=np.full(len(pieces), closed),
    )


def model_of(views, points=None, observed=None) -> Model:
    """A model of views and (N, 3) points, each observed where (N, V) `observed` holds."""
    points = np.zeros((0, 3)) if points is None else np.reshape(points, (-1, 3)).astype(float)
    observed = np.ones((len(points), len(views)), bool) if observed is None else observed
    rows, columns = np.nonzero(observed)
    pixels = np.array(
        [views[v].project(points[r : r + 1])[0][0] for r, v in zip(rows, columns, strict=True)]
    )
    return Model(
        views=tuple(views),
        points3D_xyz=points,
        point3D_ids=np.arange(1, len(points) + 1),
        points3D_rgb=np.zeros((len(points), 3), np.uint8),
        track_offsets=offsets_of(observed.sum(axis=1)),
        track_views=columns.astype(np.int32),
        track_points2D=pixels.reshape(-1, 2),
        unposed_names=(),
        reconstruction=None,
    )


def tracing_input(views, graphs) -> TracingInput:
    """Views that are all compared with each other, with their graphs."""
    others = [np.delete(np.arange(len(views)), view) for view in range(len(views))]
    near = Neighborhood(
        neighbors=tuple(others),
        later_neighbors=tuple(others),
        observing_views=tuple(others),
        ranges=(),
    )
    return make_input(model_of(views), Graphs.of(graphs), near)
