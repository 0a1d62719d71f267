"""Bars and boards of the demo scene keep both of their edges when duplicates are merged."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
from project import DEMO
from scenes import EDGES_ALONE
from scipy.spatial import cKDTree

from colmap_edges.edges3d.chains import assembly
from colmap_edges.options import DetectionOptions
from colmap_edges.pipeline.reconstruct import reconstruct

pytestmark = pytest.mark.pipeline  # a run of the whole pipeline

APART = (0.02, 0.06)  # metres, 2 to 6 pixels: widths of bars and boards
NEAR = 0.35  # of their width, within which an edge is one of their two


@pytest.fixture(scope="module")
def before_and_after():
    """The points of all traced pieces, and the edges that come of them."""
    pieces, merge = [], assembly.merge_traced

    def watched(given, kept, *arguments):
        pieces.append(np.concatenate([each.points for each in kept.edges]))
        return merge(given, kept, *arguments)

    options = replace(EDGES_ALONE, detection=DetectionOptions(min_blur_px=0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(assembly, "merge_traced", watched)
        model = pycolmap.Reconstruction(str(DEMO / "sparse"))
        edges = reconstruct(model, DEMO / "images", options).edges
    return pieces[0], edges


def true_pairs():
    """(n, 2, 3) opposite points of the true straight edges of bars and boards, and their widths."""
    truth = np.load(DEMO / "curves.npz")
    ends = truth["points"][truth["edges"]]
    middles, ways = ends.mean(axis=1), np.diff(ends, axis=1)[:, 0]
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    pairs = cKDTree(middles).query_pairs(APART[1], output_type="ndarray")
    offsets = np.diff(middles[pairs], axis=1)[:, 0]
    along = np.einsum("ij,ij->i", offsets, ways[pairs[:, 0]])
    parallel = np.abs(np.einsum("ij,ij->i", *ways[pairs.T])) > 0.995
    widths = np.linalg.norm(offsets, axis=1)
    kept = parallel & (np.abs(along) < 0.005) & (widths > APART[0])
    return middles[pairs[kept]], widths[kept]


def densely(edges):
    """Points along edges, closer to each other than to other edges."""
    ends = edges.points[edges.segments]
    steps = np.linspace(0, 1, 20)[:, None, None]
    return (ends[:, 0] + steps * (ends[:, 1] - ends[:, 0])).reshape(-1, 3)


def both_found(points, pairs, widths):
    return (cKDTree(points).query(pairs)[0] < NEAR * widths[:, None]).all(axis=1)


def test_bars_and_boards_keep_both_edges(before_and_after):
    pieces, edges = before_and_after
    pairs, widths = true_pairs()
    were = both_found(pieces, pairs, widths)
    assert were.sum() > 100
    assert (
        both_found(densely(edges), pairs, widths)[were].mean() > 0.92
    )  # 0.93 with OpenCV 4, where more pieces are taken for contours
