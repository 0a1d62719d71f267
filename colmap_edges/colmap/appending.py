"""Appending of points to COLMAP's binary model files, which takes pycolmap seconds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from colmap_edges.colmap.binary_files import COUNT, POINT2D, POINT3D, TRACK_ELEMENT, image_records
from colmap_edges.core.arrays import ByteArray, FloatArray, IntArray, order_of
from colmap_edges.runtime.input_files import read_bytes


@dataclass(frozen=True, kw_only=True)
class NewPoints:
    """Points to append to a binary model.

    Attributes:
        ids: (N,) point3D ids, unused in the model.
        xyz: (N, 3) float64, world units.
        rgb: (N, 3) uint8.
        errors: (N,) float64 mean reprojection errors, pixels.
        track_offsets: (N + 1,) int64 CSR of the observations.
        track_image_ids: (T,) int64.
        track_points2D: (T, 2) float64, image pixels.
    """

    ids: IntArray
    xyz: FloatArray
    rgb: ByteArray
    errors: FloatArray
    track_offsets: IntArray
    track_image_ids: IntArray
    track_points2D: FloatArray


def append_points(folder: Path, points: NewPoints) -> None:
    """Append points, their tracks and their points2D to the binary model in `folder`."""
    indices = append_points2D(folder / "images.bin", points)
    append_points3D(folder / "points3D.bin", points, indices)


def append_points2D(path: Path, points: NewPoints) -> IntArray:
    """Append the observations to their images; returns their (T,) point2D indices.

    Raises:
        ColmapEdgesError: if the file is truncated or too long.
    """
    data = read_bytes(path)
    images = image_records(data, path)
    owners = np.repeat(points.ids, np.diff(points.track_offsets))
    indices = np.empty(len(owners), np.int64)
    order = order_of(points.track_image_ids, int(points.track_image_ids.max(initial=0)) + 1)
    sorted_ids = points.track_image_ids[order]
    with path.open("wb") as file:
        file.write(data[: COUNT.size])
        for image in images:
            first, last = np.searchsorted(sorted_ids, [image.image_id, image.image_id + 1])
            rows = order[first:last]
            indices[rows] = image.num_points2D + np.arange(len(rows))
            added = np.empty(len(rows), POINT2D)
            added["xy"] = points.track_points2D[rows]
            added["point3D_id"] = owners[rows]
            file.write(data[image.start : image.points_start - COUNT.size])
            file.write(COUNT.pack(image.num_points2D + len(rows)))
            file.write(data[image.points_start : image.end])
            file.write(added.tobytes())
    return indices


def append_points3D(path: Path, points: NewPoints, point2D_indices: IntArray) -> None:
    """Append the points with their tracks to points3D.bin."""
    heads = np.empty(len(points.ids), POINT3D)
    heads["id"], heads["xyz"], heads["rgb"] = points.ids, points.xyz, points.rgb
    heads["error"], heads["track_length"] = points.errors, np.diff(points.track_offsets)
    elements = np.empty(len(point2D_indices), TRACK_ELEMENT)
    elements["image_id"], elements["point2D_idx"] = points.track_image_ids, point2D_indices
    # The lengths of the alternating parts: a point's record, its track, the next record.
    parts = np.full((len(heads), 2), POINT3D.itemsize)
    parts[:, 1] = np.diff(points.track_offsets) * TRACK_ELEMENT.itemsize
    of_head = np.repeat(np.tile([True, False], len(heads)), parts.ravel())
    raw = np.empty(len(of_head), np.uint8)
    raw[of_head], raw[~of_head] = heads.view(np.uint8), elements.view(np.uint8)
    with path.open("r+b") as file:
        count = COUNT.unpack(file.read(COUNT.size))[0]
        file.seek(0)
        file.write(COUNT.pack(count + len(heads)))
        file.seek(0, 2)
        file.write(raw.tobytes())
