"""A dense cloud as it is given to the program: files, or arrays of Python."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.clouds import CloudFile, SeenRows, image_names, read_cloud, read_visibility
from colmap_edges.colmap.model import Model
from colmap_edges.core.checks import check_offsets, path_of
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import DenseOptions
from colmap_edges.surfaces.dense.cloud import DenseCloud, dense_cloud


def given_cloud(
    points: Any,
    visibility: Any,
    model: Model,
    options: DenseOptions,
    num_threads: int,
    names: Sequence[str] | None = None,
) -> DenseCloud | None:
    """Read and prepare a cloud; None if no points are given.

    Args:
        points: PLY file, or (N, 3) float64 points.
        visibility: COLMAP's file of it, `SeenRows`, or None.
        model: the model in whose coordinates it is.
        options: options of dense clouds.
        num_threads: threads, 0 for all cores.
        names: names of the images that the visibility counts; by default those of the model.

    Raises:
        ColmapEdgesError: if an argument is invalid, or a file cannot be read.
    """
    if points is None:
        if visibility is not None:
            raise ColmapEdgesError("visibility is given without points; give the cloud, too")
        return None
    file = given_points(points)
    if visibility is not None:
        file = file._replace(seen=given_rows(visibility, len(file.points)))
    if names is None:
        names = image_names(model.reconstruction)
    return dense_cloud(file, model, names, options, num_threads)


def given_points(points: Any) -> CloudFile:
    """The points of a file or an array.

    Raises:
        ColmapEdgesError: if it is neither.
    """
    if isinstance(points, str | os.PathLike):
        return read_cloud(path_of("points", points))
    if not isinstance(points, np.ndarray) or points.ndim != 2 or points.shape[1] != 3:
        raise ColmapEdgesError("points must be a PLY file or an array of the shape (N, 3)")
    return CloudFile(points.astype(np.float64), np.zeros(points.shape, np.uint8), None)


def given_rows(visibility: Any, count: int) -> SeenRows:
    """The visibility of a file or of arrays, of a number of points.

    Raises:
        ColmapEdgesError: if it is neither, or of another number of points.
    """
    where = "visibility"
    if isinstance(visibility, SeenRows):
        offsets, images = visibility
        rows = SeenRows(np.asarray(offsets, np.int64), np.asarray(images, np.int32))
        check_offsets("visibility.offsets", rows.offsets, len(rows.images))
    else:
        where = str(Path(path_of("visibility", visibility)))
        rows = read_visibility(Path(where))
    if len(rows.offsets) - 1 != count:
        raise ColmapEdgesError(
            f"{where} is of {len(rows.offsets) - 1:,} points, but the cloud has {count:,}; give "
            "the file that was written with the cloud"
        )
    return rows
