"""Outlines of a plain cylinder: depths, radii and normals from the chains of views around it."""

from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest
from curves import model_of
from plain_rooms import upright_view

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.edges3d.chains import envelopes
from colmap_edges.kernels import _kernels
from colmap_edges.options import PipelineOptions

RADIUS, DISTANCE, FOCAL = 0.3, 2.0, 600.0
HEIGHTS = np.linspace(-0.5, 0.5, 301)


def pose_at(angle):
    """Rotation and translation of a camera that looks at the cylinder's axis from an angle."""
    forward = -np.array([np.cos(angle), np.sin(angle), 0])
    down = np.array([0.0, 0.0, -1.0])
    rotation = np.array([np.cross(down, forward), down, forward])
    return rotation, rotation @ (DISTANCE * forward)


def rulings(angle, radius):
    """(2, N, 3) points at which the rays of that camera touch an upright cylinder, left and right.

    With radius 0 both are its axis.
    """
    turn = np.arccos(radius / DISTANCE)
    return np.array(
        [
            np.column_stack(
                [
                    np.full(len(HEIGHTS), radius * np.cos(angle + side * turn)),
                    np.full(len(HEIGHTS), radius * np.sin(angle + side * turn)),
                    HEIGHTS,
                ]
            )
            for side in (-1, 1)
        ]
    )


def index_of(angle, radius, dark_inside):
    """The search index of a view's chains, with the points that they show."""
    rotation, translation = pose_at(angle)
    points = rulings(angle, radius)[: 2 if radius else 1]
    local = points.reshape(-1, 3) @ rotation.T + translation
    pixels = FOCAL * local[:, :2] / local[:, 2:]
    out = np.where(pixels[:, :1] < 0, [-1.0, 0.0], [1.0, 0.0]) * (1 if dark_inside else -1)
    sides = np.tile(np.array([[60, 140]], np.uint8), (len(pixels), 1))
    offsets = np.arange(len(points) + 1) * len(HEIGHTS)
    index = _kernels.EdgeIndex(
        pixels.astype(np.float32),
        out.astype(np.float32),
        sides,
        offsets,
        np.zeros(len(points), bool),
        rotation,
        translation,
        FOCAL,
    )
    return SimpleNamespace(
        index=index, points=points.reshape(-1, 3), local=local, pixels=pixels, out=out
    )


def outlines(angles_deg, radius=RADIUS, dark_inside=True):
    """Outlines in the view at angle 0, with neighbours at (N,) angles; and this view."""
    own = index_of(0.0, radius, dark_inside)
    neighbors = [index_of(np.radians(a), radius, dark_inside) for a in angles_deg]
    # Other views show the points near the ends of the chains beyond the ends of their own.
    inner = np.arange(32, len(HEIGHTS) - 32, 8)
    count = len(own.points) // len(HEIGHTS)
    samples = (np.arange(count)[:, None] * len(HEIGHTS) + inner).ravel()
    offsets = np.arange(count + 1) * len(inner)
    columns, supports = _kernels.envelopes(
        own.index,
        [each.index for each in neighbors],
        samples,
        offsets,
        np.tile([0.3, 1.0], (len(samples), 1)),
        max_disagreement_px=1.2,
        side_likelihoods=np.ones((256, 256), np.float32),
        min_angle_sin=0.09,
        visibility_rate=0.5,
        detection_rate=0.8,
        min_log_likelihood_ratio=3.0,
        break_penalty=4.0,
        max_clusters=6,
        num_threads=1,
    )
    return columns, supports, own, samples


@pytest.mark.parametrize("dark_inside", [True, False])
def test_depth_and_radius_of_a_cylinder(dark_inside):
    columns, supports, own, samples = outlines([-30, -20, -10, 10, 20, 30], RADIUS, dark_inside)
    depths = own.local[samples, 2]
    assert (supports[0] == 6).all()
    np.testing.assert_allclose(1 / columns[0], depths, rtol=2e-3)
    # A section by an epipolar plane is an ellipse, but a circle where the plane is level.
    level = np.abs(own.points[samples, 2]) < 0.1
    radii = columns[1] * depths
    expected = RADIUS if dark_inside else -RADIUS
    np.testing.assert_allclose(radii[level], expected, rtol=0.03)


def test_a_fixed_edge_is_no_outline():
    columns, supports, _, _ = outlines([-30, -20, -10, 10, 20, 30], radius=0)
    _, radii, sigmas = columns[:3]
    assert (envelopes.find_runs(radii, sigmas, *supports) < 0).all()


