"""Reconstruction of 3D edges as a Python function of a model or its path."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_edges.colmap.model import Model, observation_residuals
from colmap_edges.colmap.writing import extend_reconstruction
from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.checks import checked
from colmap_edges.core.edges3d import Edges3D, TracedEdges
from colmap_edges.edges2d.image_graphs import Visitors
from colmap_edges.edges2d.working_scale import at_working_scale
from colmap_edges.options import PipelineOptions, resolved
from colmap_edges.pipeline.detect import detect_stage
from colmap_edges.pipeline.mesh import background_stage, face_stage
from colmap_edges.pipeline.read import check_pictures, read_stage
from colmap_edges.pipeline.trace import edge_stages
from colmap_edges.report.diagnosis import diagnose
from colmap_edges.report.findings import Finding
from colmap_edges.runtime.executors import open_workers
from colmap_edges.runtime.stages import Stages
from colmap_edges.surfaces.faces.finding import NO_FACES, Faces
from colmap_edges.surfaces.faces.grids import GridTaker
from colmap_edges.surfaces.silhouettes import Background


@dataclass(frozen=True, kw_only=True)
class EdgeReconstruction:
    """The result of `reconstruct`.

    Attributes:
        edges: the 3D edges with their tracks.
        contours: view-dependent contours (silhouettes of smooth bodies, reflections) for `mesh`;
            they are not edges and not in `reconstruction`.
        point3D_ids: (N,) ids of the edge points in `reconstruction`; points of one node share one.
        reconstruction: a new pycolmap.Reconstruction: the input plus the edge points; poses and
            SfM points are unchanged unless `refine_poses` is set.
        residuals_px: (T,) reprojection error of each observation, pixels.
        background: background rays for `mesh`, of a plain backdrop or, with
            `masks_are_background`, of masked pixels; empty without a background.
        faces: planar faces between the edges, for `mesh`; empty if `use_faces` is 0.
        stages: records of the stages, as in report.json.
        findings: steps at which edges were lost, with remedies; empty if there is no problem.
    """

    edges: Edges3D
    contours: Edges3D
    point3D_ids: IntArray
    reconstruction: Any
    residuals_px: FloatArray
    background: Background | None
    faces: Faces
    stages: list[dict[str, Any]]
    findings: list[Finding]


@checked
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
            is not changed. All camera models with a focal length are supported; images without
            poses are ignored.
        image_path: folder of the images that the model was made from.
        options: options of all stages, for instance `preset("high")`.
        cache_path: folder in which edge graphs and edges are cached for later calls.
        mask_path: folder of masks named as in COLMAP, or one mask for all images; edges in black
            areas are ignored.
        edge_path: folder of edge images of another detector, white on black, named like masks;
            used instead of EdgeDrawing.

    Returns:
        The edges as arrays, and a new pycolmap.Reconstruction that contains the edge points.

    Raises:
        ColmapEdgesError: if an argument has the wrong type; the model is unreadable, inconsistent
            or has fewer than two images with poses; images, edge images or all masks are missing
            or have the wrong size; or fewer than two images are readable.
    """
    options = options or PipelineOptions()
    images = Path(image_path)
    cache = Path(cache_path) if cache_path else None
    masks = Path(mask_path) if mask_path else None
    maps = Path(edge_path) if edge_path else None
    stages = Stages()
    model = read_stage(reconstruction_or_path, stages, images)
    check_pictures(model, images, masks, maps, options)
    model = at_working_scale(model, images, options.detection)
    taker = GridTaker() if options.use_faces else None
    visitor = Visitors.of(taker)
    with open_workers(options, cache) as workers:
        detection = detect_stage(model, images, options, stages, visitor, workers, masks, maps)
        settings = resolved(options, model.scale)
        model, traced = edge_stages(model, detection, settings, stages, workers)
        detection.graphs.release()
    edges, faces = traced.edges, NO_FACES
    background = background_stage(model, detection, edges, options, stages)
    if taker:
        faces = face_stage(model, edges, taker.grids, options, stages, detection, background)
    return result_of(model, traced, background, faces, options, stages)


def result_of(
    model: Model,
    traced: TracedEdges,
    background: Background | None,
    faces: Faces,
    options: PipelineOptions,
    stages: Stages,
) -> EdgeReconstruction:
    """Make the result of `reconstruct`."""
    edges = traced.edges
    residuals = observation_residuals(model, edges)
    extended, ids = extend_reconstruction(model, edges, residuals)
    return EdgeReconstruction(
        edges=edges,
        contours=traced.contours,
        point3D_ids=ids,
        reconstruction=extended,
        residuals_px=residuals,
        background=background,
        faces=faces,
        stages=stages.records(),
        findings=diagnose(stages.records(), options),
    )
