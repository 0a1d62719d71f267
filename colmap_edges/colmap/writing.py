"""COLMAP models with edge points or refined poses, as files or pycolmap.Reconstruction."""

from __future__ import annotations

import re
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from colmap_edges.colmap.appending import NewPoints, append_points
from colmap_edges.colmap.binary_files import check_complete
from colmap_edges.colmap.model import (
    Model,
    camera_parameter_counts,
    frames_of_views,
    observation_residuals,
)
from colmap_edges.colmap.text_files import check_text_files
from colmap_edges.core.arrays import (
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    entries_of,
    joined_offsets,
    owners_of,
)
from colmap_edges.core.edges3d import AdjustedPoses, Edges3D
from colmap_edges.core.view import track_residuals, views_with_rows
from colmap_edges.errors import ColmapEdgesError


def moved_model(model: Model, poses: AdjustedPoses) -> Model:
    """A model with changed poses and points, with a copy of the reconstruction.

    Args:
        model: the model to start from; it is not changed.
        poses: the new poses and SfM points.
    """
    if not len(poses.motions):
        return model
    moved = pycolmap.Reconstruction(model.reconstruction)
    motion_of = dict(zip(np.unique(frames_of_views(model)).tolist(), poses.motions, strict=True))
    frame_of = {image.name: image.frame_id for image in moved.images.values()}
    for copy, original in model.copies:  # they stay where their originals are
        motion_of.setdefault(frame_of[copy], motion_of[frame_of[original]])
    for frame_id, motion in motion_of.items():
        frame = moved.frames[frame_id]
        frame.rig_from_world = frame.rig_from_world * pycolmap.Rigid3d(motion)
    for point3D_id, xyz in zip(model.point3D_ids, poses.points3D_xyz, strict=True):
        moved.points3D[point3D_id].xyz = xyz
    moved.update_point_3d_errors()
    return replace(model.with_reconstruction(moved), points3D_xyz=poses.points3D_xyz)


def write_model(
    model: Model,
    edges: Edges3D,
    path: Path | str,
    output_type: str = "BIN",
    residuals: FloatArray | None = None,
    added: NewPoints | None = None,
) -> IntArray:
    """Write the model plus the edge points as points3D with tracks.

    Cameras, poses and SfM points are those of `model`. Observations of edge points are appended to
    the points2D of their images, so that existing indices stay valid.

    Args:
        model: the input model; it is not changed.
        edges: the edge points and their tracks.
        path: folder to write to; created if missing.
        output_type: BIN or TXT.
        residuals: (T,) result of `observation_residuals`, if already computed.
        added: further points, whose ids are counted from 0 after those of the edge points.

    Returns:
        (N,) ids of the edge points in the written model; edge points of one node share an id.
    """
    path = Path(path)
    path.mkdir(exist_ok=True)
    points = new_points(model, edges, residuals)
    every = joined(points, added, first_new_id(model)) if added else points
    try:
        if output_type == "BIN":
            model.reconstruction.write_binary(str(path))
            check_complete(path, camera_parameter_counts())
            append_points(path, every)
        else:
            write_text(with_points(model.reconstruction, every), path)
    except ColmapEdgesError as error:  # pycolmap does not report a full disk
        raise ColmapEdgesError(f"cannot write to {path}: the disk is full ({error})") from error
    return ids_of_edge_points(edges, points)


def write_moved(
    reconstruction: Any, scale: float, rotation: FloatArray, translation: FloatArray, path: Path
) -> None:
    """Write a copy of a pycolmap.Reconstruction in another frame, in binary files.

    Args:
        reconstruction: the reconstruction, which is not changed.
        scale: factor of all lengths.
        rotation: (3, 3) rotation of the new frame from the old one.
        translation: (3,) position of the old origin in the new frame.
        path: folder to write to; created if missing.
    """
    moved = pycolmap.Reconstruction(reconstruction)
    moved.transform(pycolmap.Sim3d(np.column_stack([scale * rotation, translation])))
    path.mkdir(exist_ok=True)
    moved.write_binary(str(path))
    check_complete(path, camera_parameter_counts())


def check_text_names(model: Model) -> None:
    """Check that image names contain no whitespace, which ends a name in text models.

    Raises:
        ColmapEdgesError: naming the first invalid one.
    """
    names = (view.name for view in model.views)
    bad = next((name for name in names if re.search(r"[ \t\n\v\f\r]", name)), None)
    if bad is not None:
        raise ColmapEdgesError(
            f"image name {bad!r} has a space or line break, which text models cannot hold; "
            "rename the image or write a binary model (--output_type BIN)"
        )


def write_text(reconstruction: Any, path: Path) -> None:
    """Write a text model and check that it is complete."""
    reconstruction.write_text(str(path))
    names = {"cameras": "cameras", "images": "reg_images", "points3D": "points3D"}
    names |= {name: name for name in ("rigs", "frames") if (path / f"{name}.txt").is_file()}
    counts = {name: getattr(reconstruction, f"num_{known}")() for name, known in names.items()}
    check_text_files(path, counts)


