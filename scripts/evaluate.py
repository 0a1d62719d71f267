#!/usr/bin/env python3
"""Measure meshes, 3D edges and poses; make the paper's tables over whole data sets.

Results of finished scenes are reused; remove a scene's folder below --output_path to redo it.
"""

from __future__ import annotations

from collections.abc import Container
from pathlib import Path
from typing import Any

import click
import numpy as np
import pycolmap

from colmap_edges.colmap.model import Model, load_model, model_from_reconstruction
from colmap_edges.core.view import View
from colmap_edges.edges2d.working_scale import at_working_scale
from colmap_edges.errors import ColmapEdgesError, exit_on_error
from colmap_edges.evaluation import benchmark, edge_errors, mesh_errors, tables
from colmap_edges.evaluation.layouts import dtu, neus, strecha
from colmap_edges.evaluation.layouts.scans import scan_scenes
from colmap_edges.evaluation.metrics import poses as pose_metrics
from colmap_edges.evaluation.scenes import Scene, model_scene
from colmap_edges.options import PipelineOptions, resolved
from colmap_edges.pipeline.detect import detect_stage
from colmap_edges.pipeline.trace import trace_stage
from colmap_edges.runtime.stages import Stages


@click.group(help=__doc__)
def main() -> None:
    pass


def pairs(_context: click.Context, _option: click.Parameter, entries: Any) -> dict[str, str]:
    """Names and paths of NAME=PATH entries."""
    parts = {name: path for name, _, path in (entry.partition("=") for entry in entries)}
    if not all((*parts, *parts.values())):
        raise click.BadParameter(f"{' '.join(entries)} is not of the form NAME=PATH")
    return parts


def positions(_context: click.Context, _option: click.Parameter, text: str) -> Container[int]:
    return dtu.parse_positions(text)


@main.command()
@click.option(
    "--scene",
    "models",
    type=(str, Path, Path, Path),
    multiple=True,
    metavar="NAME IMAGES SPARSE REFERENCE",
    help="A COLMAP model; REFERENCE is a folder of depth maps, a mesh or a point cloud.",
)
@click.option("--unit", default="world unit", show_default=True, help="Unit of their lengths.")
@click.option("--view_names", multiple=True, help="Views that see a reference mesh, or 'all'.")
@click.option(
    "--strecha",
    "folders",
    type=(Path, Path),
    multiple=True,
    metavar="FOLDER REFERENCE",
    help="A scene of Strecha's: images with .camera files.",
)
@click.option(
    "--dtu",
    "root",
    type=Path,
    help="Root of DTU, official (Rectified/scanN or Cleaned/scanN, Calibration/cal18, Points, "
    "ObsMask) or MVSNet's (Cameras, Rectified/scanN_train, Depths); or a NeuS/IDR folder (image/, "
    "cameras*.npz).",
)
@click.option(
    "--dtu_reference",
    type=Path,
    help="Of a NeuS/IDR folder: depth maps, mesh, cloud, or the root of the official data; of "
    "MVSNet's layout: that root.",
)
@click.option("--scans", type=int, multiple=True, help="Default: the paper's, where present.")
@click.option("--light", default="", help="Light of images: 'max', or '0_r5000' to '6_r5000'.")
@click.option(
    "--positions",
    default="all",
    show_default=True,
    metavar="odd|all|LIST",
    callback=positions,
    help="DTU's positions of the camera, counted from 1; a LIST as 1,3,5-9.",
)
@click.option("--methods", multiple=True, default=("SfM", "edges", "faces"), show_default=True)
@click.option(
    "--peers",
    multiple=True,
    callback=pairs,
    help="NAME=PATH of a system's results; {scene} in it varies, and {scan} of DTU.",
)
@click.option("--baseline", default="", help="Row of the average variation; [the first].")
@click.option("--output_path", type=Path, required=True, help="Folder for models, tables.")
def scenes(
    models: tuple[tuple[str, Path, Path, Path], ...],
    unit: str,
    view_names: tuple[str, ...],
    folders: tuple[tuple[Path, Path], ...],
    root: Path | None,
    output_path: Path,
    methods: tuple[str, ...],
    peers: dict[str, str],
    baseline: str,
    **of_dtu: Any,
) -> None:
    """Compute the paper's tables over COLMAP models, Strecha's and DTU's scenes together."""
    listed = [model_scene(*entry, view_names=view_names, unit=unit) for entry in models]
    listed += [strecha.folder_scene(*entry) for entry in folders]
    listed += [] if root is None else dtu_scenes(root, **of_dtu)
    if not listed:
        raise click.UsageError("give --scene, --strecha or --dtu")
    benchmark.run(
        listed, output_path, methods, peer_paths=peers, baseline=baseline, progress=click.echo
    )
    click.echo((output_path / "evaluation.md").read_text(encoding="utf-8"))


