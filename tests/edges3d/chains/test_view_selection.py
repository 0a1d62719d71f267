import curves as known
import numpy as np
import pytest

from colmap_edges.edges3d.chains import view_selection
from colmap_edges.edges3d.chains.view_selection import (
    inverse_depth_ranges,
    observation_matrix,
    pick_diverse,
    select_views,
)
from colmap_edges.options import ViewSelectionOptions

RING = known.ring(12, radius=5.0, heights=(1.0, 1.5), arc_deg=330.0)


def ball(count, center=(0, 0, 0), radius=0.8, seed=0):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    points *= (
        radius * rng.random((count, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1, keepdims=True)
    )
    return points + np.array(center)


def angle_deg(a, b):
    return np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b)))


def test_neighbors_share_points():
    left = [known.looking((0.5 * i, -5, 1), (0, 0, 0), i) for i in range(4)]
    right = [known.looking((0.5 * i, -5, 1.2), (0, 0, 0), 4 + i) for i in range(4)]
    points = ball(200)
    observed = np.zeros((200, 8), bool)
    observed[:100, :4] = observed[100:, 4:] = True
    model = known.model_of(left + right, points, observed)
    near = select_views(model, ViewSelectionOptions(num_neighbors=3))
    for view in range(8):
        group = set(range(4)) if view < 4 else set(range(4, 8))
        assert set(near.later_neighbors[view].tolist()) == group - {view}
        assert set(near.observing_views[view].tolist()) == group - {view}
        assert (np.diff(near.observing_views[view]) > 0).all()
    near = select_views(model, ViewSelectionOptions(num_neighbors=4))
    for view in range(8):  # too few share points: others are chosen by their poses
        others = [other for other in range(8) if other != view]
        assert len(near.neighbors[view]) == 4
        assert near.neighbors[view][0] // 4 == view // 4
        assert sorted(near.later_neighbors[view].tolist()) == others
        assert near.observing_views[view].tolist() == others


def test_neighbor_with_more_shared_points_is_better():
    views = [known.looking((0.8 * np.sin(a), -5, 0.8 * np.cos(a))) for a in (0, 2, 4)]
    observed = np.ones((100, 3), bool)
    observed[30:, 1] = False
    near = select_views(known.model_of(views, ball(100), observed), ViewSelectionOptions())
    assert near.neighbors[0].tolist() == [2, 1]


def test_view_from_the_same_place_is_the_last_choice():
    views = [known.looking((0, -5, 1)), known.looking((0, -5, 1), (0.3, 0, 0))]
    views.append(known.looking((0.8, -5, 1)))
    near = select_views(known.model_of(views, ball(100)), ViewSelectionOptions())
    assert near.neighbors[0][0] == near.neighbors[1][0] == 2
    near = select_views(known.model_of(views, ball(100)), ViewSelectionOptions(num_neighbors=2))
    assert near.neighbors[2][:2].tolist() in ([0, 1], [1, 0])


def angles_to(view, others):
    return [angle_deg(RING[view].center, RING[n].center) for n in others]


def test_triangulation_angle_is_limited_where_enough_look_from_nearby():
    points = ball(200, radius=0.1)
    model = known.model_of(RING, points)
    options = ViewSelectionOptions(max_angle_deg=40.0, num_neighbors=2)
    near = select_views(model, options)
    for view, neighbors in enumerate(near.neighbors):
        assert len(neighbors) == 2
        if 0 < view < 11:  # those at the ends have one such view
            assert max(angles_to(view, neighbors)) < 42


def test_later_rounds_compare_with_the_same_views_and_further_ones():
    model = known.model_of(RING, ball(200, radius=0.1))
    for count, later in ((4, 7), (4, 2)):
        near = select_views(
            model, ViewSelectionOptions(num_neighbors=count, num_later_neighbors=later)
        )
        for neighbors, later_neighbors in zip(near.neighbors, near.later_neighbors, strict=True):
            assert len(neighbors) == count
            assert len(set(later_neighbors.tolist())) == max(count, later)
            assert later_neighbors[:count].tolist() == neighbors.tolist()


def test_views_from_further_aside_fill_up():
    model = known.model_of(RING, ball(200, radius=0.1))
    options = ViewSelectionOptions(
        max_angle_deg=40.0, max_observing_angle_deg=100.0, num_neighbors=2, num_later_neighbors=12
    )
    for view, neighbors in enumerate(select_views(model, options).later_neighbors):
        assert len(set(neighbors.tolist())) == len(neighbors)
        others = [n for n in range(12) if n != view]
        angles = dict(zip(others, angles_to(view, others), strict=True))
        inside = {n for n in others if angles[n] < 36}
        assert set(neighbors[: len(inside)].tolist()) == inside  # first those from nearby
        assert {n for n in others if angles[n] < 96} <= set(neighbors.tolist())
        assert max(angles[n] for n in neighbors) < 102


