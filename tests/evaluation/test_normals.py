"""Normals of meshes and depth maps, against analytic planes and spheres."""

import numpy as np
import pycolmap
import pytest
from curves import make_view

from colmap_edges.evaluation import tables
from colmap_edges.evaluation.metrics import depth, normals
from colmap_edges.evaluation.metrics.raycasting import RayCaster

WIDTH, HEIGHT = 80, 60


@pytest.fixture
def view():
    """A camera at the origin that looks along z."""
    camera = pycolmap.Camera.create_from_model_name(1, "PINHOLE", 100.0, WIDTH, HEIGHT)
    return make_view(np.eye(3), np.zeros(3), camera=camera)


def plane(tilt_deg, low=-80.0, flipped=False):
    """The plane through (0, 0, 100), turned about the y axis, where x is above `low`."""
    slope = np.tan(np.radians(tilt_deg))
    corners = np.array([(x, y, 100 + slope * x) for x, y in ((low, -80), (80, -80), (80, 80),
                                                             (low, 80))])  # fmt: skip
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    return RayCaster(corners, faces[:, ::-1] if flipped else faces)


def sphere_depth(radius=30.0, distance=100.0):
    """Depths of a sphere before the camera, 0 beside it, and its outward normals."""
    rows, columns = np.indices((HEIGHT, WIDTH)) + 0.5
    rays = np.dstack([(columns - WIDTH / 2) / 100, (rows - HEIGHT / 2) / 100, np.ones_like(rows)])
    a, b = (rays**2).sum(axis=2), distance
    root = b**2 - a * (distance**2 - radius**2)
    found = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0)
    return found, (rays * found[..., None] - (0, 0, distance)) / radius


@pytest.mark.parametrize(
    ("tilt", "within_10", "within_30"), [(0, 1, 1), (9.9, 1, 1), (10.1, 0, 1), (40, 0, 0)]
)
@pytest.mark.parametrize("flipped", [False, True])
def test_angle_of_a_tilted_plane(view, tilt, within_10, within_30, flipped):
    reference = depth.render_reference(plane(0), view)
    record = depth.depth_errors(plane(tilt, flipped=flipped), reference).record()
    assert record["normals_median_deg"] == pytest.approx(tilt, abs=1e-6)
    found = record["normals_10_deg"], record["normals_30_deg"]
    # Embree 3 misses rays along the diagonal between the two triangles.
    assert found == pytest.approx((within_10, within_30), abs=2e-3)


def test_holes_count_as_wrong_normals(view):
    reference = depth.render_reference(plane(0), view)
    record = depth.depth_errors(plane(5, low=0.0), reference).record()
    assert record["coverage"] == 0.5
    assert record["normals_median_deg"] == pytest.approx(5, abs=1e-6)  # where there is a mesh
    assert (record["normals_10_deg"], record["normals_30_deg"]) == (0.5, 0.5)


def test_normals_of_depth_are_those_of_the_mesh(view):
    rendered = depth.render_reference(plane(35), view)
    read = depth.ReferenceDepth(view=view, depth=rendered.depth, scale=1.0)
    assert np.isnan(read.normals[[0, -1]]).all()
    assert np.isnan(read.normals[:, [0, -1]]).all()
    inner = np.s_[1:-1, 1:-1]
    angles = normals.angles_deg(read.normals[inner], rendered.normals[inner])
    assert angles.max() < 0.01
    record = depth.depth_errors(plane(35), read).record()
    assert record["normals_10_deg"] == 1  # the border, whose normals are unknown, does not count


def test_normals_of_depth_have_none_across_steps_and_creases(view):
    wall, ramp = (depth.render_reference(plane(tilt), view).depth for tilt in (0, 60))
    for right in (wall / 2, ramp):
        joint = np.where(np.arange(WIDTH) < 40, wall, right)
        found = depth.ReferenceDepth(view=view, depth=joint, scale=1.0).normals
        assert np.isnan(found[:, 39:41]).all()
        assert np.isfinite(found[1:-1, 1:39]).all()
        np.testing.assert_allclose(found[30, 10], (0, 0, -1), atol=1e-4)


def test_normals_of_depth_on_a_sphere_point_outwards(view):
    found, outward = sphere_depth()
    reference = depth.ReferenceDepth(view=view, depth=found.astype(np.float32), scale=1.0)
    known = np.isfinite(reference.normals[..., 0])
    assert known.sum() > 0.5 * reference.known.sum()
    assert normals.angles_deg(reference.normals[known], outward[known]).max() < 1


def test_rounded_depths_give_normals_over_more_pixels(view):
    rendered = depth.render_reference(plane(35), view)
    rounded = rendered.depth.astype(np.float16).astype(np.float32)
    reference = depth.ReferenceDepth(view=view, depth=rounded, scale=1.0)
    known = np.isfinite(reference.normals[..., 0])
    angles = normals.angles_deg(reference.normals[known], rendered.normals[known])
    assert np.median(angles) < 1


def test_noisy_depth_and_clouds_have_no_normals(view):
    rendered = depth.render_reference(plane(0), view).depth
    noise = 1 + 0.005 * np.random.default_rng(0).standard_normal(rendered.shape)
    noisy = depth.ReferenceDepth(view=view, depth=np.float32(rendered * noise), scale=1.0)
    cloud = depth.cloud_depth(np.random.default_rng(0).uniform(-20, 20, (500, 3)) + 60, view)
    assert noisy.normals is None
    assert cloud.normals is None
    record = depth.depth_errors(plane(0), noisy).record()
    assert "normals_10_deg" not in record
    assert "normals" not in tables.error_table("depth error", {"all views": record})


def test_tables_show_normals(view):
    record = depth.depth_errors(plane(5), depth.render_reference(plane(0), view)).record()
    text = tables.error_table("depth error", {"all views": record})
    assert "normals: median ° | normals within 10° | within 30° |" in text
    assert text.endswith("| 5 | 1 | 1 |")
