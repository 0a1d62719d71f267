import numpy as np
from curve_scenes import circle, graph_of, helix, line, ring_of_views
from curves import model_of
from pinhole_geometry import epipolar_lines, fundamental_matrix

from colmap_edges.edges3d.paper.correspondences import (
    depth_bounds,
    join_pepcs,
    pepcs_from_pecs,
    pepcs_from_sfm_points,
    sample_polylines,
    shuffle_pepcs,
)
from colmap_edges.edges3d.paper.edge_field import build_edge_field
from colmap_edges.options import CorrespondenceOptions

VIEWS = ring_of_views(5)
CURVES = [line((-1, -1, 0), (0.5, 1, 0.3)), circle((0.6, 0, 0.2), 0.5), helix()]
FIELD = build_edge_field(VIEWS, [graph_of(view, CURVES) for view in VIEWS])
OPTIONS = CorrespondenceOptions()


def crossings_by_brute_force(start, view):
    """Segments of `view` that the epipolar line of a start crosses, and where."""
    start_view = FIELD.views_at(start)[0]
    fundamental = fundamental_matrix(VIEWS[start_view], VIEWS[view])
    epipolar = epipolar_lines(fundamental, FIELD.ideal_points(start))[0]
    ids = np.repeat(np.arange(FIELD.num_polylines), np.diff(FIELD.polyline_offsets))
    rows = np.flatnonzero((FIELD.polyline_views[ids] == view) & (FIELD.next_points >= 0))
    a, b = FIELD.ideal[rows], FIELD.ideal[FIELD.next_points[rows]]
    before, after = (p @ epipolar[:2] + epipolar[2] for p in (a, b))
    crossed = (before < 0) != (after < 0)
    share = before[crossed] / (before[crossed] - after[crossed])
    return rows[crossed], a[crossed] + share[:, None] * (b - a)[crossed]


def candidates_of(pepcs, i):
    return pepcs.candidates.select(
        slice(pepcs.candidate_offsets[i], pepcs.candidate_offsets[i + 1])
    )


def test_pepcs_from_sfm_points_lie_in_the_two_circles():
    rng = np.random.default_rng(0)
    points = CURVES[0].points[125::250] + rng.normal(scale=0.02, size=(8, 3))
    model = model_of(VIEWS, points)
    pepcs = pepcs_from_sfm_points(model, FIELD, OPTIONS, 1)
    assert len(pepcs) >= len(VIEWS) * 4
    depths = np.array([view.cam_from_world(points)[:, 2] for view in VIEWS])  # (V, N)
    focal = VIEWS[0].focal_px
    finest = depths.min(axis=0) / focal
    pixels = np.array([view.project_ideal(points)[0] for view in VIEWS])  # (V, N, 2)
    start_views, start_pixels = FIELD.views_at(pepcs.starts), FIELD.ideal_points(pepcs.starts)
    for i in range(0, len(pepcs), 5):
        start, view = pepcs.starts.select(slice(i, i + 1)), start_views[i]
        offset = np.linalg.norm(pixels[view] - start_pixels[i], axis=1)
        near = np.flatnonzero(offset <= 10 * finest * focal / depths[view] + 1e-9)
        assert len(near) > 0
        expected = []  # one set for each SfM point that may have made the start
        for point in near:
            found = []
            for other in range(len(VIEWS)):
                if other == view:
                    continue
                rows, places = crossings_by_brute_force(start, other)
                radius = 30 * finest[point] * focal / depths[other, point]
                inside = np.linalg.norm(places - pixels[other, point], axis=1) <= radius
                found += rows[inside].tolist()
            expected.append(found)
        assert candidates_of(pepcs, i).segments.tolist() in expected


