"""Removal of parts of chains, such as masked ones."""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import BoolArray, owners_of, ranges_of
from colmap_edges.edges2d.detection import Chains


def outside_mask(chains: Chains, mask: BoolArray, scale: float, min_length_px: int) -> Chains:
    """The unmasked pieces of chains.

    Args:
        chains: chains of the image upsampled `scale` times.
        mask: (H, W) false for masked pixels of the image.
        scale: upsampling factor of the image.
        min_length_px: minimum length of a piece, in points.
    """
    height, width = mask.shape
    columns, rows = np.floor(chains.points / scale).astype(np.int64).T
    seen = mask[np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1)]
    return pieces_of(chains, seen, min_length_px)


def pieces_of(chains: Chains, seen: BoolArray, min_length_px: int) -> Chains:
    """The pieces of chains of at least `min_length_px` points at which (N,) `seen` is true."""
    # A number for each stretch of a chain that is wholly seen or wholly not.
    labels = 2 * owners_of(chains.offsets) + seen
    bounds = np.flatnonzero(np.diff(labels, prepend=-1, append=-1))
    starts, ends = bounds[:-1], bounds[1:]
    kept = seen[starts] & (ends - starts >= min_length_px)
    starts, ends = starts[kept], ends[kept]
    return chains.cut(ranges_of(starts, ends), ends - starts)
