"""Angles between the normals of a mesh and of the true surface, and normals of depth maps."""

from __future__ import annotations

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.polylines import unit
from colmap_edges.evaluation.metrics.statistics import Record, mean

NORMALS_WITHIN = {"normals_10_deg": 10.0, "normals_30_deg": 30.0}


def angles_deg(normals: FloatArray, reference: FloatArray) -> FloatArray:
    """Angles (...) in degrees between unit vectors (..., 3); NaN where either is NaN."""
    cross = np.linalg.norm(np.cross(normals, reference), axis=-1)
    return np.asarray(np.degrees(np.arctan2(cross, (normals * reference).sum(axis=-1))))


def normals_of_depth(points: FloatArray, center: FloatArray) -> FloatArray | None:
    """Normals of the surface of a depth map, by differences of depths some pixels apart.

    Each pixel and two others, one in its row and one in its column, span a plane. Where the surface
    is smooth, the four such planes agree. The pixels are so far apart that most normals are known:
    neighbours, unless depths are rounded. Where fewer than half of the pixels have a normal, the
    depth is noisy, and the pixels left would be a choice of the flattest.

    Args:
        points: (H, W, 3) positions of the pixels in the world, NaN where depth is unknown.
        center: (3,) centre of the camera.

    Returns:
        (H, W, 3) unit vectors towards the camera, NaN where the four planes differ; None if
        too few pixels have one, since the depth is noisy.
    """
    best, most = None, 0.5 * np.isfinite(points[..., 0]).sum()
    for step in (1, 2, 4, 8, 16):
        if 2 * step >= min(points.shape[:2]):
            break
        normals = differences(points, step)
        known = np.isfinite(normals[..., 0]).sum()
        if known > 0 and known >= most + (best is not None):
            best, most = normals, known
    if best is None:
        return None
    behind = (best * (points - center)).sum(axis=-1, keepdims=True) > 0
    return np.where(behind, -best, best)


def differences(points: FloatArray, step: int) -> FloatArray:
    """Normals (H, W, 3) of differences of points (H, W, 3) `step` pixels apart, of either side.

    NaN where the normals at the four corners around a pixel are more than 2 degrees, well below the
    smallest angle told apart, off their mean: at creases, depth steps, noise and rounded depths.
    """
    normals = np.full_like(points, np.nan)
    inner = slice(step, -step)
    across = points[inner, step:] - points[inner, :-step]
    down = points[step:, inner] - points[:-step, inner]
    rows, columns = (across[:, :-step], across[:, step:]), (down[:-step], down[step:])
    with np.errstate(invalid="ignore"):
        middle = unit(np.cross(rows[0] + rows[1], columns[0] + columns[1]))
        corners = [unit(np.cross(a, b)) for a in rows for b in columns]
        agree = np.all([angles_deg(c, middle) <= 2.0 for c in corners], axis=0)
    normals[inner, inner] = np.where(agree[..., None], middle, np.nan)
    return normals


def normal_shares(angles: FloatArray) -> Record:
    """The median angle, and shares of all pixels whose normal is right.

    Args:
        angles: (N,) degrees at the pixels with a true normal, NaN where the mesh is not hit.

    Returns:
        `normals_median_deg` where the mesh is hit, and by the names of `NORMALS_WITHIN` the shares
        of all pixels within each angle; pixels without mesh count as wrong. NaN without a pixel.
    """
    hit = angles[np.isfinite(angles)]
    median = float(np.median(hit)) if len(hit) else float("nan")
    right = {name: mean(angles <= limit) for name, limit in NORMALS_WITHIN.items()}
    return {"normals_median_deg": median} | right
