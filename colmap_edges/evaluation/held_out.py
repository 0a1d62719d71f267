"""Evaluation without ground truth, on held-out points and held-out images."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation import pictures
from colmap_edges.evaluation.metrics import depth
from colmap_edges.evaluation.metrics.clouds import cloud_to_cloud
from colmap_edges.evaluation.metrics.raycasting import RayCaster, seen_in
from colmap_edges.evaluation.metrics.statistics import Record, mean


def split_points(model: Model) -> tuple[Model, Model]:
    """Two models, each with a random half of the points."""
    chosen = np.zeros(len(model.points3D_xyz), dtype=bool)
    chosen[np.random.default_rng(0).permutation(len(chosen))[: len(chosen) // 2]] = True
    return model.selected(chosen), model.selected(~chosen)


def split_half_errors(model: Model, edges: Any = None, where: str = "the model") -> dict[str, Any]:
    """Mesh half of the SfM points, with `edges` if given, and compare it with the other half.

    Args:
        model: the model.
        edges: edges that the mesh follows.
        where: name of the model, for messages.

    Returns:
        Statistics of the depth errors at the observations of the other half, absolute (world
        units) and relative to depth, each with the share of observations that hit the mesh.

    Raises:
        ColmapEdgesError: The model holds fewer than 20 points.
    """
    from colmap_edges.surfaces.mesher import mesh

    if len(model.points3D_xyz) < 20:
        raise ColmapEdgesError(
            f"{where} holds too few points to leave half of them out; 20 are needed"
        )
    used, left_out = split_points(model)
    result = mesh(used, edges=edges)
    caster = RayCaster(result.vertices, result.faces)
    return depth.observation_depth_statistics(caster, left_out)


def left_out_views(views: Sequence[View], every: int) -> list[View]:
    """Every `every`-th view in order of names, from the middle of the first `every` on."""
    return list(views[every // 2 :: every])


def view_errors(pixels: FloatArray, view: View, chains: FloatArray) -> Record:
    """Distances of reprojected edge points (N, 2) to the chain points (M, 2) detected there.

    Returns:
        Name of the `view`, number of unoccluded `points`, their median distance `median_px`, shares
        `within_1_px` and `within_2_px`, and as a baseline the share of random pixels within two
        pixels, `chance_2_px`.
    """
    size = np.array([view.width, view.height])
    random = np.random.default_rng(0).uniform(0, 1, (10_000, 2)) * size
    distance, chance = (cloud_to_cloud(p, chains) for p in (pixels, random))
    return {
        "view": view.name,
        "points": len(distance),
        "median_px": float(np.median(distance)) if len(distance) else float("nan"),
        "within_1_px": mean(distance < 1),
        "within_2_px": mean(distance < 2),
        "chance_2_px": mean(chance < 2),
    }


def without_poses(model: Model, views: Sequence[View]) -> Any:
    """A copy of the model's pycolmap.Reconstruction with the frames of some views unregistered."""
    result = copy.deepcopy(model.reconstruction)
    for frame_id in sorted({result.images[view.image_id].frame_id for view in views}):
        result.deregister_frame(frame_id)
    return result


def left_out_view_errors(
    input_path: Path,
    image_path: Path,
    every: int,
    *,
    options: Any = None,
    pictures_path: Path | None = None,
) -> list[Record]:
    """Reconstruct edges without every `every`-th image and reproject them into those images.

    Occlusion is tested with a mesh of the used points and edges. With `pictures_path`, an overlay
    per view shows the points coloured by distance, 0 to 3 pixels.

    Raises:
        ColmapEdgesError: Too few images are left, or an image cannot be read.
    """
    from colmap_edges.edges2d.detection import detect_chains
    from colmap_edges.images.files import gray_of, read_image
    from colmap_edges.options import PipelineOptions
    from colmap_edges.pipeline.reconstruct import reconstruct
    from colmap_edges.surfaces.mesher import mesh

    model = load_model(input_path)
    unused = left_out_views(model.views, every)
    if not unused or len(model.views) - len(unused) < 3:
        raise ColmapEdgesError(
            f"{input_path}: {len(model.views)} images are too few to leave out every {every}th; "
            "raise --held_out_views"
        )
    # Faces and patches, which change no edge, are not asked for here; cameras and poses stay as
    # those of the left-out images do.
    asked = {"use_faces": False, "use_patches": False, "refine_poses": False}
    options = replace(options or PipelineOptions(), **asked)
    reconstruction = without_poses(model, unused)
    result = reconstruct(reconstruction, image_path, options)
    counts = {stage["name"]: stage["counts"] for stage in result.stages}
    found, scale = result.edges, counts["detect"]["image_scale"]
    surface = mesh(result.model, edges=found, background=result.background)
    caster = RayCaster(surface.vertices, surface.faces)
    errors = []
    for view in unused:
        image = read_image(view, image_path)
        chains = detect_chains(gray_of(image), options.detection, scale).points / scale
        projected, _, seen = seen_in(view, found.points, caster)
        pixels = projected[seen]
        errors.append(view_errors(pixels, view, chains))
        if pictures_path is not None:
            distances = cloud_to_cloud(pixels, chains)
            picture = pictures.draw_points(pictures.faint(image), pixels, distances, 3.0)
            pictures.write_png(pictures_path / pictures.file_name("held_out", view.name), picture)
    return errors
