"""The paper's tracing on known 3D curves: precision and recall are exact."""

from dataclasses import replace

import numpy as np
import pytest
from curve_scenes import (
    circle,
    distances_to_curves,
    graph_of,
    helix,
    line,
    ring_of_views,
)
from curves import model_of
from scipy.spatial import cKDTree

from colmap_edges.core.arrays import flattened
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges3d.paper.correspondences import PepcSource
from colmap_edges.edges3d.paper.following import OUTCOMES, follow_edges
from colmap_edges.edges3d.paper.places import Places, index_views, join_places
from colmap_edges.edges3d.paper.tracing import trace_edges_paper
from colmap_edges.options import (
    CorrespondenceOptions,
    FollowingOptions,
    MatchingOptions,
    PipelineOptions,
    SamplingOptions,
    TracingOptions,
    VisibilityOptions,
)
from colmap_edges.pipeline.reconstruct import reconstruct

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

VIEWS = ring_of_views()
CURVES = [
    line((-1, -1, 0), (0.5, 1, 0.3)),
    line((-0.2, -1, 0.5), (1.5, 0.6, -0.3)),
    line((1.4, -0.9, 0.2), (1.3, 0.9, 0.2)),
    circle((0.6, 0.1, 0.2), 0.5),
    helix(),
]
UPRIGHT = CURVES[2]
PIXEL = 6 / 800  # size of a pixel in the scene, roughly


def traced(curves, strategy, num_threads=1, noise_px=0.0, seed=0):
    rng = np.random.default_rng(seed)
    graphs = [graph_of(view, curves, noise_px, rng) for view in VIEWS]
    points = np.concatenate([curve.points[100::200] for curve in curves])
    model = model_of(VIEWS, points)
    options = PipelineOptions(
        correspondence=CorrespondenceOptions(strategy=strategy),
        sampling=SamplingOptions(spacing_px=2.0),
        num_threads=num_threads,
    )
    found, stats = trace_edges_paper(model, Graphs.of(graphs), options)
    return found.edges, stats


def recall(edges, curves, radius):
    samples = np.concatenate([curve.points[::20] for curve in curves])
    return np.mean(cKDTree(edges.points).query(samples)[0] <= radius)


@pytest.mark.parametrize("strategy", ["sfm_points", "pecs", "both"])
def test_known_curves_come_out(strategy):
    edges, stats = traced(CURVES, strategy)
    distances = distances_to_curves(edges.points, CURVES)
    assert distances.max() < PIXEL  # precision 1
    assert np.median(distances) < 0.1 * PIXEL
    # What is missing: ends shorter than a step, and where a curve runs along epipolar lines.
    assert recall(edges, CURVES, 2 * PIXEL) > 0.9
    starts = stats["starts"]
    assert sum(starts.values()) == sum(
        count for name, count in stats["pepcs"].items() if name.startswith("pepcs_from")
    )
    assert stats["sampled"]["points"] == edges.num_points
    views = np.diff(edges.observations.offsets)
    assert np.median(views) >= 5
    assert views.min() >= 3


def test_noise_of_chains_stays_small_in_space():
    edges, _ = traced(CURVES, "both", noise_px=0.2)
    distances = distances_to_curves(edges.points, CURVES)
    assert np.median(distances) < 0.3 * PIXEL
    assert np.mean(distances < 2 * PIXEL) > 0.99
    assert recall(edges, CURVES, 2 * PIXEL) > 0.85


def test_each_edge_is_traced_once():
    edges, _ = traced(CURVES[:3], "both")
    total = sum(np.linalg.norm(np.diff(c.points, axis=0), axis=1).sum() for c in CURVES[:3])
    steps = np.linalg.norm(np.diff(edges.points, axis=0), axis=1)
    within = np.ones(len(steps), bool)
    within[edges.edge_offsets[1:-1] - 1] = False
    assert 0.85 * total < steps[within].sum() < 1.05 * total


def test_closed_curve_comes_back_to_its_start():
    ring = circle((0.2, 0, 0), 0.7)
    views = ring_of_views(5)
    chains = index_views(views, [graph_of(view, [ring]) for view in views])
    options = FollowingOptions(min_epipolar_angle_deg=0.0)
    start = on_chains(chains, ring.points[500:501], 0)
    others = [on_chains(chains, ring.points[500:501], view) for view in range(1, 5)]
    edges, outcomes = follow_edges(chains, [one_pepc(start, others)], options, 1)
    assert outcomes["accepted"] == 1
    assert edges.closed.tolist() == [True]
    gap = np.linalg.norm(edges.points[-1] - edges.points[0])
    assert gap < 1.6 * np.median(np.linalg.norm(np.diff(edges.points, axis=0), axis=1))
    assert recall(edges, [ring], 12 * PIXEL) == 1


