"""Pieces of one circle are classified as such, and as one curve where nothing ends between them."""

from dataclasses import replace

import numpy as np
import pytest
from curve_edges import arc, edges_of, frame, lines_around

from colmap_edges.core.curves3d import ARC, CIRCLE, LINE
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.export.curve_records import curve_records, curves_of_records

SIGMA = 1e-3


def pieces(*spans, radius=0.5, axes=1, center=1.0):
    """Edges along a circle, each from one angle to the other in degrees with so many points."""
    place, turned = np.full(3, center), frame(axes)
    return [arc(place, turned, (radius, radius), *span) for span in spans]


def test_a_piece_that_is_a_line_by_itself_lies_on_the_circle():
    polylines = [*lines_around(), *pieces((0, 200, 60), (230, 245, 5))]
    alone = fit_curves(edges_of([*lines_around(), polylines[-1]], sigma=SIGMA))
    assert alone.kinds[-1] == LINE
    curves = fit_curves(edges_of(polylines, sigma=SIGMA))
    assert curves.kinds[-2:].tolist() == [ARC, ARC]
    np.testing.assert_array_equal(curves.radii[-1], curves.radii[-2])
    np.testing.assert_allclose(curves.radii[-1], 0.5, rtol=0.01)
    np.testing.assert_allclose(curves.ends()[-1, 0], polylines[-1][0], atol=5 * SIGMA)
    np.testing.assert_allclose(curves.ends()[-1, 1], polylines[-1][-1], atol=5 * SIGMA)


def test_short_arcs_determine_their_circle_together():
    spans = [(start, start + 24, 12) for start in range(0, 360, 30)]
    apart = [pieces(span, center=9.0 * k)[0] for k, span in enumerate(spans)]
    single = fit_curves(edges_of([*lines_around(), *apart], sigma=SIGMA))
    curves = fit_curves(edges_of([*lines_around(), *pieces(*spans)], sigma=SIGMA))
    both = (single.kinds[30:] == ARC) & (curves.kinds[30:] == ARC)
    assert both.sum() >= 8
    errors = [np.abs(of.radii[30:, 0][both] / 0.5 - 1).max() for of in (single, curves)]
    assert errors[1] < 0.01 < 0.05 < errors[0]


def test_pieces_of_other_circles_stay():
    # Circles that touch: as near as pieces of one.
    two = [*pieces((0, 200, 60)), *pieces((0, 200, 60), radius=0.52), *pieces((0, 90, 30), axes=2)]
    curves = fit_curves(edges_of([*lines_around(), *two], sigma=SIGMA))
    assert len(np.unique(curves.radii[-3:, 0])) == 3
    np.testing.assert_allclose(curves.radii[-3:, 0], [0.5, 0.52, 0.5], rtol=0.02)
    np.testing.assert_array_equal(curves.arc_groups, np.arange(curves.num_curves))


@pytest.mark.parametrize("at_node", [False, True])
@pytest.mark.parametrize("reversed_", [False, True])
def test_arcs_are_one_curve_unless_one_ends_at_a_node(at_node, reversed_):
    both = pieces((0, 100, 40), (140, 280, 50))
    if reversed_:
        both[1] = both[1][::-1]
    edges = edges_of([*lines_around(), *both], sigma=SIGMA)
    nodes = edges.end_nodes.copy()
    if at_node:  # at both gaps: the first arc's ends
        nodes[30] = 0, 1
    curves = fit_curves(replace(edges, end_nodes=nodes))
    assert curves.kinds[-2:].tolist() == [ARC, ARC]
    first = curves.num_curves - 2
    assert curves.arc_groups[-2:].tolist() == [first, first + 1 if at_node else first]
    np.testing.assert_array_equal(curves.arc_groups[:-2], np.arange(first))


def test_one_gap_of_two_suffices():
    edges = edges_of([*lines_around(), *pieces((0, 100, 40), (140, 280, 50))], sigma=SIGMA)
    nodes = edges.end_nodes.copy()
    nodes[30, 1] = 0
    curves = fit_curves(replace(edges, end_nodes=nodes))
    assert curves.arc_groups[-1] == curves.num_curves - 2


def test_a_piece_on_a_closed_circle_is_part_of_it():
    polylines = [*lines_around(), *pieces((0, 354, 60), (30, 60, 8))]
    edges = edges_of(polylines, [False] * 30 + [True, False], sigma=SIGMA)
    curves = fit_curves(edges)
    assert curves.kinds[-2:].tolist() == [CIRCLE, ARC]
    assert curves.arc_groups[-1] == curves.arc_groups[-2] == curves.num_curves - 2


def test_parts_are_written_and_read():
    edges = edges_of([*lines_around(), *pieces((0, 100, 40), (140, 280, 50))], sigma=SIGMA)
    curves = fit_curves(edges)
    records = curve_records(curves, edges.edge_offsets)
    assert ["part_of" in record for record in records] == [False] * 31 + [True]
    back = curves_of_records(records, edges.edge_offsets)
    np.testing.assert_array_equal(back.arc_groups, curves.arc_groups)
    with pytest.raises(ValueError, match="part of"):
        curves_of_records([record | {"part_of": 99} for record in records], edges.edge_offsets)
