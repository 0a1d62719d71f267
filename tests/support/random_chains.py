"""Random chains and poses, and their edge indexes."""

import numpy as np

from colmap_edges.core.arrays import offsets_of
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]

FOCAL = 500.0


def single(array):
    """`array` rounded to single precision, in which the kernels keep points."""
    return array.astype(np.float32).astype(np.float64)


def kept(normals):
    """Unit normals rounded to 16 bits a coordinate, in which the kernels keep them."""
    scaled = 32767 * normals
    return np.trunc(scaled + np.copysign(0.5, scaled)) / 32767


def random_chains(rng, count=12, closed_share=0.3):
    """Smooth random chains about 1 px apart: points, normals, offsets, closed."""
    points, normals, closed = [], [], []
    for _ in range(count):
        length = int(rng.integers(1, 120))
        loop = bool(rng.random() < closed_share) and length > 8
        if loop:
            angle = 2 * np.pi * np.arange(length) / length
            radii = length / (2 * np.pi) * (1 + 0.2 * np.cos(3 * angle + rng.uniform(0, 6)))
            part = radii[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        else:
            heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.08, length))
            part = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
        points.append(part + rng.uniform((-200, -150), (200, 150)))
        side = rng.choice([-1, 1])
        ahead = np.gradient(part, axis=0) if length > 1 else np.ones((1, 2))
        across = side * np.column_stack([-ahead[:, 1], ahead[:, 0]])
        normals.append(across / np.linalg.norm(across, axis=1, keepdims=True))
        closed.append(loop)
    offsets = offsets_of(np.array([len(part) for part in points], np.int64))
    return (
        single(np.concatenate(points)),
        kept(single(np.concatenate(normals))),
        offsets,
        np.array(closed),
    )


def neighbor(index, steps, offsets, closed):
    """Point `steps` after `index` on its polyline, stopping at open ends."""
    p = np.searchsorted(offsets, index, side="right") - 1
    first, count = offsets[p], offsets[p + 1] - offsets[p]
    place = index - first + steps
    return first + (place % count if closed[p] else np.clip(place, 0, count - 1))


def tangents_of(points, offsets, closed):
    result = np.zeros_like(points)
    for i in range(len(points)):
        chord = points[neighbor(i, 3, offsets, closed)] - points[neighbor(i, -3, offsets, closed)]
        size = np.linalg.norm(chord)
        result[i] = chord / size if size > 0 else (1, 0)
    return result


def random_pose(rng):
    q = rng.normal(size=4) * (1, 0.1, 0.1, 0.1) + (3, 0, 0, 0)
    w, x, y, z = q / np.linalg.norm(q)
    rotation = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
    return rotation, rng.normal(0, 0.5, 3)


def edge_index(points, normals, offsets, closed, pose=None, focal=FOCAL, sides=None):
    rotation, translation = pose if pose else (np.eye(3), np.zeros(3))
    sides = np.zeros((len(points), 2), np.uint8) if sides is None else sides
    return _kernels.EdgeIndex(points, normals, sides, offsets, closed, rotation, translation, focal)
