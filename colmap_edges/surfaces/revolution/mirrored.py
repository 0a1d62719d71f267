"""Planes of symmetry: through a view's centre, with outlines that mirror each other in them.

The axes of bodies lie in such planes. Most bodies stand upright; this tells which few of all pairs
of outlines may mirror each other, so that small bodies are found among many other edges. Planes of
any direction are sought among the smoothest outlines.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray, ranks_of
from colmap_edges.core.polylines import cross, unit
from colmap_edges.surfaces.revolution.samples import Samples
from colmap_edges.surfaces.round_evidence import MIN_WIDTH_PX

NUM_KEPT = 20  # number of pairs of a plane whose profiles are compared
MIDDLE_PX = 2.0  # maximum distance of the middle of a pair from its plane

# Planes of any direction.
MAX_SAMPLES = 250  # maximum number of samples of a view, on the longest chains
MAX_PAIRS = 2000  # maximum number of mirrored pairs of a view
NUM_TRIED = 200  # number of pairs whose planes are tried
NUM_PLANES = 8  # maximum number of planes of a view
MIN_PAIRS = 6  # minimum number of pairs of a plane
MAX_TURN = np.cos(np.radians(4.0))  # between normals of a pair, one of them mirrored
MIN_FACING = 0.2  # minimum cosine between normals and the direction from one to the other
MAX_TILT = np.cos(np.radians(5.0))  # between the direction of a pair and the plane's normal

# Upright planes.
NUM_UPRIGHT = 12  # maximum number of planes of a view
MIN_LEVEL = 5  # minimum number of pairs of a plane
HEIGHT_PX = 3.0  # maximum difference of heights of a pair: half the distance of samples
MAX_RISE = np.radians(20.0)  # maximum difference of their normals' angles with the level
MIN_ACROSS = 0.3  # minimum cosine between normals and the level


class Planes(NamedTuple):
    """Planes through a view's centre in which outlines are mirrored.

    Attributes:
        normals: (p, 3) unit normals.
        rows: (p, 2 * NUM_KEPT) samples of pairs, some of them repeated.
    """

    normals: FloatArray
    rows: IntArray

    @classmethod
    def of(cls, normals: list[FloatArray], rows: list[IntArray]) -> Planes:
        """Planes of lists of normals and rows."""
        return cls(
            np.array(normals).reshape(-1, 3), np.array(rows, np.int64).reshape(-1, 2 * NUM_KEPT)
        )


def planes_of(samples: Samples, rows: IntArray, rng: np.random.Generator) -> Planes:
    """The planes through a view's centre in which many of its (n,) samples are mirrored."""
    rows = np.sort(rows[np.argsort(-samples.lengths[rows], kind="stable")[:MAX_SAMPLES]])
    rays, normals = samples.rays[rows], samples.normals[rows]
    focal = samples.focals[rows[0]] if len(rows) else 1.0
    first, second = np.triu_indices(len(rows), 1)
    gaps = rays[first] - rays[second]
    widths = np.sqrt(np.einsum("ij,ij->i", gaps, gaps))
    wide = np.flatnonzero(widths * focal > MIN_WIDTH_PX)
    first, second = first[wide], second[wide]
    across = gaps[wide] / widths[wide, None]
    facing = np.einsum("ij,ij->i", normals[first], across)
    mirrored = normals[first] - 2 * facing[:, None] * across
    alike = np.abs(np.einsum("ij,ij->i", mirrored, normals[second]))
    good = np.flatnonzero((alike > MAX_TURN) & (np.abs(facing) > MIN_FACING))
    good = rng.permutation(good)[:MAX_PAIRS]
    first, second, across = first[good], second[good], across[good]
    middles = unit(rays[first] + rays[second])
    tried = across[:NUM_TRIED]
    products = tried @ middles.T  # in place: new arrays of this size take as long as the products
    fits = np.abs(products, out=products) < MIDDLE_PX / focal
    np.matmul(tried, across.T, out=products)
    fits &= np.abs(products, out=products) > MAX_TILT
    left = np.ones(len(good), bool)
    found: list[FloatArray] = []
    kept: list[IntArray] = []
    while len(good) and len(found) < NUM_PLANES:
        counts = np.count_nonzero(fits & left, axis=1)
        best = int(np.argmax(counts))
        if counts[best] < MIN_PAIRS:
            break
        own = np.flatnonzero(fits[best] & left)
        normal = normal_of(tried[best], middles[own] * focal, across[own])
        near = np.abs(middles @ normal) * focal < 2 * MIDDLE_PX
        left &= ~(near & (np.abs(across @ normal) > MAX_TILT)) & ~fits[best]
        own = np.resize(own, NUM_KEPT)
        found.append(normal)
        kept.append(rows[np.concatenate([first[own], second[own]])])
    return Planes.of(found, kept)