def dtu_scenes(
    root: Path, dtu_reference: Path | None, scans: tuple[int, ...], **choices: Any
) -> list[Scene]:
    """DTU's scenes below a root, or the one of a NeuS/IDR folder."""
    if not neus.is_layout(root):
        return scan_scenes(root, scans, reference_root=dtu_reference, **choices)
    if choices["light"] or choices["positions"] != dtu.EVERY_POSITION:
        raise click.UsageError("a NeuS/IDR folder has no --light and no --positions")
    return [neus.folder_scene(root, dtu_reference)]


@main.command("scene")
@click.option("--mesh_path", type=Path, required=True, help="Mesh to evaluate.")
@click.option("--input_path", type=Path, required=True, help="COLMAP model with the views.")
@click.option(
    "--reference_path",
    type=Path,
    help="Folder of depth maps (*.npz), a mesh or a point cloud; none: the depth at the "
    "observations of the points of --input_path (give points the mesh was made without).",
)
@click.option("--view_names", multiple=True, help="Views for a reference mesh, or 'all'.")
@click.option("--thresholds", multiple=True, type=float, help="Distances for precision, recall.")
@click.option("--output_path", type=Path, help="Folder for evaluation.json and error maps.")
def mesh(output_path: Path | None, **values: Any) -> None:
    """Errors of a mesh against depth maps, a mesh, a point cloud, or held-out SfM points."""
    record = mesh_errors.evaluate_mesh(**values, pictures_path=output_path)
    if output_path is not None:
        output_path.mkdir(parents=True, exist_ok=True)
        tables.write_figures(output_path / "evaluation.json", record)
    click.echo(tables.mesh_tables(record))


@main.command()
@click.option("--edges_path", type=Path, required=True, help="edges.ply, or a peer's lines.")
@click.option("--sparse_path", type=Path, required=True, help="COLMAP model with edge points.")
@click.option("--input_path", type=Path, help="Model without edge points.")
@click.option("--reference_path", type=Path, help="True curves: .npz (points, edges) or .ply.")
@click.option(
    "--surface_path",
    type=Path,
    help="True surface (.ply); recall then counts curves that three views see, at --thresholds_px.",
)
@click.option("--reference_depth_path", type=Path, help="Folder of depth maps (*.npz).")
@click.option(
    "--thresholds",
    multiple=True,
    type=float,
    help="Distances for precision and recall; default 0.005, 0.01, 0.02 of the reference's size.",
)
@click.option("--thresholds_px", multiple=True, type=float, default=(1.0, 2.0), show_default=True)
@click.option("--unit_size", type=bool, default=False, help="Scale the reference to size 1.")
@click.option("--crop", type=bool, default=False, help="Evaluate only inside the reference's box.")
@click.option("--output_path", type=Path, help="File for the figures as JSON.")
def edges(output_path: Path | None, **values: Any) -> None:
    """Errors of 3D edges against true curves, depth maps and their own observations."""
    record = edge_errors.evaluate_edges(**values)
    if output_path is not None:
        output_path.parent.mkdir(parents=True, exist_ok=True)
        tables.write_figures(output_path, record)
    click.echo(tables.edge_tables(record))


@main.command()
@click.option(
    "--demo_path",
    type=Path,
    default=Path(__file__).resolve().parents[1] / "tests" / "data" / "demo",
    show_default=True,
)
@click.option("--noise_px", "noises", type=float, multiple=True, default=(0.0, 0.2))
@click.option("--random_seed", "seeds", type=int, multiple=True, default=(0,), show_default=True)
@click.option("--num_threads", type=int, default=-1, show_default=True)
@click.option("--camera_path", type=Path, help="Folder of true NAME.camera files.")
@click.option("--image_path", type=Path, help="Images of this scene.")
@click.option("--input_path", type=Path, help="COLMAP model of this scene.")
def poses(
    demo_path: Path,
    noises: tuple[float, ...],
    seeds: tuple[int, ...],
    num_threads: int,
    camera_path: Path | None,
    image_path: Path | None,
    input_path: Path | None,
) -> None:
    """Pose errors before and after adjustments, of the demo or a scene of Strecha's benchmark."""
    options = PipelineOptions(refine_poses=True, num_threads=num_threads)
    if camera_path is None:
        images, cameras = demo_path / "images", demo_path / "true_cameras.json"
        truth = pose_metrics.load_true_cameras(cameras)
        sfm = pycolmap.Reconstruction(demo_path / "sparse")
        starts = [("true", pose_metrics.at_true_cameras(sfm, truth), noises)]
    elif image_path is None or input_path is None:
        raise click.UsageError("--camera_path needs --image_path and --input_path")
    else:
        images, truth = image_path, strecha.load_true_poses(camera_path)
        sfm, starts = pycolmap.Reconstruction(input_path), []
    rows: list[list[Any]] = []
    for name, source, levels in [*starts, ("COLMAP's own", sfm, (0.0,))]:
        model = at_working_scale(model_from_reconstruction(source), images, options.detection)
        graphs = detect_stage(model, images, options, Stages())
        for noise_px, seed in ((n, s) for n in levels for s in (seeds if n else (0,))):
            start = pose_metrics.with_pose_noise(source, noise_px, seed) if noise_px else source
            for by, result, *more in adjustments(start, model.scale, graphs, options):
                errors = pose_metrics.pose_errors(result, truth)
                rows.append([name, noise_px, seed, by, *errors, *more])
    header = ["start", "noise px", "seed", "poses by", "centres rms", "rotations rms deg"]
    click.echo(tables.markdown([*header, "edge points", "held-out gain"], rows))


