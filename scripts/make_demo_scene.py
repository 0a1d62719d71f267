#!/usr/bin/env python3
"""Make the demo scene: its surface, true curves, true cameras, images and sparse model.

Needs a separate environment with Python 3.11, which Blender's wheel requires:
    pip install bpy==5.0.1 manifold3d==3.5.4 pillow pycolmap==4.2.1
All random numbers are seeded. A render takes about 20 s on two cores.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from demo_scene.bodies import make_bodies
from demo_scene.cameras import Intrinsics, TrueCamera, make_cameras, write_cameras
from demo_scene.geometry import true_curves, unite, write_curves, write_surface

DEMO = Path(__file__).resolve().parents[1] / "tests" / "data" / "demo"
STAGES = ("geometry", "images", "sparse")


def main() -> None:
    arguments = parse_arguments()
    folder: Path = arguments.output_path
    folder.mkdir(parents=True, exist_ok=True)
    cameras = make_cameras()[: arguments.num_views]
    intrinsics = Intrinsics(scale=arguments.scale_percent / 100)
    if "geometry" in arguments.stages:
        make_geometry(folder, cameras, intrinsics)
    if "images" in arguments.stages:
        make_images(folder / "images", cameras, arguments.samples, arguments.scale_percent)
    if "sparse" in arguments.stages:
        make_sparse(folder, cameras, intrinsics, arguments.database_path)


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output_path", type=Path, default=DEMO)
    parser.add_argument("--stages", nargs="+", choices=STAGES, default=STAGES)
    parser.add_argument("--samples", type=int, default=16, help="rays per pixel before denoising")
    parser.add_argument("--scale_percent", type=int, default=100, help="image size, for previews")
    parser.add_argument("--num_views", type=int, help="number of views; default: all")
    parser.add_argument("--database_path", type=Path, help="COLMAP database to keep and reuse")
    return parser.parse_args()


def make_geometry(folder: Path, cameras: list[TrueCamera], intrinsics: Intrinsics) -> None:
    """Write the true surface, the true curves and the true cameras."""
    bodies = make_bodies()
    surface = unite(bodies)
    curves = true_curves(surface, bodies)
    write_surface(folder / "surface.ply", surface)
    write_curves(folder / "curves.npz", curves, surface, bodies)
    write_cameras(folder / "true_cameras.json", cameras, intrinsics)
    print(
        f"{len(surface.faces)} triangles, {curves.curve_id.max() + 1} curves "
        f"of {len(curves.edges)} segments"
    )


def make_images(folder: Path, cameras: list[TrueCamera], samples: int, scale_percent: int) -> None:
    """Render the views."""
    from demo_scene.render import render_views  # needs Blender

    bodies = make_bodies()
    render_views(folder, unite(bodies), bodies, cameras, samples, scale_percent)


def make_sparse(
    folder: Path, cameras: list[TrueCamera], intrinsics: Intrinsics, database: Path | None
) -> None:
    """Write the sparse model of the images."""
    from demo_scene.reconstruct import reconstruct, summary

    model = reconstruct(folder / "images", cameras, intrinsics, database)
    shutil.rmtree(folder / "sparse", ignore_errors=True)
    (folder / "sparse").mkdir()
    model.write_binary(folder / "sparse")
    print(summary(model, cameras, intrinsics))


if __name__ == "__main__":
    main()
