import numpy as np
from crossings import crossings, rounded
from curve_scenes import circle, graph_of, helix, line, ring_of_views
from curves import model_of
from pinhole_geometry import epipolar_lines, fundamental_matrix

from colmap_edges.edges3d.paper.correspondences import (
    depth_bounds,
    pepcs_from_pecs,
    pepcs_from_sfm_points,
    sample_polylines,
)
from colmap_edges.edges3d.paper.places import index_views
from colmap_edges.options import CorrespondenceOptions

VIEWS = ring_of_views(5)
CURVES = [line((-1, -1, 0), (0.5, 1, 0.3)), circle((0.6, 0, 0.2), 0.5), helix()]
GRAPHS = [rounded(graph_of(view, CURVES)) for view in VIEWS]
CHAINS = index_views(VIEWS, GRAPHS)
POLYLINES = len(CURVES) * len(VIEWS)
OPTIONS = CorrespondenceOptions()


def crossings_by_brute_force(start, view):
    """Positions in `view` that the epipolar line of a start crosses, and their pixels."""
    fundamental = fundamental_matrix(VIEWS[start.views[0]], VIEWS[view])
    return crossings(GRAPHS[view], epipolar_lines(fundamental, CHAINS.undistorted_points(start))[0])


def polylines_at(places):
    """(N,) polylines over all views."""
    own = [GRAPHS[v].polyline_ids[int(p)] for v, p in zip(*vars(places).values(), strict=True)]
    return CHAINS.polyline_offsets[places.views] + own


def segments_at(places):
    """Views and segments of places."""
    return [(v, int(p)) for v, p in zip(*vars(places).values(), strict=True)]


def all_of(source):
    return source.pepcs(np.arange(len(source)))


def candidates_of(pepcs, i):
    return pepcs.candidates.select(
        slice(pepcs.candidate_offsets[i], pepcs.candidate_offsets[i + 1])
    )


def test_pepcs_from_sfm_points_lie_in_the_two_circles():
    rng = np.random.default_rng(0)
    points = CURVES[0].points[125::250] + rng.normal(scale=0.02, size=(8, 3))
    model = model_of(VIEWS, points)
    pepcs = all_of(pepcs_from_sfm_points(model, CHAINS, OPTIONS, 1))
    assert len(pepcs) >= len(VIEWS) * 4
    depths = np.array([view.cam_from_world(points)[:, 2] for view in VIEWS])  # (V, N)
    focal = VIEWS[0].focal_px
    finest = depths.min(axis=0) / focal
    pixels = np.array([view.project_undistorted(points)[0] for view in VIEWS])  # (V, N, 2)
    start_views, start_pixels = pepcs.starts.views, CHAINS.undistorted_points(pepcs.starts)
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
                positions, pixels_there = crossings_by_brute_force(start, other)
                radius = 30 * finest[point] * focal / depths[other, point]
                inside = np.linalg.norm(pixels_there - pixels[other, point], axis=1) <= radius
                found += [(other, int(place)) for place in positions[inside]]
            expected.append(found)
        assert segments_at(candidates_of(pepcs, i)) in expected


def test_pepcs_from_pecs_cross_the_polylines_of_the_pec_only():
    labels = np.tile([0, 1, 0], len(VIEWS)).astype(np.int32)
    labels[-1] = -1
    pepcs = all_of(pepcs_from_pecs(model_of(VIEWS), CHAINS, labels, OPTIONS, 1))
    start_polylines = polylines_at(pepcs.starts)
    assert (labels[start_polylines] >= 0).all()
    for i in range(0, len(pepcs), 7):
        expected = []
        for view in range(len(VIEWS)):
            if view == pepcs.starts.views[i]:
                continue
            positions, _ = crossings_by_brute_force(pepcs.starts.select(slice(i, i + 1)), view)
            there = CHAINS.polyline_offsets[view] + GRAPHS[view].polyline_ids[positions.astype(int)]
            same = labels[there] == labels[start_polylines[i]]
            expected += [(view, int(place)) for place in positions[same]]
        assert segments_at(candidates_of(pepcs, i)) == expected


def test_true_correspondence_is_among_the_candidates_within_the_depth_range():
    labels = np.tile([0, 1, 2], len(VIEWS)).astype(np.int32)
    model = model_of(VIEWS, CURVES[2].points[::300])
    ranges = depth_bounds(model)
    assert (ranges[:, 0] < 6).all()
    assert (ranges[:, 1] > 6).all()
    bounded = all_of(pepcs_from_pecs(model, CHAINS, labels, OPTIONS, 1))
    unbounded = all_of(pepcs_from_pecs(model_of(VIEWS), CHAINS, labels, OPTIONS, 1))
    lines = polylines_at(bounded.starts) % 3 == 0
    counts = np.diff(bounded.candidate_offsets)
    assert (counts[lines] <= len(VIEWS) - 1).all()
    assert (counts[lines] == len(VIEWS) - 1).mean() > 0.9
    assert len(bounded.candidates) <= len(unbounded.candidates)


def test_pepcs_do_not_depend_on_threads():
    labels = np.zeros(POLYLINES, np.int32)
    model = model_of(VIEWS, CURVES[0].points[::100])
    for make in (
        lambda n: pepcs_from_sfm_points(model, CHAINS, OPTIONS, n),
        lambda n: pepcs_from_pecs(model, CHAINS, labels, OPTIONS, n),
    ):
        one, two = all_of(make(1)), all_of(make(2))
        assert one.candidates.views.tobytes() == two.candidates.views.tobytes()
        assert one.candidates.positions.tobytes() == two.candidates.positions.tobytes()


def test_samples_are_evenly_spaced_and_on_wanted_polylines():
    wanted = np.zeros(POLYLINES, bool)
    wanted[[0, 4]] = True
    places = sample_polylines(CHAINS, wanted, 20.0)
    polylines = polylines_at(places)
    assert set(polylines) == {0, 4}
    pixels = CHAINS.undistorted_points(places)[polylines == 0]
    steps = np.linalg.norm(np.diff(pixels, axis=0), axis=1)
    assert abs(steps.mean() - 20) < 1
    np.testing.assert_allclose(steps, steps.mean(), atol=1e-6)
    first = GRAPHS[0].undistorted[0]
    assert abs(np.linalg.norm(pixels[0] - first) - steps.mean() / 2) < 1e-6


def test_shuffled_pepcs_keep_their_candidates():
    labels = np.zeros(POLYLINES, np.int32)
    model = model_of(VIEWS, CURVES[0].points[::400])

    def contents(pepcs):
        return sorted(
            (view, position, segments_at(candidates_of(pepcs, i)))
            for i, (view, position) in enumerate(
                zip(pepcs.starts.views, pepcs.starts.positions, strict=True)
            )
        )

    for source in (
        pepcs_from_sfm_points(model, CHAINS, OPTIONS, 1),
        pepcs_from_pecs(model, CHAINS, labels, OPTIONS, 1),
    ):
        shuffled = source.shuffled(3)
        whole = contents(all_of(source))
        assert whole == contents(all_of(shuffled))
        assert shuffled.starts.positions.tolist() != source.starts.positions.tolist()
        halves = [shuffled.pepcs(rows) for rows in np.array_split(np.arange(len(source)), 2)]
        assert whole == sorted(contents(halves[0]) + contents(halves[1]))