def adjustments(
    start: Any, scale: float, graphs: Any, options: PipelineOptions
) -> list[tuple[Any, ...]]:
    """Models by each adjustment, with the edge points, and the held-out gain."""
    rows: list[tuple[Any, ...]] = [("start", start, "", "")]
    for name, robust in (("SfM points (COLMAP)", False), ("SfM points (COLMAP, Cauchy)", True)):
        adjusted = pycolmap.Reconstruction(start)
        pose_metrics.adjust_by_colmap(adjusted, poses=True, robust=robust)
        rows.append((name, adjusted, "", ""))
    stages = Stages()
    model = model_from_reconstruction(start).at_scale(scale)
    refined, _ = trace_stage(model, graphs, resolved(options, scale), stages)
    (traced,) = [stage["counts"] for stage in stages.records()]
    counts, refining = str(traced["edge_points"]), traced["details"]["poses"]
    gain = f"{refining['held_out_gain']:+.1%}" if "held_out_gain" in refining else ""
    rows.append(("SfM and edge points", refined.reconstruction, counts, gain))
    return rows


@main.command()
@click.option("--layout", "name", type=click.Choice(["neus", "strecha"]), required=True)
@click.option("--image_path", type=Path, required=True, help="Folder of the images.")
@click.option("--input_path", type=Path, required=True, help="COLMAP model.")
@click.option("--output_path", type=Path, required=True, help="Folder to write to.")
def layout(name: str, image_path: Path, input_path: Path, output_path: Path) -> None:
    """Write an undistorted COLMAP model's images and poses in the layout of a benchmark.

    neus: image/ and cameras_sphere.npz, a common form of DTU. strecha: images with .camera files.
    Images are linked, not copied.
    """
    model = load_model(input_path)
    for view in model.views:
        if not view.camera.is_undistorted():
            raise ColmapEdgesError(
                f"{view.name} is distorted, which neither layout supports; undistort it first"
            )
    folder = output_path / "image" if name == "neus" else output_path
    folder.mkdir(parents=True, exist_ok=True)
    for view in model.views:
        link = folder / Path(view.name).name
        link.unlink(missing_ok=True)
        link.symlink_to((image_path / view.name).resolve(strict=True))
    (write_neus if name == "neus" else write_strecha)(model, output_path)


def calibration(view: View) -> np.ndarray:
    return np.asarray(view.camera.calibration_matrix())


def write_neus(model: Model, folder: Path) -> None:
    center = model.points3D_xyz.mean(axis=0)
    radius = float(np.quantile(np.linalg.norm(model.points3D_xyz - center, axis=1), 0.95))
    scale = np.diag([radius, radius, radius, 1.0])
    scale[:3, 3] = center
    matrices = {}
    for index, view in enumerate(sorted(model.views, key=lambda view: view.name)):
        world = np.eye(4)
        world[:3] = calibration(view) @ np.column_stack([view.rotation, view.translation])
        matrices |= {f"world_mat_{index}": world, f"scale_mat_{index}": scale}
    np.savez(folder / "cameras_sphere.npz", **matrices)


def write_strecha(model: Model, folder: Path) -> None:
    for view in model.views:
        rows = [*calibration(view), np.zeros(3), *view.rotation.T, view.center]
        lines = [" ".join(repr(float(value)) for value in row) for row in rows]
        path = folder / f"{Path(view.name).name}.camera"
        path.write_text("\n".join([*lines, f"{view.width} {view.height}"]) + "\n")


if __name__ == "__main__":
    with exit_on_error(OSError):
        main()
