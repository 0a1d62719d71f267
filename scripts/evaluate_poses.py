#!/usr/bin/env python3
"""Pose errors before and after adjustments, of the demo or a scene of Strecha's benchmark."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import pycolmap

from colmap_edges.colmap.model import model_from_reconstruction
from colmap_edges.edges2d.working_scale import at_working_scale
from colmap_edges.errors import exit_on_error
from colmap_edges.evaluation.metrics.poses import (
    TruePoses,
    adjust_by_colmap,
    at_true_cameras,
    load_true_cameras,
    pose_errors,
    with_pose_noise,
)
from colmap_edges.evaluation.protocols.strecha import load_true_poses
from colmap_edges.evaluation.tables import markdown
from colmap_edges.options import PipelineOptions, resolved
from colmap_edges.pipeline.detect import detect_stage
from colmap_edges.pipeline.trace import edge_stages
from colmap_edges.runtime.stages import Stages

DEMO = Path(__file__).resolve().parents[1] / "tests" / "data" / "demo"
HEADER = (
    *("start", "noise px", "seed", "poses by", "centres rms", "rotations rms deg"),
    *("edge points", "held-out gains"),
)


@click.command(help=__doc__)
@click.option("--demo_path", type=Path, default=DEMO, show_default=True)
@click.option("--noise_px", "noises", type=float, multiple=True, default=(0.0, 0.2))
@click.option("--random_seed", "seeds", type=int, multiple=True, default=(0,), show_default=True)
@click.option("--num_threads", type=int, default=-1, show_default=True)
@click.option("--camera_path", type=Path, help="Folder of true NAME.camera files.")
@click.option("--image_path", type=Path, help="Images of this scene.")
@click.option("--input_path", type=Path, help="COLMAP model of this scene.")
@exit_on_error()
def main(
    demo_path: Path,
    noises: tuple[float, ...],
    seeds: tuple[int, ...],
    num_threads: int,
    camera_path: Path | None,
    image_path: Path | None,
    input_path: Path | None,
) -> None:
    options = PipelineOptions(refine_poses=True, num_threads=num_threads)
    if camera_path is None:
        images = demo_path / "images"
        cameras = load_true_cameras(demo_path / "true_cameras.json")
        sfm = pycolmap.Reconstruction(demo_path / "sparse")
        truth: TruePoses = cameras
        starts = [("true", at_true_cameras(sfm, cameras), noises), ("COLMAP's own", sfm, (0.0,))]
    elif image_path is None or input_path is None:
        raise click.UsageError("--camera_path needs --image_path and --input_path")
    else:
        images, truth = image_path, load_true_poses(camera_path)
        starts = [("COLMAP's own", pycolmap.Reconstruction(input_path), (0.0,))]
    rows: list[list[Any]] = []
    for name, source, levels in starts:
        model = at_working_scale(model_from_reconstruction(source), images, options.detection)
        graphs = detect_stage(model, images, options, Stages())
        for noise_px in levels:
            for seed in seeds if noise_px else (0,):
                start = with_pose_noise(source, noise_px, seed) if noise_px else source
                for by, result, *more in adjustments(start, model.scale, graphs, options):
                    errors = pose_errors(result, truth)
                    rows.append([name, noise_px, seed, by, *errors, *more])
    click.echo(markdown(HEADER, rows))


def adjustments(
    start: Any, scale: float, graphs: Any, options: PipelineOptions
) -> list[tuple[Any, ...]]:
    """Models by each adjustment, with the edge points before and after, and held-out gains."""
    rows: list[tuple[Any, ...]] = [("start", start, "", "")]
    for name, robust in (("SfM points (COLMAP)", False), ("SfM points (COLMAP, Cauchy)", True)):
        adjusted = pycolmap.Reconstruction(start)
        adjust_by_colmap(adjusted, poses=True, robust=robust)
        rows.append((name, adjusted, "", ""))
    stages = Stages()
    model = model_from_reconstruction(start).at_scale(scale)
    settings = resolved(options, scale)
    refined, _ = edge_stages(model, graphs, settings, stages)
    traced, refining, *again = [stage["counts"] for stage in stages.records()]
    counts = " -> ".join(str(c["edge_points"]) for c in (traced, *again))
    gains = ", ".join(f"{gain:+.1%}" for gain in refining.get("held_out_gains", []))
    rows.append(("SfM and edge points", refined.reconstruction, counts, gains))
    return rows


if __name__ == "__main__":
    main()