def test_ring_without_points_chooses_by_poses():
    near = select_views(known.model_of(RING), ViewSelectionOptions(num_neighbors=4))
    for view, neighbors in enumerate(near.neighbors):
        assert 2 <= len(neighbors) <= 4
        assert view not in neighbors
        assert max(angles_to(view, neighbors)) < 122
        next_ones = {n for n in (view - 1, view + 1) if 0 <= n < 12}
        assert next_ones <= set(neighbors.tolist())
        low, high = near.ranges[view].overall
        depths = RING[view].cam_from_world(ball(500, radius=1.5))[:, 2]
        assert (low < 1 / depths).all()
        assert (1 / depths < high).all()


@pytest.mark.parametrize("with_points", [False, True])
def test_view_that_looks_elsewhere_is_not_chosen(with_points):
    center = RING[5].center + np.array([0.3, 0.0, 0.2])
    stray = known.looking(center, 3 * center, 12)
    views = [*RING, stray]
    points, observed = ball(300), np.ones((300, 13), bool)
    observed[:, 12] = False
    model = known.model_of(views, *((points, observed) if with_points else ()))
    near = select_views(model, ViewSelectionOptions())
    for view in range(12):
        assert 12 not in near.neighbors[view]
        assert 12 not in near.observing_views[view]
        assert len(near.neighbors[view]) > 0
    assert not set(near.neighbors[12].tolist()) & {4, 5, 6}


def test_views_with_few_points_are_compared_by_their_poses():
    points, observed = ball(300), np.ones((300, 12), bool)
    observed[5:, 3] = False
    near = select_views(known.model_of(RING, points, observed), ViewSelectionOptions())
    assert {2, 4} <= set(near.neighbors[3].tolist())
    low, high = near.ranges[3].overall
    depths = RING[3].cam_from_world(points)[:, 2]
    assert low < (1 / depths).min()
    assert (1 / depths).max() < high


def test_depth_ranges_hold_the_depths_seen_and_little_else():
    points, observed = ball(400), np.random.default_rng(1).random((400, 12)) < 0.5
    model = known.model_of(RING, points, observed)
    ranges = inverse_depth_ranges(model, observation_matrix(model))
    for view, (low, high) in enumerate(r.of_points for r in ranges):
        inverse = 1 / RING[view].cam_from_world(points[observed[:, view]])[:, 2]
        assert 0 < low < inverse.min()
        assert inverse.max() < high
        assert high - low < 2 * np.ptp(inverse)


def test_depth_range_forgets_a_stray_point():
    points = np.concatenate([ball(400), RING[0].center + 0.01 * (-RING[0].center)[None]])
    model = known.model_of(RING[:2], points)
    _, high = inverse_depth_ranges(model, observation_matrix(model))[0].overall
    inverse = 1 / RING[0].cam_from_world(points[:400])[:, 2]
    assert inverse.max() < high < 2 * inverse.max()


def test_observations_count_once_a_view():
    model = known.model_of(RING[:3], ball(5), np.ones((5, 3), bool))
    matrix = observation_matrix(model)
    np.testing.assert_array_equal(matrix.toarray(), np.ones((3, 5)))


def test_baselines_are_spread():
    """Three views in a row to the right, the best ones, and one above."""
    centers = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0), (0, 1, 0)]
    views = [known.make_view(np.eye(3), -np.array(c, float), i) for i, c in enumerate(centers)]
    model = known.model_of(views)
    scores = np.array([0.0, 1.0, 0.99, 0.98, 0.9])
    assert pick_diverse(model, 0, scores, 2).tolist() == [1, 4]
    assert pick_diverse(model, 0, scores, 4).tolist() == [1, 4, 2, 3]
    assert pick_diverse(model, 0, scores, 9).tolist() == [1, 4, 2, 3]
    assert scores.tolist() == [0.0, 1.0, 0.99, 0.98, 0.9]
    assert pick_diverse(model, 0, np.zeros(5), 3).tolist() == []


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("with_points", [False, True])
def test_choice_does_not_depend_on_the_unit(scale, with_points):
    points = ball(200) if with_points else None
    views = [known.make_view(v.rotation, scale * v.translation, i) for i, v in enumerate(RING)]
    first = select_views(known.model_of(RING, points), ViewSelectionOptions())
    scaled = None if points is None else scale * points
    second = select_views(known.model_of(views, scaled), ViewSelectionOptions())
    for a, b in zip(first.neighbors, second.neighbors, strict=True):
        assert a.tolist() == b.tolist()
    for a, b in zip(first.ranges, second.ranges, strict=True):
        np.testing.assert_allclose(np.array(b.overall) * scale, a.overall, rtol=1e-9)


