"""Edges sampled from known curves, with noise."""

from dataclasses import replace

import numpy as np

from colmap_edges.core.edges3d import Edges3D


def edges_of(polylines, closed=None, sigma=1e-3, seed=0):
    """Edges of exact (n, 3) polylines, with normal noise of `sigma`, and none where it is 0."""
    random = np.random.default_rng(seed)
    counts = [len(polyline) for polyline in polylines]
    points = np.concatenate(polylines)
    points = points + sigma * random.normal(size=points.shape)
    edges = Edges3D.of_polylines(points, np.array(counts))
    return replace(
        edges,
        closed=np.array(closed if closed is not None else edges.closed),
        sigmas=np.full(len(points), sigma if sigma else np.nan),
        colors=np.full((len(points), 3), 128, np.uint8),
    )


def frame(seed):
    """A random rotation, whose rows are axes."""
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return q * np.sign(np.linalg.det(q))


def segment(start, end, count):
    """(count, 3) points from one to the other."""
    return np.linspace(start, end, count)


def arc(center, axes, radii, start_deg, end_deg, count):
    """(count, 3) points of an ellipse around a centre, on the first two axes."""
    t = np.radians(np.linspace(start_deg, end_deg, count))
    return (
        center + radii[0] * np.outer(np.cos(t), axes[0]) + radii[1] * np.outer(np.sin(t), axes[1])
    )


def shapes_of_each_kind():
    """Name, polyline, and whether it is closed, of a curve of each kind."""
    t = np.linspace(-1, 1, 90)
    return [
        ("line", segment((0, 0, 0), (1, 2, -1), 40), False),
        ("arc", arc(np.ones(3), frame(1), (0.5, 0.5), 20, 170, 50), False),
        ("circle", arc(np.ones(3), frame(2), (0.4, 0.4), 0, 354, 60), True),
        ("elliptic_arc", arc(np.zeros(3), frame(3), (0.9, 0.5), 10, 250, 80), False),
        ("ellipse", arc(np.zeros(3), frame(4), (0.8, 0.5), 0, 356, 90), True),
        ("spline", np.column_stack([t, 0.4 * t**2, 0.5 * t**3]), False),
    ]


def one_of_each_kind():
    """An edge of each kind."""
    _, polylines, closed = zip(*shapes_of_each_kind(), strict=True)
    return edges_of(polylines, closed)


def rounded_rectangle(width, height, radius, step):
    """Points about `step` apart on four lines and four arcs, in the plane z = 0, closed."""
    corners = [(width, 0, -90), (width, height, 0), (0, height, 90), (0, 0, 180)]
    points = []
    for x, y, angle in corners:
        turns = np.radians(np.linspace(angle, angle + 90, max(4, round(radius * 1.57 / step))))
        points.append(np.column_stack([x + radius * np.cos(turns), y + radius * np.sin(turns)]))
    outline = np.concatenate([*points, points[0][:1]])
    lengths = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(outline, axis=0), axis=1))])
    places = np.arange(0, lengths[-1] - step / 2, step)
    plane = [np.interp(places, lengths, column) for column in outline.T]
    return np.column_stack([*plane, np.zeros(len(places))])


def lines_around(count=30):
    """Straight edges far away, from which the noise is learned."""
    random = np.random.default_rng(7)
    starts, ends = 50 + random.normal(size=(2, count, 3))
    return [segment(a, b, 25) for a, b in zip(starts, ends, strict=True)]