def on_chains(chains, point, view):
    """The place on a chain of `view` nearest to the projection of one 3D point."""
    pixel = chains.views[view].project_undistorted(point)[0]
    near = chains.find_near(np.array([view], np.int32), pixel, np.array([2.0]), 1)
    return near.places.select(slice(0, 1))


def one_pepc(start, candidates):
    return pepcs_of(start, [candidates])


def pepcs_of(starts, candidates):
    """Starts with lists of candidates each."""

    def find(rows):
        places = join_places([place for row in rows for place in candidates[row]])
        offsets = np.cumsum([0, *(len(candidates[row]) for row in rows)])
        return offsets, places.views, places.positions

    return PepcSource(starts=starts, find_candidates=find)


def straight_setup(curves, views):
    chains = index_views(views, [graph_of(view, curves) for view in views])
    middle = curves[0].points[1000:1001]
    return chains, [on_chains(chains, middle, view) for view in range(len(views))]


def outcome_of(chains, pepcs, **options):
    counts = follow_edges(chains, [pepcs], FollowingOptions(**options), 1)[1]
    assert sum(counts.values()) == len(pepcs)
    assert tuple(counts) == OUTCOMES
    return {name for name, count in counts.items() if count}


def test_two_views_are_too_few():
    chains, places = straight_setup([UPRIGHT], ring_of_views(5))
    assert outcome_of(chains, one_pepc(places[0], places[1:2])) == {"too_few_views"}


def test_three_views_are_enough():
    chains, places = straight_setup([UPRIGHT], ring_of_views(5))
    assert outcome_of(chains, one_pepc(places[0], places[1:3])) == {"accepted"}


def test_points_of_different_edges_are_no_selection():
    chains, places = straight_setup([UPRIGHT, CURVES[0]], ring_of_views(5))
    wrong = on_chains(chains, CURVES[0].points[1000:1001], 2)
    pepcs = one_pepc(places[0], [places[1], wrong])
    assert outcome_of(chains, pepcs) == {"no_valid_selection"}


def test_edges_with_their_bright_sides_on_other_sides_are_no_selection():
    views = ring_of_views(5)
    graphs = [graph_of(view, [UPRIGHT]) for view in views]
    graphs[2] = replace(graphs[2], normals=-graphs[2].normals)
    chains = index_views(views, graphs)
    places = [on_chains(chains, UPRIGHT.points[1000:1001], view) for view in range(5)]
    assert outcome_of(chains, one_pepc(places[0], places[1:3])) == {"too_few_views"}
    edges, _ = follow_edges(chains, [one_pepc(places[0], places[1:])], FollowingOptions(), 1)
    assert set(edges.observations.views.tolist()) == {0, 1, 3, 4}


def test_chains_may_run_either_way():
    views = ring_of_views(5)
    back = replace_points(UPRIGHT, UPRIGHT.points[::-1])
    graphs = [graph_of(view, [back if i % 2 else UPRIGHT]) for i, view in enumerate(views)]
    for i in (1, 3):  # bright on the same side of the edge as in the other views
        graphs[i] = replace(graphs[i], normals=-graphs[i].normals)
    chains = index_views(views, graphs)
    places = [on_chains(chains, UPRIGHT.points[1000:1001], view) for view in range(5)]
    edges, counts = follow_edges(chains, [one_pepc(places[0], places[1:])], FollowingOptions(), 1)
    assert counts["accepted"] == 1
    assert recall(edges, [UPRIGHT], 12 * PIXEL) > 0.9


def replace_points(curve, points):
    return type(curve)(points, curve.closed)


