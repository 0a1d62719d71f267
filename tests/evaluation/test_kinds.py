"""Errors of the kinds and radii of curves, exact on hand-made curves."""

from dataclasses import replace

import numpy as np
import pytest
from curve_edges import arc, edges_of, frame, segment

from colmap_edges.core.curves3d import ARC, CIRCLE, LINE, SPLINE, Curves3D
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.evaluation.metrics.kinds import TrueCurves, compare_kinds, true_curves


@pytest.fixture(scope="module")
def made():
    """Curves fitted to two lines and a circle with noise of 1e-3, and the true ones."""
    polylines = [
        segment((0, 0, 0), (2, 0, 0), 60),
        segment((0, 3, 0), (2, 3, 0), 60),
        arc(np.array([0, 0, 5.0]), frame(2), (1, 1), 0, 357, 120),
    ]
    curves = fit_curves(edges_of(polylines, [False, False, True]))
    dense = [
        segment((0, 0, 0), (2, 0, 0), 2001),
        segment((0, 3, 0), (2, 3, 0), 2001),
        arc(np.array([0, 0, 5.0]), frame(2), (1, 1), 0, 360, 6001),
    ]
    true = TrueCurves(
        points=np.concatenate(dense),
        curves=np.repeat(np.arange(3), [len(each) for each in dense]),
        kinds=np.array([LINE, LINE, CIRCLE]),
        radii=np.array([[np.nan, np.nan], [np.nan, np.nan], [1.0, 1.0]]),
    )
    return curves, true


def test_all_is_right(made):
    errors = compare_kinds(*made, 0.01)
    assert (errors["num_true"], errors["num_found"], errors["times_found"]) == (3, 3, 1.0)
    assert errors["right_kind"] == errors["right_radius"] == errors["on_true"] == 1
    assert errors["median_radius_error"] < 0.002


def test_wrong_kinds_and_radii_are_counted_by_length(made):
    curves, true = made
    wrong = replace(true, kinds=np.array([LINE, SPLINE, CIRCLE]))
    errors = compare_kinds(curves, wrong, 0.01)
    assert errors["right_kind"] == pytest.approx(1 - 2 / (4 + 2 * np.pi), abs=0.01)
    smaller = replace(true, radii=true.radii * 0.98)
    assert compare_kinds(curves, smaller, 0.01)["right_radius"] == 0
    arcs = replace(true, kinds=np.array([LINE, LINE, ARC]))  # counts for the circle
    assert compare_kinds(curves, arcs, 0.01)["right_kind"] == 1


def test_doubled_and_false_curves(made):
    curves, true = made
    twice = Curves3D.concatenated([curves, curves])
    assert compare_kinds(twice, true, 0.01)["times_found"] == 2
    frames = curves.frames.copy()
    frames[0, 0] += (0, 0, 90)
    errors = compare_kinds(replace(curves, frames=frames), true, 0.01)
    assert errors["num_true"] == errors["num_found"] == 2
    assert errors["on_true"] == pytest.approx((2 + 2 * np.pi) / (4 + 2 * np.pi), abs=0.01)


def test_reference_with_kinds_is_read(tmp_path):
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0]], float)
    arrays = {"points": points, "edges": np.array([[0, 1], [1, 2]])}
    np.savez(tmp_path / "plain.npz", **arrays)
    assert true_curves(tmp_path / "plain.npz", 0.1) is None
    arrays |= {"curves": np.array([0, 1]), "kinds": np.array([0, 0]), "radii": np.ones((2, 2))}
    np.savez(tmp_path / "kinds.npz", **arrays)
    true = true_curves(tmp_path / "kinds.npz", 0.1)
    np.savez(tmp_path / "none.npz", **{**arrays, "edges": np.zeros((0, 2), int)})
    assert true_curves(tmp_path / "none.npz", 0.1) is None
    assert len(true.points) == 20 and true.curves.tolist() == [0] * 10 + [1] * 10
