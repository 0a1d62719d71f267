"""The stage that reads a dense cloud and makes it ready for the mesher."""

from __future__ import annotations

from pathlib import Path

from colmap_edges.colmap.clouds import image_names
from colmap_edges.colmap.model import Model, load_model
from colmap_edges.colmap.workspace import find_model
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.runtime.executors import thread_count
from colmap_edges.runtime.stages import Stages
from colmap_edges.surfaces.dense.cloud import DenseCloud
from colmap_edges.surfaces.dense.given import given_cloud


def dense_stage(
    model: Model, paths: Paths, options: PipelineOptions, stages: Stages
) -> DenseCloud | None:
    """Read the cloud of a dense workspace, or of given files; None without one."""
    if not paths.dense_path and not paths.points:
        return None
    points, visibility, names = paths.points, paths.visibility, None
    with stages.stage("dense") as stage:
        if paths.dense_path:
            points, visibility = files_of_workspace(paths.dense_path)
            names = image_names(load_model(find_model(paths.dense_path)).reconstruction)
        threads = thread_count(options)
        cloud = given_cloud(points, visibility, model, options.dense, threads, names)
        if cloud:
            stage.counts = {
                "points_read": cloud.num_read,
                "points_kept": len(cloud.points.points),
                "observations": len(cloud.points.track_views),
                "shift_px": cloud.shift_px.round(3).tolist(),
                "noise_px": round(cloud.noise_px, 3),
            }
    return cloud


def files_of_workspace(dense_path: Path) -> tuple[Path, Path | None]:
    """The cloud of COLMAP's dense workspace, and its visibility, if there is one.

    Raises:
        ColmapEdgesError: if there is no cloud.
    """
    points = dense_path / "fused.ply"
    if not points.is_file():
        raise ColmapEdgesError(
            f"dense_path {dense_path} has no fused.ply; run `colmap stereo_fusion` on it first"
        )
    visibility = dense_path / "fused.ply.vis"
    return points, visibility if visibility.is_file() else None
