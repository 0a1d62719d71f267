"""Points of curves that lie on planar faces within their noise, moved onto them for the mesher."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, owners_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.surfaces.faces.evidence import ray_sigmas_of, sight_of
from colmap_edges.surfaces.faces.finding import Faces
from colmap_edges.surfaces.faces.labelling import ON_TOLERANCE
from colmap_edges.surfaces.information import MIN_COSINE

NUM_NEAREST = 8  # number of points of faces next to a point among which its face is sought
REACH = 2.0  # maximum distance of these, in distances between points of faces
# Maximum distance from a face in standard deviations, of curves that mostly lie within
# `ON_TOLERANCE` of faces.
MOSTLY_ON_TOLERANCE = 4.0


def flattened(curves: Edges3D, faces: Faces, model: Model) -> Edges3D:
    """Curves whose points are moved along their rays onto the faces they lie on within their noise.

    A plane is known from all of its points, and so better than each. Left where they are, points of
    curves stand out of points of faces, as flakes that no smoothing removes: their sides are steep.
    Where most points of a curve next to faces are within their noise, those twice as far off are
    taken for outliers; where most are not, it is relief.

    Args:
        curves: edges or contours.
        faces: planar faces with points.
        model: gives the views, at the scale of the images.
    """
    if not len(faces.face_ids) or not curves.num_points:
        return curves
    seen = curves.observations
    rays, sigmas, spread = sight_of(curves.points, seen.offsets, seen.views, model)
    ray_sigmas = ray_sigmas_of(curves, sigmas, spread)
    planes = planes_next_to(curves.points, faces)
    cosines = np.einsum("nkj,nj->nk", planes[..., :3], rays)
    away = planes[..., 3] - np.einsum("nkj,nj->nk", planes[..., :3], curves.points)
    deviations = np.hypot(sigmas[:, None], ray_sigmas[:, None] * cosines)
    in_noise = np.where(np.abs(cosines) >= MIN_COSINE, np.abs(away) / deviations, np.inf)
    rows = np.arange(curves.num_points), np.argmin(np.nan_to_num(in_noise, nan=np.inf), axis=1)
    noise, owners = in_noise[rows], owners_of(curves.edge_offsets)
    moved = noise <= ON_TOLERANCE
    num_moved, num_beside = (
        np.bincount(owners, of, curves.num_edges) for of in (moved, np.isfinite(noise))
    )
    moved |= (2 * num_moved >= num_beside)[owners] & (noise <= MOSTLY_ON_TOLERANCE)
    points = curves.points.copy()
    points[moved] += rays[moved] * (away[rows] / cosines[rows])[moved, None]
    # Ends that meet at a node stay together.
    _, same, owners = np.unique(curves.points, axis=0, return_index=True, return_inverse=True)
    return replace(curves, points=points[same[owners.ravel()]])


def off_faces(contours: Edges3D, faces: Faces) -> Edges3D:
    """The contours that are not next to planar faces all along.

    Contours are outlines of smooth bodies; on a face they are uncertain edges of its texture.
    """
    if not len(faces.face_ids) or not contours.num_points:
        return contours
    alone = np.isnan(planes_next_to(contours.points, faces)[:, 0, 0])
    return contours[np.logical_or.reduceat(alone, contours.edge_offsets[:-1])]


def planes_next_to(points: FloatArray, faces: Faces) -> FloatArray:
    """(N, K, 4) normals and offsets of the faces next to (N, 3) points; NaN where there is none."""
    planes = np.array([[*face.normal, face.offset] for face in faces.faces])
    planes = np.vstack([planes[faces.face_ids], np.full(4, np.nan)])
    tree = cKDTree(faces.points.points)
    spacing = float(np.median(tree.query(faces.points.points, k=[2])[0]))
    near = tree.query(points, NUM_NEAREST, distance_upper_bound=REACH * spacing)[1]
    found: FloatArray = planes[near]  # the last one for neighbours that are not there
    return found