def test_deviations_are_those_of_least_squares():
    """Against lines of inverse depth over radius, from triangulation in numpy."""
    columns, _, own, samples = outlines([-25, -12, 12, 25])
    row = int(np.argmin(np.abs(own.points[samples, 2])))
    point, ray = own.points[samples[row]], own.local[samples[row]] / own.local[samples[row], 2]
    rotation, translation = pose_at(0.0)
    center = -rotation.T @ translation
    direction = ray @ rotation
    normal = own.points[samples[row]] * (1, 1, 0) / RADIUS
    rows = []
    for angle in np.radians([-25, -12, 12, 25]):
        turned, moved = pose_at(angle)
        other = -turned.T @ moved
        baseline = other - center
        out = baseline - baseline @ direction / (direction @ direction) * direction
        out *= np.sign(out @ normal) / np.linalg.norm(out)
        around = np.cross(direction, out)

        def seen_from(depth, other=other, turned=turned, moved=moved, baseline=baseline):
            """Pixels of a point of the ray."""
            local = turned @ (center + depth * direction) + moved
            return FOCAL * local[:2] / local[2]

        depth = own.local[samples[row], 2]
        speed = np.linalg.norm(seen_from(1 / (1 / depth + 1e-6)) - seen_from(depth)) / 1e-6
        tangent = rulings(angle, RADIUS)[0 if normal[1] < 0 else 1]
        nearest = tangent[np.argmin(np.abs((tangent - center) @ around))] - other
        other_out = np.cross(around, nearest)
        other_out /= np.linalg.norm(other_out)
        slope = (out @ normal) * (1 - other_out @ out) / (other_out @ baseline)
        rows.append((1 / speed, slope))
    sigmas, slopes = np.array(rows).T
    design = np.column_stack([np.ones(4), -slopes]) / sigmas[:, None]
    expected = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    np.testing.assert_allclose(columns[[2, 3], row], expected, rtol=0.05)
    assert point[2] == pytest.approx(0, abs=0.05)


def test_runs_end_where_radii_change():
    radii = np.r_[np.full(6, 0.1), np.full(6, 0.2), np.full(3, 0.21), 0.0, np.full(4, 0.1)]
    sigmas, supports = np.full(20, 0.01), np.full(20, 4)
    runs = envelopes.find_runs(radii, sigmas, supports, np.ones(20, np.int32))
    assert [len(run) for run in np.split(runs, np.flatnonzero(np.diff(runs)) + 1)] == [6, 9, 5]
    assert (runs[15:] == -1).all()
    assert (envelopes.find_runs(radii, 20 * sigmas, supports, np.ones(20, np.int32)) == -1).all()


def test_normals_point_out_of_the_body():
    for dark_inside in (True, False):
        columns, _, own, samples = outlines([-20, -10, 10, 20], RADIUS, dark_inside)
        tangents = np.tile([0.0, 1.0], (len(samples), 1))
        normals = envelopes.normals_of(
            FOCAL, own.pixels[samples], tangents, own.out[samples], columns[1]
        )
        true = own.points[samples] * (1, 1, 0) / RADIUS
        np.testing.assert_allclose(normals @ pose_at(0.0)[0], true, atol=1e-6)


def test_outlines_are_seen_by_frontal_views_without_anything_in_between():
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[600, 600, 320, 240])
    views = [upright_view(i, camera, *of) for i, of in enumerate(looks())]
    points = np.column_stack([np.zeros(5), np.zeros(5), np.linspace(-0.1, 0.1, 5)])
    found = envelopes.Envelopes(
        points=points,
        normals=np.tile([0.0, -1, 0], (5, 1)),
        views=np.full(5, 0),
        colors=np.zeros((5, 3), np.uint8),
        lengths=np.array([5]),
    )
    others = [np.arange(len(views))] * len(views)
    options = PipelineOptions()
    model, edges = model_of(views), Edges3D.none()
    seen = envelopes.seen_outlines(found, edges, model, others, options, 1)
    # Views 1, 2 and 3 face the points; 0 touches the body, 4 is behind it.
    assert seen.track_views.reshape(5, -1).tolist() == [[2, 1, 3]] * 5
    np.testing.assert_allclose(seen.sigmas, 0.5 * 2 / 600)
    # An edge before the points hides them from view 2.
    step = np.linspace(-0.2, 0.2, 81)
    wall = np.column_stack([np.zeros(81), np.full(81, -1.0), step])
    observed = Observations.of_pixels(np.arange(82), np.full(81, 2, np.int32), np.zeros((81, 2)))
    edges = Edges3D.of_polylines(wall, np.array([81]), observed)
    seen = envelopes.seen_outlines(found, edges, model, others, options, 1)
    assert seen.track_views.reshape(5, -1).tolist() == [[1, 3]] * 5


def looks():
    """Centres and directions of views of the origin from 2 units away, by angle to -y."""
    for degrees in (90, 35, 0, -40, 180):
        angle = np.radians(degrees)
        center = 2 * np.array([np.sin(angle), -np.cos(angle), 0])
        yield center, -center
