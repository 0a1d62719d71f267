"""The reading stage: loads the model, drops copies of images, checks images, masks, edge images."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from colmap_edges.colmap.model import Model
from colmap_edges.colmap.workspace import other_models
from colmap_edges.core.checks import check_points
from colmap_edges.core.groups import linked_groups
from colmap_edges.core.view import View, track_residuals
from colmap_edges.errors import ColmapEdgesError, ImageError, OptionError
from colmap_edges.images.edge_maps import check_edge_maps
from colmap_edges.images.files import (
    alpha_of,
    check_images_exist,
    count_images,
    path_of_image,
    read_bytes,
    same_files,
)
from colmap_edges.images.masks import check_masks
from colmap_edges.options import PipelineOptions
from colmap_edges.runtime.stages import Stages
from colmap_edges.surfaces.mesher import as_model


def read_stage(source: Any, stages: Stages, image_path: Path | None = None) -> Model:
    """Read a model, without copies of its images.

    Args:
        source: its folder, a pycolmap.Reconstruction, or a model.
        stages: the stages of the run.
        image_path: folder of the images, if they are used.

    Raises:
        ColmapEdgesError: if it cannot be read or has fewer than two images with poses.
    """
    with stages.stage("read") as stage:
        model = as_model(source)
        where = str(source) if isinstance(source, str | os.PathLike) else "the reconstruction"
        num_files = count_images(image_path) if image_path else 0
        check_model(model, where, num_files)
        if image_path:
            model = without_copies(model, image_path)
        stage.counts = model_counts(model) | {"image_files": num_files}
        if isinstance(source, str | os.PathLike):
            folder = Path(os.path.abspath(source))  # noqa: PTH100 - links keep their names
            stage.counts |= {
                "model": f"{folder.parent.name}/{folder.name}",
                "other_models": other_models(folder),
            }
    return model


def check_model(model: Model, where: str, num_files: int = 0) -> None:
    """Check that the model has enough images, in units of a usual size.

    Args:
        model: the model.
        where: its name, for messages.
        num_files: number of image files; 0 if unknown.

    Raises:
        ColmapEdgesError: if fewer than two images have poses, or coordinates are too small.
    """
    if len(model.views) < 2:
        total = max(num_files, len(model.views) + len(model.unposed_names))
        of_all = f", of {total}" if total > 2 else ""
        remedy = "after its log about the others" if of_all else "with more images"
        raise ColmapEdgesError(
            f"{where} has {len(model.views)} images with poses{of_all}; 3D edges need at least 3: "
            f"run `colmap mapper` again, {remedy}"
        )
    check_points(f"the points of {where}", model.points3D_xyz)


def without_copies(model: Model, image_path: Path) -> Model:
    """The model without views that are copies of others, which add no evidence.

    A copy has the camera and, up to rounding, the pose of another view, or the same file at nearly
    the same pose. The view with the most observations is kept.

    Raises:
        ColmapEdgesError: if one file has two different poses.
    """
    pairs = copied_pairs(model.views, image_path)
    if pairs:
        counts = np.bincount(model.track_views, minlength=len(model.views))
        groups = linked_groups(np.array(pairs), len(counts))
        order = np.lexsort([-counts, groups])  # most observations first, then the first name
        first = np.unique(groups[order], return_index=True)[1]
        originals = order[first][groups]
        copies = np.flatnonzero(originals != np.arange(len(groups)))
        named = tuple((model.views[i].name, model.views[originals[i]].name) for i in copies)
        model = replace(model.without_views(copies), copies=named)
    check_one_name_a_file(model.views)
    return model


def copied_pairs(views: Sequence[View], image_path: Path) -> list[tuple[int, int]]:
    """Pairs of indices of views of which one is a copy of the other.

    Poses are compared by the rotation matrix, and the centre in extents of the camera's path.
    """
    poses = np.array([[*view.rotation.ravel(), *view.center] for view in views])
    poses[:, 9:] /= max(float(np.ptp(poses[:, 9:], axis=0).max()), np.finfo(float).tiny)
    pairs = [
        (first, second)
        for first, second in sorted(cKDTree(poses).query_pairs(1e-9))
        if lens_of(views[first]) == lens_of(views[second])
    ]
    for group in same_files(views, image_path):
        for first, second in combinations(group, 2):
            if np.linalg.norm(poses[first] - poses[second]) < 0.01:
                pairs.append((first, second))
    return pairs


def lens_of(view: View) -> tuple[Any, ...]:
    """A view's camera as values that can be compared."""
    camera = view.camera
    return camera.model, view.width, view.height, *map(float, camera.params)


def check_one_name_a_file(views: Sequence[View]) -> None:
    """Check that no two views are of one file.

    Raises:
        ColmapEdgesError: naming two that are.
    """
    names: dict[PurePosixPath, str] = {}
    for view in views:
        path = PurePosixPath(view.name)  # without "./" and "//"
        if path in names:
            raise ColmapEdgesError(
                f"the images {names[path]} and {view.name} of the model are one file at two poses; "
                "delete one from the model"
            )
        names[path] = view.name


def check_pictures(
    model: Model,
    image_path: Path,
    mask_path: Path | None,
    edge_path: Path | None,
    options: PipelineOptions,
) -> None:
    """Check that images exist, and masks and edge images if their paths are given.

    Raises:
        ColmapEdgesError: if they do not.
    """
    check_images_exist(model.views, image_path)
    if edge_path:
        check_edge_maps(model.views, image_path, edge_path)
    if mask_path:
        check_masks(model.views, mask_path)
    elif options.masks_are_background and not any_transparent(model.views, image_path):
        raise OptionError("masks_are_background is 1, but there are no masks; give mask_path")


def any_transparent(views: Sequence[View], image_path: Path) -> bool:
    """Whether an image has transparent pixels, which are masked."""
    for view in views:
        with suppress(ImageError):
            if alpha_of(read_bytes(path_of_image(image_path, view.name))) is not None:
                return True
    return False


def model_counts(model: Model) -> dict[str, Any]:
    """Counts of the input model."""
    return {
        "images_with_poses": len(model.views),
        "images_without_poses": len(model.unposed_names),
        **({"images_contradicted": model.contradicted_names} if model.contradicted_names else {}),
        **({"images_copied": model.copies} if model.copies else {}),
        "points3D": len(model.point3D_ids),
        **({"points3D_too_far": len(model.far_point3D_ids)} if len(model.far_point3D_ids) else {}),
        "observations": len(model.track_views),
        "median_residual_px": median_residual(model),
    }


def median_residual(model: Model) -> float | None:
    """Median reprojection error of the SfM points in pixels; None without observations."""
    points = model.points3D_xyz[model.track_points]
    residuals = track_residuals(model.views, points, model.track_views, model.track_points2D)
    residuals = residuals[np.isfinite(residuals)]
    return round(float(np.median(residuals)), 4) if len(residuals) else None
