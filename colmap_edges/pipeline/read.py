"""The reading stage: loads the model and checks that images, masks and edge images exist."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.core.checks import check_points
from colmap_edges.core.view import track_residuals
from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.images.edge_maps import check_edge_maps
from colmap_edges.images.files import check_images_exist
from colmap_edges.images.masks import check_masks
from colmap_edges.options import PipelineOptions
from colmap_edges.runtime.stages import Stages


def read_stage(input_path: Path, stages: Stages) -> Model:
    """Read the model.

    Raises:
        ColmapEdgesError: if it cannot be read or has fewer than two images with poses.
    """
    with stages.stage("read") as stage:
        model = load_model(input_path)
        check_model(model, str(input_path))
        stage.counts = model_counts(model)
    return model


def check_model(model: Model, where: str) -> None:
    """Check that the model has enough images, in units of a usual size.

    Raises:
        ColmapEdgesError: if fewer than two images have poses, or coordinates are too small.
    """
    if len(model.views) < 2:
        raise ColmapEdgesError(
            f"{where} has {len(model.views)} images with poses; "
            "3D edges need at least 3: run `colmap mapper` on more images first"
        )
    check_points(f"the points of {where}", model.points3D_xyz)


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
    elif options.masks_are_background:
        raise OptionError("masks_are_background is 1, but there are no masks; give mask_path")


def model_counts(model: Model) -> dict[str, Any]:
    """Counts of the input model."""
    return {
        "images_with_poses": len(model.views),
        "images_without_poses": len(model.unposed_names),
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