def normal_of(start: FloatArray, middles: FloatArray, across: FloatArray) -> FloatArray:
    """The normal of the plane through (n, 3) middles of pairs, nearly along their (n, 3) gaps."""
    mean = (across * np.sign(across @ start)[:, None]).sum(axis=0)
    mean /= np.linalg.norm(mean)
    # A direction is known to a few degrees only.
    held = len(across) * (MIDDLE_PX / np.sqrt(1 - MAX_TILT**2)) ** 2
    matrix = middles.T @ middles + held * (np.eye(3) - np.outer(mean, mean))
    return np.asarray(np.linalg.eigh(matrix)[1][:, 0])


def upright_planes(samples: Samples, rows: IntArray, upward: FloatArray) -> Planes:
    """The upright planes through a view's centre in which many of its (n,) samples are mirrored."""
    if not len(rows):
        return Planes.of([], [])
    basis = level_basis(samples.rays[rows], upward)
    first, second, angles = level_pairs(samples.select(rows), upward, basis)
    width = 2 * MIDDLE_PX / samples.focals[rows[0]]
    normals: list[FloatArray] = []
    kept: list[IntArray] = []
    while len(angles) and len(normals) < NUM_UPRIGHT:
        ends = np.searchsorted(angles, angles + width, side="right")
        counts = ends - np.arange(len(angles))
        start = int(np.argmax(counts))
        if counts[start] < MIN_LEVEL:
            break
        own = np.arange(start, ends[start])
        middle = np.median(angles[own])
        normals.append(np.array([-np.sin(middle), np.cos(middle)]) @ basis)
        some = own[np.linspace(0, len(own) - 1, NUM_KEPT).astype(int)]
        kept.append(rows[np.concatenate([first[some], second[some]])])
        first, second = np.delete(first, own), np.delete(second, own)
        angles = np.delete(angles, own)
    return Planes.of(normals, kept)


def level_basis(rays: FloatArray, upward: FloatArray) -> FloatArray:
    """(2, 3) orthonormal level directions, the first one below the mean of (n, 3) rays."""
    ahead = rays.mean(axis=0)
    ahead = unit(ahead - (ahead @ upward) * upward)
    return np.stack([ahead, np.cross(upward, ahead)])


def level_pairs(
    samples: Samples, upward: FloatArray, basis: FloatArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Pairs of a view's samples that mirror each other in upright planes.

    Mirrored rays have one height above the level, and their normals rise alike on both sides.

    Args:
        samples: samples of the view's chains.
        upward: (3,) unit direction.
        basis: (2, 3) level directions.

    Returns:
        (m,) first and (m,) second samples and (m,) ascending angles of the planes in the basis.
    """
    heights = np.arcsin(np.clip(samples.rays @ upward, -1, 1))
    above = unit(upward - np.sin(heights)[:, None] * samples.rays)
    across = np.einsum("ij,ij->i", samples.normals, cross(above, samples.rays))
    rises = np.einsum("ij,ij->i", samples.normals, above)
    used = np.flatnonzero(np.abs(across) > MIN_ACROSS)
    used = used[np.argsort(heights[used], kind="stable")]
    heights, slopes = heights[used], rises[used] / across[used]
    ends = np.searchsorted(heights, heights + HEIGHT_PX / samples.focals[used], side="right")
    counts = ends - np.arange(1, len(used) + 1)
    first = np.repeat(np.arange(len(used)), counts)
    second = first + 1 + ranks_of(counts)
    tilts = np.arctan(slopes)
    alike = np.abs(tilts[first] + tilts[second]) < MAX_RISE
    first, second = first[alike], second[alike]
    # Both moved along their chains to the height between them.
    places = samples.rays[used] @ basis.T
    angles, sizes = np.arctan2(places[:, 1], places[:, 0]), np.cos(heights)
    moves = (heights[second] - heights[first]) / 2
    one = angles[first] - moves * slopes[first] / sizes[first]
    other = angles[second] + moves * slopes[second] / sizes[second]
    wide = np.abs(one - other) * (sizes * samples.focals[used])[first] > MIN_WIDTH_PX
    middles = (one[wide] + other[wide]) / 2
    order = np.argsort(middles, kind="stable")
    return used[first[wide][order]], used[second[wide][order]], middles[order]
