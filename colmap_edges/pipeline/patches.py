"""The stage that finds patches: points where images have texture."""

from __future__ import annotations

from collections.abc import Mapping

from colmap_edges.colmap.model import Model
from colmap_edges.core.edges3d import TracedEdges
from colmap_edges.images.background import Backgrounds
from colmap_edges.options import PipelineOptions
from colmap_edges.runtime.executors import thread_count
from colmap_edges.runtime.stages import Stages
from colmap_edges.surfaces.faces.grids import Grid, with_backgrounds
from colmap_edges.surfaces.patches.finding import Patches, find_patches
from colmap_edges.surfaces.patches.outlines import with_outlines


def patch_stage(
    model: Model,
    traced: TracedEdges,
    pictures: Mapping[int, Grid],
    options: PipelineOptions,
    stages: Stages,
    hidden: Backgrounds,
) -> Patches:
    """Find patches, and append points on outlines of smooth bodies, which meshes may lack, too.

    `pictures` are the views' images without distortion, `hidden` is the background of all views.
    """
    with stages.stage("patches") as stage:
        shown = with_backgrounds(model.views, pictures, hidden)
        given = (model, traced.edges, shown, options.random_seed)
        patches = find_patches(*given, thread_count(options))
        stage.counts = {
            "windows_with_texture": patches.num_sites,
            "windows_with_depth": patches.num_found,
            "windows_agreed": patches.num_agreed,
            "patches": len(patches.sigmas),
        }
    return with_outlines(patches, traced.outlines)
