"""3D edges of a COLMAP model: the pipeline as a function of Python objects or paths."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_edges.colmap.model import Model, observation_residuals
from colmap_edges.colmap.writing import extend_reconstruction
from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.edges3d import Edges3D, TracedEdges
from colmap_edges.edges2d.working_scale import at_working_scale
from colmap_edges.errors import check_type
from colmap_edges.options import PipelineOptions, resolved
from colmap_edges.pipeline.detect import Detection, detect_stage
from colmap_edges.pipeline.read import check_model, check_pictures
from colmap_edges.pipeline.trace import edge_stages
from colmap_edges.report.diagnosis import Finding, diagnose
from colmap_edges.runtime.executors import open_workers
from colmap_edges.runtime.stages import Stages
from colmap_edges.surfaces.mesher import as_model
from colmap_edges.surfaces.silhouettes import Background, find_background


@dataclass(frozen=True, kw_only=True)
class EdgeReconstruction:
    """What `reconstruct` gives back.

    Attributes:
        edges: the 3D edges with their tracks.
        contours: view-dependent contours (silhouettes of smooth bodies, reflections), for `mesh`;
            they are no edges and not in `reconstruction`.
        point3D_ids: (N,) ids of the edge points in `reconstruction`; those of one node have one.
        reconstruction: a new pycolmap.Reconstruction: the input plus the edge points; its poses
            and SfM points are the input's unless `refine_poses` is set.
        residuals_px: (T,) distance of each observation from the projection of its edge point.
        background: what the sight of a plain backdrop or, with `masks_are_background`, of what
            masks hide says, for `mesh`; none where no such background is seen.
        stages: records of the stages, as in report.json.
        findings: where edges were lost and what to do about it; empty when all went well.
    """

    edges: Edges3D
    contours: Edges3D
    point3D_ids: IntArray
    reconstruction: Any
    residuals_px: FloatArray
    background: Background | None
    stages: list[dict[str, Any]]
    findings: list[Finding]


def reconstruct(
    reconstruction_or_path: Any,
    image_path: Path | str,
    options: PipelineOptions | None = None,
    cache_path: Path | str | None = None,
    mask_path: Path | str | None = None,
    edge_path: Path | str | None = None,
) -> EdgeReconstruction:
    """Reconstruct the 3D edges of a COLMAP model from its images.

    Args:
        reconstruction_or_path: the sparse model: its folder, or a pycolmap.Reconstruction, which
            is not changed. Cameras may be of any model, with distortion; images without poses are
            left out.
        image_path: folder of its images, as they were when the model was made.
        options: every stage's options, `preset("high")` for instance; defaults when not given.
        cache_path: folder of edge graphs and edges that later calls find again; none are kept
            when not given.
        mask_path: folder of masks named as COLMAP's are, or one mask of all images; edges are not
            looked for where they are black.
        edge_path: folder of edge images of another detector, white on black, named as masks are;
            their edges are taken in place of EdgeDrawing's.

    Returns:
        The edges as arrays, and a new pycolmap.Reconstruction with the edge points in it.

    Raises:
        ColmapEdgesError: when an argument is of another type, the model cannot be read, has fewer
            than two posed images or is inconsistent, or images, edge images or all masks are
            missing, of another size, or all images but one damaged.
    """
    options = options or PipelineOptions()
    check_type("options", options, (PipelineOptions,))
    images = path_of("image_path", image_path)
    cache = path_of("cache_path", cache_path) if cache_path else None
    masks = path_of("mask_path", mask_path) if mask_path else None
    maps = path_of("edge_path", edge_path) if edge_path else None
    stages = Stages()
    model = as_model(reconstruction_or_path)
    check_model(model, "the reconstruction")
    check_pictures(model, images, masks, maps, options)
    model = at_working_scale(model, images, options.detection)
    with open_workers(options, cache) as workers:
        detection = detect_stage(model, images, options, stages, None, workers, masks, maps)
        settings = resolved(options, model.scale)
        model, traced = edge_stages(model, detection, settings, stages, workers)
        detection.graphs.release()
    return result_of(model, detection, traced, options, stages)


def result_of(
    model: Model,
    detection: Detection,
    traced: TracedEdges,
    options: PipelineOptions,
    stages: Stages,
) -> EdgeReconstruction:
    """Gather what `reconstruct` gives back."""
    edges = traced.edges
    residuals = observation_residuals(model, edges)
    extended, ids = extend_reconstruction(model, edges, residuals)
    return EdgeReconstruction(
        edges=edges,
        contours=traced.contours,
        point3D_ids=ids,
        reconstruction=extended,
        residuals_px=residuals,
        background=find_background(
            model, detection.background_masks, options.masks_are_background, edges
        ),
        stages=stages.records(),
        findings=diagnose(stages.records(), options),
    )


def path_of(name: str, path: Path | str) -> Path:
    """The path that an argument gives.

    Raises:
        ColmapEdgesError: when it is of another type.
    """
    check_type(name, path, (str, os.PathLike))
    return Path(path)
