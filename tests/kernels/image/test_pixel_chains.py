"""Pixels of thinned edge images, linked to chains."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from scipy import ndimage

from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

REACH = 6


def chains_of(edges):
    pixels, offsets = _kernels.link_pixels(np.asarray(edges, np.uint8), REACH)
    return [pixels[first:last].astype(int) for first, last in pairwise(offsets)]


def drawn(*rows):
    return np.array([[sign != "." for sign in row] for row in rows], np.uint8)


def test_a_staircase_is_one_chain_without_its_corners():
    edges = drawn(
        "##....",
        ".##...",
        "..####",
    )
    (chain,) = chains_of(edges)
    assert chain.tolist() == [
        [0, 0], [1, 0], [1, 1], [2, 1], [2, 2], [3, 2], [4, 2], [5, 2],
    ]  # fmt: skip


def test_chains_go_straight_on_where_others_end():
    edges = drawn(
        ".......#.......",
        ".......#.......",
        ".......#.......",
        "###############",
    )
    stem, bar = sorted(chains_of(edges), key=len)
    assert stem[:, 0].tolist() == [7, 7, 7]
    assert bar.tolist() == [[x, 3] for x in range(15)]


def test_of_a_crossing_each_line_keeps_its_direction():
    edges = np.zeros((31, 31), np.uint8)
    edges[15] = 1
    edges[:, 15] = 1
    lengths = sorted(len(chain) for chain in chains_of(edges))
    assert lengths == [15, 15, 31]


def test_closed_lines_are_followed_round_once():
    edges = np.zeros((20, 30), np.uint8)
    cv2.rectangle(edges, (3, 4), (20, 15), 1)
    (chain,) = chains_of(edges)
    assert len(chain) == edges.sum()
    assert np.abs(chain[0] - chain[-1]).sum() == 1


def test_single_pixels_and_none():
    assert [chain.tolist() for chain in chains_of(drawn("#", ".", "#"))] == [[[0, 0]], [[0, 2]]]
    assert chains_of(np.zeros((4, 5))) == []
    assert chains_of(np.zeros((0, 0))) == []
    with pytest.raises(ValueError, match="less than a pixel"):
        _kernels.link_pixels(np.zeros((4, 5), np.uint8), 0)


def touching(edges):
    """The pairs of pixels that touch, by brute force; and how many each pixel is in."""
    pixels = {(x, y) for y, x in np.argwhere(edges).tolist()}
    pairs = set()
    for x, y in pixels:
        for dx, dy in ((1, 0), (0, 1), (1, 1), (-1, 1)):
            between = dx and dy and ({(x + dx, y), (x, y + dy)} & pixels)
            if (x + dx, y + dy) in pixels and not between:
                pairs.add(((x, y), (x + dx, y + dy)))
    counts = dict.fromkeys(pixels, 0)
    for pair in pairs:
        for pixel in pair:
            counts[pixel] += 1
    return {frozenset(pair) for pair in pairs}, counts


@pytest.mark.parametrize("seed", range(8))
def test_random_images_against_brute_force(seed):
    """Every pixel in one chain, of pixels that touch; chains end where they must or others pass."""
    rng = np.random.default_rng(seed)
    edges = (rng.random((40, 50)) < rng.uniform(0.05, 0.4)).astype(np.uint8)
    pairs, counts = touching(edges)
    chains = [list(map(tuple, chain.tolist())) for chain in chains_of(edges)]
    assert sorted(pixel for chain in chains for pixel in chain) == sorted(counts)
    linked = {frozenset(step) for chain in chains for step in pairwise(chain)}
    assert linked <= pairs
    for pair in pairs - linked:  # but for those that close a chain, they lead into a junction
        closes = any({chain[0], chain[-1]} == pair for chain in chains if len(chain) > 2)
        assert closes or max(counts[pixel] for pixel in pair) > 2
    labels, _ = ndimage.label(edges, np.ones((3, 3)))
    for chain in chains:
        assert len({labels[y, x] for x, y in chain}) == 1
