"""Removal of chains on the borders of JPEG's blocks, which are steps of quantisation, no edges.

JPEG rounds the cosine transform of blocks of 8x8 pixels. On plain surfaces of strongly compressed
images the rounding shows as steps at borders of blocks and, by the first cosine, in their middle.
They repeat in many views, so that later filters cannot tell them.
"""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import BoolArray, ByteArray, FloatArray
from colmap_edges.edges2d.detection import Chains
from colmap_edges.images.files import JPEG

BLOCK_PX = 8
QUANTISATION, SCAN = 0xDB, 0xDA  # markers of JPEG's quantisation tables, and of the image's data
# Zigzag order of the coefficients that vary along one axis only: along x, along y.
ALONG = ((0, 1, 5, 6, 14, 15, 27, 28), (0, 2, 3, 9, 10, 20, 21, 35))
MAX_SIGMAS = 3.0  # standard deviations of a border's step up to which it is due to quantisation
NEAR_PX = 0.5  # distance from a border or the middle of blocks of a chain that lies on it
MIN_EXCESS = 2.0  # times as many weak chain points on borders as between show that they are steps
MIN_ALIGNMENT = 0.99  # cosine of the angle between a chain's normal and an axis of the image


def off_block_borders(chains: Chains, data: ByteArray, scale: float) -> BoolArray | None:
    """(N,) whether points of chains are no steps of quantisation; None for images without blocks.

    Args:
        chains: chains of the image upsampled `scale` times.
        data: (B,) bytes of the image's file.
        scale: upsampling factor of the image.
    """
    table = quantisation_of(data)
    if table is None:
        return None
    limits = MAX_SIGMAS * np.array([step_sigma(table[list(along)]) for along in ALONG])
    steps = np.abs(np.diff(chains.sides.astype(np.int16), axis=1))
    weak = (np.abs(chains.normals) > MIN_ALIGNMENT) & (steps <= limits)
    between = BLOCK_PX / 4
    on, off = (weak & are_near(chains.points / scale + shift) for shift in (0, between))
    # True edges are as frequent between the borders and middles of blocks as on them.
    counts = [np.array([np.count_nonzero(along) for along in of.T]) for of in (on, off)]
    on &= counts[0] > MIN_EXCESS * counts[1]
    return ~(on[:, 0] | on[:, 1])


def are_near(places: FloatArray) -> BoolArray:
    """(N, 2) whether coordinates (N, 2) are near a border or the middle of blocks."""
    half = BLOCK_PX / 2
    return np.asarray(np.abs(places - half * np.round(places / half)) < NEAR_PX)


def step_sigma(quantisation: FloatArray) -> float:
    """Standard deviation of the step of intensities at the border of two blocks.

    Args:
        quantisation: (8,) steps of the coefficients that vary across the border only; each is
            off by up to half a step, evenly distributed.
    """
    waves = np.append(np.sqrt(1 / 8), np.cos(np.arange(1, 8) * np.pi / 16) / 2)
    return float(np.sqrt(2 / 8 * np.sum((quantisation * waves) ** 2) / 12))


def quantisation_of(data: ByteArray) -> FloatArray | None:
    """(64,) steps of a JPEG file's coefficients of luminance in zigzag order; None if it has none.

    Source: ITU-T T.81, B.2.4.1.
    """
    file, start = data.data, len(JPEG)
    if file[:start] != JPEG:
        return None
    while start + 4 <= len(file) and file[start] == 0xFF and file[start + 1] != SCAN:
        content = file[start + 4 : start + 2 + int.from_bytes(file[start + 2 : start + 4], "big")]
        wide = bool(content) and content[0] >> 4 > 0  # 16 bits for each step
        if file[start + 1] == QUANTISATION and len(content) > 64 * (1 + wide):
            return np.frombuffer(content, ">u2" if wide else "u1", 64, 1).astype(np.float64)
        start += 4 + len(content)
    return None