def test_pepcs_from_pecs_cross_the_polylines_of_the_pec_only():
    labels = np.tile([0, 1, 0], len(VIEWS)).astype(np.int32)
    labels[-1] = -1
    pepcs = pepcs_from_pecs(model_of(VIEWS), FIELD, labels, OPTIONS, 1)
    start_polylines = FIELD.polylines_at(pepcs.starts)
    assert (labels[start_polylines] >= 0).all()
    for i in range(0, len(pepcs), 7):
        expected = []
        for view in range(len(VIEWS)):
            if view == FIELD.polyline_views[start_polylines[i]]:
                continue
            rows, _ = crossings_by_brute_force(pepcs.starts.select(slice(i, i + 1)), view)
            polylines = np.searchsorted(FIELD.polyline_offsets, rows, "right") - 1
            expected += rows[labels[polylines] == labels[start_polylines[i]]].tolist()
        assert candidates_of(pepcs, i).segments.tolist() == expected


def test_true_correspondence_is_among_the_candidates_within_the_depth_range():
    labels = np.tile([0, 1, 2], len(VIEWS)).astype(np.int32)
    model = model_of(VIEWS, CURVES[2].points[::300])
    ranges = depth_bounds(model)
    assert (ranges[:, 0] < 6).all()
    assert (ranges[:, 1] > 6).all()
    bounded = pepcs_from_pecs(model, FIELD, labels, OPTIONS, 1)
    unbounded = pepcs_from_pecs(model_of(VIEWS), FIELD, labels, OPTIONS, 1)
    lines = FIELD.polylines_at(bounded.starts) % 3 == 0
    counts = np.diff(bounded.candidate_offsets)
    assert (counts[lines] <= len(VIEWS) - 1).all()
    assert (counts[lines] == len(VIEWS) - 1).mean() > 0.9
    assert len(bounded.candidates) <= len(unbounded.candidates)


def test_pepcs_do_not_depend_on_threads():
    labels = np.zeros(FIELD.num_polylines, np.int32)
    model = model_of(VIEWS, CURVES[0].points[::100])
    for make in (
        lambda n: pepcs_from_sfm_points(model, FIELD, OPTIONS, n),
        lambda n: pepcs_from_pecs(model, FIELD, labels, OPTIONS, n),
    ):
        one, two = make(1), make(2)
        assert one.candidates.segments.tobytes() == two.candidates.segments.tobytes()
        assert one.candidates.fractions.tobytes() == two.candidates.fractions.tobytes()


def test_samples_are_evenly_spaced_and_on_wanted_polylines():
    wanted = np.zeros(FIELD.num_polylines, bool)
    wanted[[0, 4]] = True
    places = sample_polylines(FIELD, wanted, 20.0)
    polylines = FIELD.polylines_at(places)
    assert set(polylines) == {0, 4}
    pixels = FIELD.ideal_points(places)[polylines == 0]
    steps = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
    assert abs(steps.mean() - 20) < 1
    np.testing.assert_allclose(steps, steps.mean(), atol=1e-6)
    first = FIELD.ideal[0]
    assert abs(np.linalg.norm(pixels[0] - first) - steps.mean() / 2) < 1e-6


def test_joined_and_shuffled_pepcs_keep_their_candidates():
    labels = np.zeros(FIELD.num_polylines, np.int32)
    model = model_of(VIEWS, CURVES[0].points[::400])
    parts = [
        pepcs_from_sfm_points(model, FIELD, OPTIONS, 1),
        pepcs_from_pecs(model, FIELD, labels, OPTIONS, 1),
    ]
    joined = join_pepcs(parts)
    assert len(joined) == len(parts[0]) + len(parts[1])
    shuffled = shuffle_pepcs(joined, 3)

    def contents(pepcs):
        return sorted(
            (segment, fraction, *candidates_of(pepcs, i).segments.tolist())
            for i, (segment, fraction) in enumerate(
                zip(pepcs.starts.segments, pepcs.starts.fractions, strict=True)
            )
        )

    assert contents(joined) == contents(shuffled)
    assert shuffled.starts.segments.tolist() != joined.starts.segments.tolist()
