"""The ground on which a plain can stands is not continued over the can, which has no plane."""

from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from plain_rooms import model_of, render, upright_view

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.surfaces.faces.decision import points_of_samples
from colmap_edges.surfaces.faces.evidence import gather_evidence
from colmap_edges.surfaces.faces.finding import label_scene
from colmap_edges.surfaces.faces.grids import halved, make_grid
from colmap_edges.surfaces.faces.hypotheses import find_planes
from colmap_edges.surfaces.faces.labelling import EvidenceWeights

RADIUS, HEIGHT = 0.7, 1.1
LINES = np.arange(-3, 3.1, 0.3)  # of the tiles on the ground


def views_around():
    """Views of the can from a circle above the ground."""
    camera = pycolmap.Camera(model="PINHOLE", width=160, height=120, params=[150, 150, 80, 60])
    views = []
    for i, angle in enumerate(np.linspace(0, 2 * np.pi, 16, endpoint=False)):
        center = np.array([4 * np.cos(angle), 4 * np.sin(angle), 2.6 + 0.5 * (i % 2)])
        views.append(upright_view(i, camera, center, np.array([0, 0, 0.3]) - center))
    return tuple(views)


def cast(center, directions):
    """How far (N, 3) directions go, in their lengths, until the ground or the can, and its gray."""
    ground = np.where(directions[:, 2] < 0, -center[2] / np.minimum(directions[:, 2], -1e-12), 1e9)
    at = center + ground[:, None] * directions
    dark = (np.abs(at[:, :2, None] - LINES).min(axis=2) < 0.03).any(axis=1)
    gray = np.where(dark & (np.abs(at[:, :2]).max(axis=1) < 3.03), 50, 120)
    lid = (HEIGHT - center[2]) / np.minimum(directions[:, 2], -1e-12)
    over = np.linalg.norm((center + lid[:, None] * directions)[:, :2], axis=1) < RADIUS
    a = (directions[:, :2] ** 2).sum(axis=1)
    b = directions[:, :2] @ center[:2]
    root = b**2 - a * (center[:2] @ center[:2] - RADIUS**2)
    side = (-b - np.sqrt(np.maximum(root, 0))) / a
    height = center[2] + side * directions[:, 2]
    beside = (root > 0) & (height > 0) & (height < HEIGHT)
    far = np.where(over, np.minimum(lid, ground), np.where(beside, side, ground))
    return far, np.where(over, 200, np.where(beside, 165, gray))


def polylines():
    """Points of the tiles' borders, and of the can's base and rim."""
    steps = np.arange(-3, 3, 0.04)
    for line in LINES:
        yield np.column_stack([steps, np.full(len(steps), line), np.zeros(len(steps))])
        yield np.column_stack([np.full(len(steps), line), steps, np.zeros(len(steps))])
    angles = np.linspace(0, 2 * np.pi, 110)
    for height in (0, HEIGHT):
        circle = RADIUS * np.column_stack([np.cos(angles), np.sin(angles)])
        yield np.column_stack([circle, np.full(len(angles), height)])


def edges_seen_by(views):
    """The edges with the views that see them; those within the can are left out."""
    points, lengths, rows, tracks = [], [], [], [0]
    for at in polylines():
        sees = []
        for view in views:
            pixels, depths = view.project(at)
            far, _ = cast(view.center, at - view.center)
            sees.append(view.holds(pixels, depths) & (far > 0.995))
        kept = np.sum(sees, axis=0) >= 3
        points.append(at[kept]), lengths.append(kept.sum())
        for column in np.flatnonzero(kept):
            rows.append(np.flatnonzero(np.array(sees)[:, column]))
            tracks.append(tracks[-1] + len(rows[-1]))
    seen_by = np.concatenate(rows).astype(np.int32)
    pixels = np.zeros((len(seen_by), 2))
    observations = Observations.of_pixels(np.array(tracks, np.int64), seen_by, pixels)
    return Edges3D.of_polylines(np.concatenate(points), np.array(lengths), observations)


@pytest.fixture(scope="module")
def can():
    views = views_around()
    pictures = [halved(make_grid(view, render(view, cast))) for view in views]
    return SimpleNamespace(
        views=views, model=model_of(views), edges=edges_seen_by(views), pictures=pictures
    )


def are_seen(view, points):
    """(N,) whether nothing stands between a view and (N, 3) points."""
    far, _ = cast(view.center, points - view.center)
    return far > 0.97


def labelled(can, num_rounds, weights):
    """The labels of all views, with planes found from the edges."""
    evidence = gather_evidence(can.model, can.edges)
    planes = find_planes(evidence, can.model.camera_centers, np.random.default_rng(0))
    return label_scene(can.model, can.pictures, (), 1, evidence, planes, num_rounds, weights)


def share_behind(can, points, views):
    """Share of (N, 3) points that the can hides in the (N,) views."""
    hidden = [~are_seen(view, points[views == v]) for v, view in enumerate(can.views)]
    return np.concatenate(hidden).mean()


def test_points_that_a_view_misses_end_the_ground_at_the_can(can):
    weights = EvidenceWeights(correlation=0.0)
    shares = []
    for each in (weights._replace(missed=0.0), weights):
        samples = labelled(can, 1, each).samples
        own = samples.views[samples.offsets[:-1]]
        shares.append(share_behind(can, samples.points, own))
    assert shares[1] < 0.4 * shares[0]


def test_few_rays_to_faces_pass_through_the_can(can):
    found = labelled(can, 2, EvidenceWeights())
    assert len(found.accepted) > 10_000
    chosen = found.chosen()
    seen = points_of_samples(found.samples, chosen, can.views, can.pictures)
    points = np.repeat(seen.points, np.diff(seen.track_offsets), axis=0)
    assert share_behind(can, points, seen.track_views) < 0.005
