from dataclasses import replace

import numpy as np
import pycolmap
import pytest
import scenes
from project import DEMO
from scipy.spatial.transform import Rotation

from colmap_edges.colmap.model import frames_of_views, model_from_reconstruction
from colmap_edges.colmap.writing import moved_model
from colmap_edges.core.edges3d import AdjustedPoses, Edges3D
from colmap_edges.core.polylines import curve_tangents
from colmap_edges.evaluation.metrics.poses import (
    TrueCameras,
    adjust_by_colmap,
    at_true_cameras,
    load_true_cameras,
    pose_errors,
    with_pose_noise,
)
from colmap_edges.options import BundleAdjustmentOptions, PipelineOptions, TracingOptions
from colmap_edges.pipeline.detect import detect_stage
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run
from colmap_edges.pipeline.trace import trace_stage
from colmap_edges.poses import problem as ba
from colmap_edges.poses.refine import enough_points, part_of, poses_of, refine_poses
from colmap_edges.poses.solver import adjust
from colmap_edges.runtime.stages import Stages

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

OPTIONS = BundleAdjustmentOptions()


def exact_model(model):
    """The model with its points observed where they project."""
    owners = np.repeat(np.arange(len(model.point3D_ids)), np.diff(model.track_offsets))
    pixels = np.zeros_like(model.track_points2D)
    for index, view in enumerate(model.views):
        rows = model.track_views == index
        pixels[rows] = view.project(model.points3D_xyz[owners[rows]])[0]
    return replace(model, track_points2D=pixels)


def normals_of(model, edges):
    """Normals of the projected edges at their points."""
    owners = np.repeat(np.arange(edges.num_points), np.diff(edges.observations.offsets))
    tangents = curve_tangents(edges.points, edges.edge_offsets)
    normals = np.zeros((len(owners), 2))
    for index, view in enumerate(model.views):
        rows = edges.observations.views == index
        points = edges.points[owners[rows]]
        ahead, behind = (
            view.project_undistorted(points + s * tangents[owners[rows]])[0] for s in (0.01, -0.01)
        )
        along = ahead - behind
        normals[rows] = np.column_stack([-along[:, 1], along[:, 0]])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def with_normals(edges, normals):
    return replace(edges, observations=replace(edges.observations, normals=normals))


def random_motions(count, turn, shift, seed=1):
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(turn * rng.normal(size=(count, 3))).as_matrix()
    return np.concatenate([turns, shift * rng.normal(size=(count, 3, 1))], axis=2)


def truth_of(model):
    poses = {v.name: np.column_stack([v.rotation, v.translation]) for v in model.views}
    return TrueCameras(camera=model.views[0].camera, cam_from_world=poses)


def off(model, edges, turn=0.002, shift=0.01, seed=1):
    """The model and edges with poses and points off."""
    rng = np.random.default_rng(seed)
    motions = random_motions(len(model.views), turn, shift, seed)
    points = model.points3D_xyz + shift * rng.normal(size=model.points3D_xyz.shape)
    moved = edges.points + shift / 3 * rng.normal(size=edges.points.shape)
    poses = AdjustedPoses(motions=motions, points3D_xyz=points)
    return moved_model(model, poses), replace(edges, points=moved)


def solve(model, edges, kind=None):
    problem, start = ba.make_problem(model, edges)
    if kind is not None:
        problem, start = part_of(problem, start, problem.kinds == kind)
    state = adjust(problem, start, OPTIONS)
    return moved_model(model, poses_of(model, problem, state)), problem, state


@pytest.fixture(scope="module")
def exact(scene, scene_model):
    """Model and edges without noise."""
    model = exact_model(scene_model)
    edges = scenes.true_edges(scene_model, scene)
    return model, with_normals(edges, normals_of(model, edges))


@pytest.fixture(scope="module")
def noisy(scene_model, scene_edges, exact):
    """The same with 0.2 px of noise on SfM points, 0.3 px on edges."""
    return scene_model, with_normals(scene_edges, exact[1].observations.normals)


@pytest.mark.parametrize("kind", [None, ba.SFM, ba.EDGE])
def test_exact_observations_give_the_exact_poses(exact, kind):
    model, edges = exact
    truth = truth_of(model)
    start, moved = off(model, edges)
    assert min(pose_errors(start.reconstruction, truth)) > 0.01
    refined, _, _ = solve(start, moved, kind)
    assert max(pose_errors(refined.reconstruction, truth)) < 1e-4


def test_edge_points_do_not_slide(exact):
    model, edges = exact
    start, moved = off(model, edges)
    _, problem, state = solve(start, moved, ba.EDGE)
    shifts = state.points - moved.points[problem.indices - len(model.point3D_ids)]
    along = np.abs(np.einsum("pi,pi->p", shifts, problem.tangents))
    assert np.linalg.norm(shifts, axis=1).max() > 1e-3
    assert along.max() < 1e-7