def extend_reconstruction(
    model: Model,
    edges: Edges3D,
    residuals: FloatArray | None = None,
) -> tuple[Any, IntArray]:
    """Make a new pycolmap.Reconstruction of the model plus edge points, as `write_model` does.

    Returns:
        The reconstruction and the (N,) ids of the edge points in it.
    """
    points = new_points(model, edges, residuals)
    return with_points(model.reconstruction, points), ids_of_edge_points(edges, points)


def with_points(reconstruction: Any, points: NewPoints) -> Any:
    """A copy of `reconstruction` with `points`, made through files, which is fastest."""
    with tempfile.TemporaryDirectory() as folder:
        reconstruction.write_binary(folder)
        check_complete(Path(folder), camera_parameter_counts())
        append_points(Path(folder), points)
        return pycolmap.Reconstruction(folder)


def new_points(
    model: Model,
    edges: Edges3D,
    residuals: FloatArray | None,
) -> NewPoints:
    """Edge points as COLMAP's points3D with ids after the model's and reprojection errors."""
    if residuals is None:
        residuals = observation_residuals(model, edges)
    points, own = edges.distinct()[0], np.flatnonzero(edges.node_ids < 0)
    observed, count = points.observations, len(points.points)
    at, tracks = edges.nodes.points, edges.nodes.observations
    known = residuals[entries_of(edges.observations.offsets, own)]
    others = track_residuals(model.views, at[tracks.points], tracks.views, tracks.pixels)
    sums = np.bincount(observed.points, np.concatenate([known, others]), count)
    image_ids = np.array([view.image_id for view in model.views], np.int64)
    return NewPoints(
        ids=first_new_id(model) + np.arange(count, dtype=np.int64),
        xyz=points.points,
        rgb=points.colors,
        errors=sums / np.maximum(observed.counts, 1),
        track_offsets=observed.offsets,
        track_image_ids=image_ids[observed.views],
        track_points2D=observed.pixels,
    )


def first_new_id(model: Model) -> int:
    """The id after those of all points of a model."""
    taken = (model.point3D_ids, model.far_point3D_ids)
    return 1 + int(max(ids.max(initial=0) for ids in taken))


def joined(points: NewPoints, added: NewPoints, first_id: int) -> NewPoints:
    """Two sets of points as one, the second with ids after those of the first."""
    first_id = int(points.ids.max(initial=first_id - 1)) + 1
    parts = (points, replace(added, ids=first_id + added.ids))
    values = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in vars(points)
        if name != "track_offsets"
    }
    return NewPoints(**values, track_offsets=joined_offsets([part.track_offsets for part in parts]))


def points_of_tracks(
    model: Model, xyz: FloatArray, offsets: IntArray, views: Int32Array, grays: ByteArray
) -> NewPoints:
    """Gray points whose observations are where they project to; ids from 0.

    Their reprojection errors are unknown: -1, as in COLMAP.

    Args:
        model: the model of the views.
        xyz: (N, 3) the points.
        offsets: (N + 1,) of their tracks.
        views: (T,) views of their tracks.
        grays: (N,) their gray.
    """
    owners, pixels = owners_of(offsets), np.zeros((len(views), 2))
    for view, rows in views_with_rows(model.views, views):
        pixels[rows] = view.project(xyz[owners[rows]])[0]
    image_ids = np.array([view.image_id for view in model.views], np.int64)
    return NewPoints(
        ids=np.arange(len(xyz), dtype=np.int64),
        xyz=xyz,
        rgb=np.repeat(grays[:, None], 3, axis=1),
        errors=np.full(len(xyz), -1.0),
        track_offsets=offsets,
        track_image_ids=image_ids[views],
        track_points2D=pixels,
    )


def ids_of_edge_points(edges: Edges3D, points: NewPoints) -> IntArray:
    """(N,) ids of edge points among the new points."""
    return np.asarray(points.ids[edges.distinct()[1]])


def with_edge_points(model: Model, edges: Edges3D, point3D_ids: IntArray) -> Model:
    """The model with the edge points appended to its points, for the mesher.

    Edge points of one node share an id, but are repeated for each edge. `reconstruction` is
    unchanged.
    """
    observed = edges.observations
    offsets = model.track_offsets[-1] + observed.offsets[1:]
    return replace(
        model,
        points3D_xyz=np.concatenate([model.points3D_xyz, edges.points]),
        point3D_ids=np.concatenate([model.point3D_ids, point3D_ids]),
        points3D_rgb=np.concatenate([model.points3D_rgb, edges.colors]),
        track_offsets=np.concatenate([model.track_offsets, offsets]),
        track_views=np.concatenate([model.track_views, observed.views]),
        track_points2D=np.concatenate([model.track_points2D, observed.pixels]),
    )