def test_one_view_has_no_neighbors():
    near = select_views(known.model_of(RING[:1]), ViewSelectionOptions())
    assert [n.tolist() for n in near.neighbors] == [[]]
    assert near.ranges[0].overall[0] < near.ranges[0].overall[1]


def test_depths_around_a_place_are_those_of_the_points_there():
    """A near wall to the left and a far one to the right: each place has its own, and a margin."""
    rng = np.random.default_rng(0)
    left = np.column_stack([rng.uniform(-1, -0.2, 200), np.full(200, 0.0), rng.uniform(0, 1, 200)])
    right = np.column_stack([rng.uniform(0.4, 2, 200), np.full(200, 5.0), rng.uniform(0, 2, 200)])
    view = known.looking((0, -5, 0.5))
    model = known.model_of([view], np.concatenate([left, right]))
    (found,) = inverse_depth_ranges(model, observation_matrix(model))
    near, far = found.at(view.project_undistorted(np.array([[-0.6, 0, 0.5], [1.2, 5, 1.0]]))[0])
    overall = found.overall
    assert near[0] > overall[0] + 0.2 * (overall[1] - overall[0])
    assert near[0] < 1 / 5 < near[1]
    assert far[0] < 1 / 10 < far[1] < near[1]
    assert found.at(np.zeros((0, 2))).shape == (0, 2)


def test_where_no_points_are_plain_walls_may_be_farther():
    """A picture on the wall to the left; to the right of it, all that is behind it."""
    rng = np.random.default_rng(0)
    picture = np.column_stack([rng.uniform(-2, -1, 200), np.full(200, 3.0), rng.uniform(0, 1, 200)])
    view = known.looking((0, -5, 0.5))
    model = known.model_of([view], picture)
    (found,) = inverse_depth_ranges(model, observation_matrix(model))
    on_it, aside = view.project_undistorted(np.array([[-1.5, 3, 0.5], [1.5, 3, 0.5]]))[0]
    near, far = found.at(np.array([on_it, aside]))
    np.testing.assert_allclose(far, found.overall)
    inverse = 1 / view.cam_from_world(picture)[:, 2]
    assert far[0] < 0.34 * inverse.min() < 0.9 * inverse.min() < near[0] < inverse.min()


def test_many_views_without_points_are_compared_with_those_near_by_only(monkeypatch):
    rng = np.random.default_rng(0)
    spots = np.stack(np.meshgrid(np.arange(11.0), np.arange(11.0)), axis=-1).reshape(-1, 2)
    heights = rng.uniform(3, 3.5, len(spots))
    views = [
        known.looking((x, y, height), (x + 0.3, y + 1, 0), index)
        for index, ((x, y), height) in enumerate(zip(spots, heights, strict=True))
    ]
    model = known.model_of(views)
    monkeypatch.setattr(view_selection, "MOST_BY_POSE", 60)
    compared = []
    weigh = view_selection.angle_weights
    monkeypatch.setattr(
        view_selection,
        "angle_weights",
        lambda rays, *of: compared.append(len(rays)) or weigh(rays, *of),
    )
    options = ViewSelectionOptions()
    near = select_views(model, options)
    assert max(compared) <= 3 * 25 * 60
    monkeypatch.setattr(view_selection, "MOST_BY_POSE", len(views))
    for found, all_pairs in (
        *zip(near.neighbors, select_views(model, options).neighbors, strict=True),
    ):
        assert found.tolist() == all_pairs.tolist()


def test_places_of_views_without_another():
    far = view_selection.nearest_distances(np.zeros((3, 3)))
    np.testing.assert_array_equal(far, np.inf)
    centers = np.array([[0.0, 0, 0], [0, 0, 0], [3, 4, 0], [3, 4, 1]])
    np.testing.assert_array_equal(view_selection.nearest_distances(centers), [5, 5, 1, 1])


def test_views_with_many_points_are_scored_by_some_of_them(monkeypatch):
    model = known.model_of(RING, ball(2000, radius=0.1))
    chosen = select_views(model, ViewSelectionOptions())
    monkeypatch.setattr(view_selection, "MOST_SHARED", 150)
    compared = []
    weigh = view_selection.angle_weights

    def counted(rays, *of):
        compared.append(len(rays))
        return weigh(rays, *of)

    monkeypatch.setattr(view_selection, "angle_weights", counted)
    fewer = select_views(model, ViewSelectionOptions())
    assert max(compared) <= 150 * 12
    for some, every in zip(fewer.neighbors, chosen.neighbors, strict=True):
        assert some.tolist() == every.tolist()