def test_model_stays_where_it_is(exact):
    model, edges = exact
    start, moved = off(model, edges)
    refined, _, state = solve(start, moved)
    similarity = pycolmap.estimate_sim3d(refined.camera_centers, start.camera_centers)
    assert abs(similarity.scale - 1) < 0.005
    assert np.linalg.norm(similarity * np.zeros(3)) < 0.012
    assert (
        np.linalg.norm(state.moved.mean(axis=0)) < 0.5 * np.linalg.norm(state.moved, axis=1).mean()
    )


def test_unit_and_place_of_the_world_do_not_matter(noisy):
    model, edges = noisy
    start, moved = off(model, edges)
    refined, _, _ = solve(start, moved)
    rotation = pycolmap.Rotation3d(Rotation.from_rotvec([0.3, -1, 2]).as_matrix())
    change = pycolmap.Sim3d(1000.0, rotation, np.array([500.0, -3000.0, 70.0]))
    elsewhere = pycolmap.Reconstruction(start.reconstruction)
    elsewhere.transform(change)
    other = replace(model_from_reconstruction(elsewhere), track_points2D=start.track_points2D)
    points = np.array([change * point for point in moved.points])
    there, _, _ = solve(other, replace(moved, points=points))
    expected = np.array([change * center for center in refined.camera_centers])
    np.testing.assert_allclose(there.camera_centers, expected, atol=1e-2)  # 1e-5 of the unit


def test_outliers_do_no_harm(noisy):
    model, edges = noisy
    truth = truth_of(model)
    start, moved = off(model, edges)
    clean = pose_errors(solve(start, moved)[0].reconstruction, truth)
    rng = np.random.default_rng(2)

    def spoil(pixels):
        bad = rng.random(len(pixels)) < 0.1
        return pixels + bad[:, None] * rng.uniform(-50, 50, pixels.shape)

    wrong = replace(start, track_points2D=spoil(start.track_points2D))
    pixels = spoil(moved.observations.pixels)
    wrong_edges = replace(moved, observations=replace(moved.observations, pixels=pixels))
    spoiled = pose_errors(solve(wrong, wrong_edges)[0].reconstruction, truth)
    before = pose_errors(start.reconstruction, truth)
    assert max(np.divide(spoiled, clean)) < 1.5
    assert max(np.divide(spoiled, before)) < 0.5


def test_good_poses_are_kept_and_bad_ones_refined(noisy):
    model, edges = noisy
    poses, stats = refine_poses(model, edges, OPTIONS, num_threads=2)
    assert moved_model(model, poses) is model
    assert not stats["refined"]
    truth = truth_of(model)
    start, moved = off(model, edges, turn=5e-4, shift=2e-3)
    before = [view.rotation.copy() for view in start.views]
    poses, stats = refine_poses(start, moved, OPTIONS)
    refined = moved_model(start, poses)
    assert stats["refined"]
    assert stats["sfm_sigma_px"] == pytest.approx(0.2, rel=0.25)
    assert stats["edge_sigma_px"] == pytest.approx(0.3, rel=0.35)
    errors = [pose_errors(m.reconstruction, truth) for m in (start, refined)]
    assert max(np.divide(errors[1], errors[0])) < 0.5
    np.testing.assert_array_equal(before, [view.rotation for view in start.views])


def test_images_of_a_rig_move_together():
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 3, 6
    pycolmap.set_random_seed(0)
    reconstruction = pycolmap.synthesize_dataset(options)
    model = model_from_reconstruction(reconstruction)
    assert len(np.unique(frames_of_views(model))) == 6
    truth = truth_of(model)
    motions = random_motions(6, 0.01, 0.02)
    start = moved_model(model, AdjustedPoses(motions=motions, points3D_xyz=model.points3D_xyz))
    refined, _, _ = solve(start, Edges3D.none())
    assert min(pose_errors(start.reconstruction, truth)) > 1e-2
    assert max(pose_errors(refined.reconstruction, truth)) < 1e-4
    for view in refined.views:
        pose = refined.reconstruction.images[view.image_id].cam_from_world().matrix()
        np.testing.assert_allclose(pose, np.column_stack([view.rotation, view.translation]))


