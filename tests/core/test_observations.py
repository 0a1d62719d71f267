"""Observations: concatenated, selected and written to the model."""

import numpy as np
import pytest
import scenes
from hypothesis import given
from hypothesis import strategies as st

from colmap_edges.colmap.model import load_model, model_from_reconstruction
from colmap_edges.colmap.writing import write_model
from colmap_edges.core.arrays import flattened, offsets_of, unflattened
from colmap_edges.core.observations import ChainObservations, Observations
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.edge_index import at_positions
from colmap_edges.options import PipelineOptions, TracingOptions
from colmap_edges.pipeline.detect import detect_stage
from colmap_edges.pipeline.trace import trace_stage
from colmap_edges.runtime.stages import Stages


def observations_of(rows):
    """Observations of points, each by these views; every value tells point and view."""
    points = np.repeat(np.arange(len(rows)), [len(views) for views in rows])
    views = np.array([view for row in rows for view in row], np.int32)
    told = points + views / 16
    return Observations(
        offsets=offsets_of(np.array([len(views) for views in rows], np.int64)),
        views=views,
        positions=told,
        chains=(16 * told).astype(np.int32),
        pixels=np.column_stack([told, -told]),
        normals=np.column_stack([told, told]).astype(np.float32),
    )


def told_of(observed):
    """What is told of each point, as lists; every array must tell the same."""
    assert observed.offsets[0] == 0
    assert observed.offsets[-1] == len(observed.views) == len(observed.positions)
    np.testing.assert_array_equal(observed.chains, 16 * observed.positions)
    np.testing.assert_array_equal(observed.pixels[:, 0], observed.positions)
    np.testing.assert_array_equal(observed.normals[:, 1], observed.positions)
    np.testing.assert_array_equal(observed.positions % 1 * 16, observed.views)
    return [part.tolist() for part in np.split(observed.positions, observed.offsets[1:-1])][
        : len(observed.counts)
    ]


TRACKS = st.lists(st.lists(st.integers(0, 15), max_size=4, unique=True).map(sorted), max_size=8)


@given(TRACKS, st.data())
def test_points_take_their_observations_along(rows, data):
    observed = observations_of(rows)
    places = st.integers(0, max(len(rows) - 1, 0))
    chosen = data.draw(st.lists(places, max_size=10 if rows else 0))
    told = told_of(observed)
    assert told_of(observed.select(np.array(chosen, np.int64))) == [told[i] for i in chosen]


@given(TRACKS, st.data())
def test_dropped_observations_leave_their_points(rows, data):
    observed = observations_of(rows)
    count = len(observed.views)
    mask = np.array(data.draw(st.lists(st.booleans(), min_size=count, max_size=count)), bool)
    kept = observed.keep(mask)
    left = iter(mask.tolist())
    assert told_of(kept) == [[told for told in of if next(left)] for of in told_of(observed)]
    np.testing.assert_array_equal(kept.points, observed.points[mask])


@given(st.lists(TRACKS, max_size=4))
def test_parts_follow_each_other(parts):
    observed = [observations_of(rows) for rows in parts]
    whole = Observations.concatenated(observed)
    first = 0
    for part in observed:
        points = np.arange(first, first + len(part.counts))
        for name, array in vars(whole.select(points)).items():
            np.testing.assert_array_equal(array, getattr(part, name))
        first += len(part.counts)
    assert first == len(whole.counts)
    for name, array in vars(Observations.none()).items():
        assert getattr(whole, name).dtype == array.dtype, name


@given(TRACKS)
def test_each_view_has_its_rows(rows):
    observed = observations_of(rows)
    found = dict(observed.by_view())
    assert list(found) == sorted(set(observed.views.tolist()))
    for view, own in found.items():
        np.testing.assert_array_equal(own, np.flatnonzero(observed.views == view))


def test_tables_become_rows_in_the_order_of_their_views():
    table = np.array([[2.5, np.nan, 0.0], [np.nan, np.nan, np.nan], [1.0, 7.0, np.nan]])
    observed = ChainObservations.of_table(np.array([9, 4, 6]), table)
    assert observed.offsets.tolist() == [0, 2, 2, 4]
    assert observed.views.tolist() == [9, 6, 9, 4]
    assert observed.positions.tolist() == [2.5, 0.0, 1.0, 7.0]


def test_dataclasses_are_taken_apart_and_put_together(scene_edges):
    arrays = flattened(scene_edges)
    assert arrays["observations.views"] is scene_edges.observations.views
    back = unflattened(type(scene_edges), arrays)
    assert back.observations.pixels is scene_edges.observations.pixels
    assert flattened(back).keys() == arrays.keys()


@pytest.fixture(scope="module", params=["chains", "paper"])
def followed(request, tmp_path_factory):
    """A model with a lens that distorts, its graphs, its edges, and the model with them read."""
    scene = scenes.make_scene(num_views=8, width=240, height=180, camera_model="SIMPLE_RADIAL")
    images, _ = scene.write(tmp_path_factory.mktemp("followed"))
    model = model_from_reconstruction(scene.reconstruction)
    options = PipelineOptions(tracing=TracingOptions(method=request.param), num_threads=2)
    detection = detect_stage(model, images, options, Stages())
    edges = trace_stage(model, detection, options, Stages())[1].edges
    folder = tmp_path_factory.mktemp("written")
    ids = write_model(model, edges, folder)
    return model, detection, edges, load_model(folder), ids


@pytest.mark.pipeline
def test_written_observations_lie_on_the_chains_they_name(followed):
    _, detection, edges, written, ids = followed
    observed = edges.observations
    assert len(observed.views) > 500
    rows = np.searchsorted(written.point3D_ids, ids)
    tracks = Observations.of_pixels(
        offsets=written.track_offsets, views=written.track_views, pixels=written.track_points2D
    ).select(rows)
    np.testing.assert_array_equal(tracks.offsets, observed.offsets)
    for view, own in observed.by_view():
        graph: EdgeGraph = detection.graphs.load(view)
        at = observed.positions[own]
        chains = np.searchsorted(graph.polyline_offsets, at, "right") - 1
        np.testing.assert_array_equal(observed.chains[own], chains)
        pixels = at_positions(graph, at, graph.points)[0]
        np.testing.assert_allclose(observed.pixels[own], pixels, atol=1e-9)
        for point in np.unique(observed.points[own]):
            mine = own[observed.points[own] == point]
            track = slice(*tracks.offsets[point : point + 2])
            there = np.flatnonzero(tracks.views[track] == view)
            np.testing.assert_array_equal(tracks.pixels[track][there], observed.pixels[mine])


@pytest.mark.pipeline
def test_normals_are_perpendicular_to_the_chains_there(followed):
    _, detection, edges, _, _ = followed
    observed = edges.observations
    np.testing.assert_allclose(np.linalg.norm(observed.normals, axis=1), 1, atol=1e-6)
    cosines = np.full(len(observed.views), np.nan)
    for view, own in observed.by_view():
        graph: EdgeGraph = detection.graphs.load(view)
        at = observed.positions[own].astype(np.int64)
        chain = observed.chains[own]
        first, last = graph.polyline_offsets[chain], graph.polyline_offsets[chain + 1] - 1
        before, after = np.maximum(at - 2, first), np.minimum(at + 3, last)
        along = graph.undistorted[after] - graph.undistorted[before]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        cosines[own] = np.abs(np.einsum("ij,ij->i", along, observed.normals[own]))
    assert np.median(cosines) < 0.01
    assert np.quantile(cosines, 0.99) < np.sin(np.radians(15))  # corners turn within a few pixels
