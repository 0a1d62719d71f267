"""Dense clouds: their views, displacement, noise and thinning, and meshes of them with edges."""

from __future__ import annotations

from dataclasses import replace

import dense_clouds as clouds
import numpy as np
import pytest
from scenes import true_edges
from scipy.spatial import cKDTree

import colmap_edges
from colmap_edges.colmap.clouds import CloudFile, SeenRows, image_names
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import DenseOptions
from colmap_edges.surfaces.dense.cloud import dense_cloud
from colmap_edges.surfaces.dense.displacement import measured_shift, movements
from colmap_edges.surfaces.dense.planes import planes_at
from colmap_edges.surfaces.dense.seeing import by_depth_test

ALL = DenseOptions(max_proj_dist=0)


@pytest.fixture(scope="module")
def solid(scene_model):
    """Points on the solids, their normals, and their views as arrays."""
    points, normals, tracks = clouds.on_solids(scene_model, 0.02)
    offsets = np.cumsum([0, *map(len, tracks)])
    return SeenPoints(points, offsets, np.concatenate(tracks).astype(np.int32)), normals


def prepared(model, seen, points, options=ALL):
    """The cloud of points with the views of others, whose indices are those of the model."""
    names = [view.name for view in model.views]
    rows = SeenRows(seen.track_offsets, seen.track_views.astype(np.int64))
    file = CloudFile(points, np.full(points.shape, 7, np.uint8), rows)
    return dense_cloud(file, model, names, options, 1)


def test_noise_is_measured_and_averaged(scene_model, solid):
    seen, normals = solid
    noise = np.random.default_rng(0).normal(0, 0.004, len(normals))
    cloud = prepared(scene_model, seen, seen.points + noise[:, None] * normals)
    assert 0.0035 < np.median(cloud.sigmas) < 0.0045
    off = np.einsum("ni,ni->n", cloud.points.points - seen.points, normals)
    assert np.median(np.abs(off)) < 0.5 * np.median(np.abs(noise))


def test_planes_do_not_bend_at_points_of_another_surface():
    rng = np.random.default_rng(1)
    group = np.column_stack([rng.uniform(-1, 1, (24, 2)), rng.normal(0, 0.01, 24)])
    group[:4] = rng.uniform((0.8, -1, 0), (1, 1, 1), (4, 3))  # of a wall beside the floor
    planes = planes_at(group[None])
    assert abs(planes.normals[0, 2]) > 0.99


def test_a_cloud_of_shifted_images_is_moved_back(scene_model, solid):
    seen, normals = solid
    shift = np.array([0.8, -1.1])
    shifted = seen.points - movements(seen, scene_model) @ shift
    found = measured_shift(seen._replace(points=shifted), cKDTree(shifted), scene_model)
    assert np.abs(found - shift).max() < 0.25
    cloud = prepared(scene_model, seen, shifted)
    before, after = (
        np.median(np.abs(np.einsum("ni,ni->n", at - seen.points, normals)))
        for at in (shifted, cloud.points.points)
    )
    assert after < 0.4 * before


def test_a_cloud_that_fits_is_not_moved(scene_model, solid):
    seen, normals = solid
    noise = np.random.default_rng(2).normal(0, 0.004, len(normals))
    assert not prepared(scene_model, seen, seen.points + noise[:, None] * normals).shift_px.any()


def test_thinned_points_are_as_far_apart_as_wanted(scene_model, solid):
    seen, _ = solid
    few = prepared(scene_model, seen, seen.points, DenseOptions(max_proj_dist=20))
    assert 0 < len(few.points.points) < 0.2 * len(seen.points)
    assert len(prepared(scene_model, seen, seen.points).points.points) == len(seen.points)
    nearest = cKDTree(few.points.points).query(seen.points)[0]
    assert (nearest < 2 * 20 * np.median(few.pixels)).all()


def test_points_near_edges_and_faces_yield(scene, scene_model, solid):
    seen, _ = solid
    cloud, edges = prepared(scene_model, seen, seen.points), true_edges(scene_model, scene)
    cloud = replace(cloud, edge_dist=5.0)
    left = cloud.away_from([edges], np.zeros((0, 3)))
    distances = scene.distances(left.points.points)
    assert (distances > 4.5 * left.pixels).all()
    assert 0 < len(distances) < len(seen.points)
    far = scene.distances(seen.points) > 6 * cloud.pixels
    assert len(distances) >= np.count_nonzero(far)
    assert not len(cloud.away_from([], seen.points).points.points)


def test_the_depth_test_finds_the_views_that_see_a_point(scene_model, solid):
    seen, _ = solid
    found = by_depth_test(seen.points, scene_model)
    count = len(scene_model.views)
    true, ours = (
        np.repeat(np.arange(len(seen.points)), np.diff(of.track_offsets)) * count + of.track_views
        for of in (seen, found)
    )
    common = len(np.intersect1d(true, ours))
    assert common > 0.8 * len(true)  # the solids hide parts of each other
    assert common > 0.8 * len(ours)


def test_meshes_of_clouds_follow_edges(scene, scene_model, scene_paths, solid):
    pytest.importorskip("colmap_edges._mesher", reason="the CGAL extension is not built")
    seen, normals = solid
    noise = np.random.default_rng(3).normal(0, 0.01, len(normals))
    points = seen.points + noise[:, None] * normals
    order = {name: at for at, name in enumerate(image_names(scene_model.reconstruction))}
    numbers = np.array([order[view.name] for view in scene_model.views])
    rows = SeenRows(seen.track_offsets, numbers[seen.track_views])
    edges = true_edges(scene_model, scene)
    alone = colmap_edges.mesh(scene_paths[1], points=points, visibility=rows)
    sharp = colmap_edges.mesh(scene_paths[1], edges, points=points, visibility=rows)
    assert len(alone.faces) > 1000
    missed = [
        np.mean(cKDTree(mesh.vertices).query(edges.points)[0] > 0.002) for mesh in (alone, sharp)
    ]
    assert missed[0] > 0.8
    assert missed[1] < 0.5 * missed[0]
    assert set(alone.point3D_ids) <= {-1, *scene_model.point3D_ids.tolist()}


def test_visibility_of_another_model_is_refused(scene_model, solid):
    seen, _ = solid
    turned = np.roll(np.arange(len(scene_model.views)), len(scene_model.views) // 2)
    wrong = seen._replace(track_views=turned[seen.track_views].astype(np.int32))
    far = seen.points + np.array([5.0, 0, 0])
    with pytest.raises(ColmapEdgesError, match="give the model that the cloud was made from"):
        prepared(scene_model, wrong, far)
    more = seen._replace(track_views=seen.track_views + len(scene_model.views))
    with pytest.raises(ColmapEdgesError, match="names image"):
        prepared(scene_model, more, seen.points)
    with pytest.raises(ColmapEdgesError, match="no image sees"):
        prepared(scene_model, seen, np.full_like(seen.points, np.nan))


def test_arguments_of_another_kind_are_refused(scene_paths):
    with pytest.raises(ColmapEdgesError, match="visibility is given without points"):
        colmap_edges.mesh(scene_paths[1], visibility="fused.ply.vis")
    with pytest.raises(ColmapEdgesError, match="points must be a PLY file or an array"):
        colmap_edges.mesh(scene_paths[1], points=[1, 2, 3])
    rows = SeenRows(np.zeros(3, np.int64), np.zeros(0, np.int64))
    with pytest.raises(ColmapEdgesError, match="is of 2 points, but the cloud has 30"):
        colmap_edges.mesh(scene_paths[1], points=np.zeros((30, 3)), visibility=rows)