def test_a_view_with_few_points_stays_near_its_place(noisy):
    model, edges = noisy
    # All but three edge points are no more observed by the first view, nor are its SfM points.
    seen, tracks = (
        edges.observations,
        np.repeat(np.arange(len(model.point3D_ids)), np.diff(model.track_offsets)),
    )
    lone = np.flatnonzero(seen.views == 0)[3:]
    observed = seen.keep(~np.isin(np.arange(len(seen.views)), lone))
    kept = model.track_views != 0
    sparse = replace(
        model,
        track_views=model.track_views[kept],
        track_points2D=model.track_points2D[kept],
        track_offsets=np.searchsorted(tracks[kept], np.arange(len(model.point3D_ids) + 1)),
    )
    start, moved = off(sparse, replace(edges, observations=observed), turn=2e-4, shift=1e-3)
    problem, state = ba.make_problem(start, moved)
    strong, weak = (
        np.linalg.norm(adjust(problem, state, replace(OPTIONS, prior_observations=count)).moved[0])
        for count in (30.0, 1e-6)
    )
    assert strong < 0.002
    assert weak > 2 * strong


def test_of_many_points_each_frame_keeps_enough(exact):
    problem, _ = ba.make_problem(*exact)
    frames, owners = problem.frames[problem.measured.views], problem.measured.owners
    everything = np.bincount(frames)
    used = enough_points(problem, 20, random_seed=0)
    assert 0 < used.sum() < 0.5 * len(used)
    assert (np.bincount(frames[used[owners]]) >= np.minimum(everything, 20)).all()
    assert enough_points(problem, 10**6, random_seed=0).all()


def test_too_little_to_know_is_left_alone(scene_model):
    few = replace(
        scene_model,
        points3D_xyz=scene_model.points3D_xyz[:5],
        point3D_ids=scene_model.point3D_ids[:5],
        track_offsets=scene_model.track_offsets[:6],
        track_views=scene_model.track_views[: scene_model.track_offsets[5]],
        track_points2D=scene_model.track_points2D[: scene_model.track_offsets[5]],
    )
    poses, stats = refine_poses(few, Edges3D.none(), OPTIONS)
    assert len(poses.motions) == len(poses.points3D_xyz) == 0
    assert not stats["refined"]


def test_run_writes_refined_poses_and_leaves_the_input(scene, scene_paths, tmp_path, hash_folder):
    off_folder = tmp_path / "off"
    off_folder.mkdir()
    start = with_pose_noise(scene.reconstruction, 0.5, 3)
    start.write(str(off_folder))
    before = hash_folder(off_folder)
    paths = Paths(image_path=scene_paths[0], input_path=off_folder, output_path=tmp_path / "out")
    report = run("reconstruct", paths, PipelineOptions(refine_poses=True, num_threads=1))
    names = ["read", "detect", "trace", "curves", "write", "report"]
    assert [stage["name"] for stage in report["stages"]] == names
    assert hash_folder(off_folder) == before
    truth = truth_of(model_from_reconstruction(scene.reconstruction))
    written = pycolmap.Reconstruction(tmp_path / "out" / "sparse")
    errors = [pose_errors(r, truth) for r in (start, written)]
    assert max(np.divide(errors[1], errors[0])) < 0.5
    assert (
        written.num_points3D()
        == start.num_points3D() + report["stages"][names.index("write")]["counts"]["edge_points"]
    )


@pytest.fixture(scope="module")
def demo_part():
    """Every third of the demo's true cameras, with their edge graphs."""
    truth = load_true_cameras(DEMO / "true_cameras.json")
    names = [f"view{index:02d}.jpg" for index in range(0, 24, 3)]
    true = at_true_cameras(pycolmap.Reconstruction(DEMO / "sparse"), truth, names)
    # Of edges every third point, which tell as much and are adjusted faster.
    tracing = TracingOptions(curve_step_points=12)
    options = PipelineOptions(refine_poses=True, tracing=tracing)
    graphs = detect_stage(model_from_reconstruction(true), DEMO / "images", options, Stages())
    return truth, true, graphs, options


def test_edges_help_noisy_poses_more_than_sfm_points_alone(demo_part, soak):
    truth, true, graphs, options = demo_part
    remaining = []
    for seed in range(3) if soak else (1,):  # the hardest of the three
        start = with_pose_noise(true, 0.2, seed)
        model = model_from_reconstruction(start)
        refined, _ = trace_stage(model, graphs, options, Stages())
        before, after = pose_errors(start, truth), pose_errors(refined.reconstruction, truth)
        assert max(np.divide(after, before)) < 0.8
        remaining.append(after)
    for robust in (False, True):
        alone = pycolmap.Reconstruction(start)
        adjust_by_colmap(alone, poses=True, robust=robust)
        assert max(np.divide(np.mean(remaining, axis=0), pose_errors(alone, truth))) < 0.6


def test_true_poses_are_kept(demo_part):
    _, true, graphs, options = demo_part
    model = model_from_reconstruction(true)
    refined, _ = trace_stage(model, graphs, options, Stages())
    assert refined is model