def test_the_selection_that_many_views_agree_with_wins_against_one_of_few():
    """Five views see the true edge and two of them another one on the ray of the start."""
    views = ring_of_views(7)
    near = line((-0.4, -1, 0), (-0.2, 1, 0))
    far = type(near)(views[0].center + 1.08 * (near.points - views[0].center))
    graphs = [graph_of(v, [near, far] if i in (1, 2) else [near]) for i, v in enumerate(views)]
    chains = index_views(views, graphs)
    others = [on_chains(chains, near.points[1000:1001], v) for v in range(1, 7)]
    wrong = [on_chains(chains, far.points[1000:1001], v) for v in (1, 2)]
    start = on_chains(chains, near.points[1000:1001], 0)
    places = [others[0], wrong[0], others[1], wrong[1], *others[2:]]
    edges, counts = follow_edges(chains, [one_pepc(start, places)], FollowingOptions(), 1)
    assert counts["accepted"] == 1
    assert distances_to_curves(edges.points, [near]).max() < PIXEL


def test_edge_along_the_baseline_is_not_traced():
    views = ring_of_views(4)
    level = tuple(
        replace(v, translation=-v.rotation @ (v.center * np.array([1, 0, 1]))) for v in views
    )
    chains, places = straight_setup([line((-1, 0, 0), (1, 0, 0))], level)
    assert outcome_of(chains, one_pepc(places[0], places[1:])) == {"too_few_views"}


def test_covered_stretches_are_skipped():
    chains, places = straight_setup([UPRIGHT], ring_of_views(5))
    twice = pepcs_of(join_places([places[0], places[0]]), 2 * [places[1:]])
    counts = follow_edges(chains, [twice], FollowingOptions(), 1)[1]
    assert counts["accepted"] == 1
    assert counts["on_covered_stretch"] == 1


def mirrored_ambiguity():
    """Three views in which two different 3D points make the same images of two crossing edges.

    The candidates in views 1 and 2 hold the places of two parallel edges at depths such that both
    lie on the ray of the start.
    """
    views = ring_of_views(5)
    near = line((-0.4, -1, 0), (-0.2, 1, 0))
    share = 1.08  # the same edge seen from view 0, farther away
    far = type(near)(views[0].center + share * (near.points - views[0].center))
    graphs = [graph_of(views[0], [near])] + [graph_of(v, [near, far]) for v in views[1:]]
    chains = index_views(views, graphs)
    start = on_chains(chains, near.points[1000:1001], 0)
    others = [on_chains(chains, c.points[1000:1001], v) for v in (1, 2) for c in (near, far)]
    return chains, one_pepc(start, others)


def test_two_different_valid_selections_are_refused():
    chains, pepcs = mirrored_ambiguity()
    assert outcome_of(chains, pepcs) == {"ambiguous_selection"}


def test_near_duplicates_of_one_point_are_one_selection():
    chains, places = straight_setup([UPRIGHT], ring_of_views(5))
    beside = Places(views=places[1].views, positions=places[1].positions + 1)
    pepcs = one_pepc(places[0], [places[1], beside, places[2]])
    assert outcome_of(chains, pepcs) == {"accepted"}


def test_result_does_not_depend_on_threads():
    one, stats1 = traced(CURVES, "both", 1, noise_px=0.3)
    two, stats2 = traced(CURVES, "both", 2, noise_px=0.3)
    assert stats1 == stats2
    other = flattened(two)
    for name, array in flattened(one).items():
        assert array.tobytes() == other[name].tobytes(), name


def test_nothing_in_gives_nothing_out():
    graphs = [graph_of(view, []) for view in VIEWS]
    found, stats = trace_edges_paper(model_of(VIEWS), Graphs.of(graphs), PipelineOptions())
    assert found.edges.num_points == found.contours.num_points == 0
    assert found.edges.num_edges == 0
    assert stats["starts"]["accepted"] == 0


def test_options_have_the_values_of_the_paper():
    assert FollowingOptions().step_px == 10
    assert 2 <= FollowingOptions().max_error_px <= 3
    assert VisibilityOptions().min_views == 4
    assert MatchingOptions().resolution == 1


def test_rendered_scene_end_to_end(scene, scene_paths):
    options = PipelineOptions(
        tracing=TracingOptions(method="paper"),
        sampling=SamplingOptions(spacing_px=2.0),
        use_faces=False,
        use_patches=False,
        num_threads=2,
    )
    result = reconstruct(scene.reconstruction, scene_paths[0], options)
    distances = scene.distances(result.edges.points)
    assert np.median(distances) < 0.0011  # a quarter of a pixel
    assert np.mean(distances < 0.02) > 0.95
    seen = scene.samples[scene.sample_views >= 3]
    assert np.mean(cKDTree(result.edges.points).query(seen)[0] < 0.03) > 0.6
    assert len(result.point3D_ids) == result.edges.num_points
