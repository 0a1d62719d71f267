"""Reconstruction of 3D edges as a Python function of a model or its path."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from colmap_edges.colmap.model import Model, observation_residuals
from colmap_edges.colmap.writing import extend_reconstruction
from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.checks import checked
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges2d.working_scale import at_working_scale
from colmap_edges.images.background import BackgroundRays
from colmap_edges.options import PipelineOptions, resolved
from colmap_edges.pipeline.found import Found, find_edges
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.read import check_pictures, read_stage
from colmap_edges.report.diagnosis import diagnose
from colmap_edges.report.findings import Finding
from colmap_edges.runtime.executors import open_workers
from colmap_edges.runtime.stages import Stages
from colmap_edges.surfaces.faces.finding import Faces
from colmap_edges.surfaces.patches.finding import Patches


@dataclass(frozen=True, kw_only=True)
class EdgeReconstruction:
    """The result of `reconstruct`.

    Attributes:
        edges: the 3D edges with their tracks.
        curves: the lines, arcs, circles, ellipses and splines that fit them.
        contours: view-dependent contours (silhouettes of smooth bodies, reflections) for `mesh`;
            they are not edges and not in `reconstruction`.
        point3D_ids: (N,) ids of the edge points in `reconstruction`; points of one node share one.
        reconstruction: a new pycolmap.Reconstruction: the input plus the edge points; cameras,
            poses and SfM points are refined ones if left-out points fit these better.
        model: the same without the edge points, for `mesh`.
        residuals_px: (T,) reprojection error of each observation, pixels.
        background: background rays for `mesh`, of a plain backdrop, of the sky or, with
            `masks_are_background`, of masked pixels; None without a background.
        faces: planar faces between the edges, for `mesh`; empty if `use_faces` is 0.
        patches: points where images have texture, for `mesh`; empty if `use_patches` is 0.
        stages: records of the stages, as in report.json.
        findings: steps at which edges were lost, with remedies; empty if there is no problem.
    """

    edges: Edges3D
    curves: Curves3D
    contours: Edges3D
    point3D_ids: IntArray
    reconstruction: Any
    model: Model
    residuals_px: FloatArray
    background: BackgroundRays | None
    faces: Faces
    patches: Patches
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
    given = (image_path, mask_path, edge_path, cache_path)
    images, masks, maps, cache = (Path(path) if path else None for path in given)
    paths, images = Paths(image_path=images, mask_path=masks, edge_path=maps), Path(image_path)
    stages = Stages()
    model = read_stage(reconstruction_or_path, stages, images)
    check_pictures(model, images, masks, maps, options)
    model = at_working_scale(model, images, options.detection)
    with open_workers(options, cache) as workers:
        settings = resolved(options, model.scale)
        found = find_edges(model, paths, settings, stages, workers, for_mesh=True)
    return result_of(found, options, stages)


def result_of(found: Found, options: PipelineOptions, stages: Stages) -> EdgeReconstruction:
    """Make the result of `reconstruct`."""
    edges = found.traced.edges
    residuals = observation_residuals(found.model, edges)
    extended, ids = extend_reconstruction(found.model, edges, residuals)
    return EdgeReconstruction(
        edges=edges,
        curves=found.curves,
        contours=found.traced.contours,
        point3D_ids=ids,
        reconstruction=extended,
        model=found.model,
        residuals_px=residuals,
        background=found.background,
        faces=found.faces,
        patches=found.patches,
        stages=stages.records(),
        findings=diagnose(stages.records(), options),
    )
