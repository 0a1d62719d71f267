"""Make the demo scene: its surface, true curves, true cameras, images and sparse model.

Needs, in an environment of its own with Python 3.11 (Blender's wheel has no other):
    pip install bpy==5.0.1 manifold3d==3.5.4 pillow pycolmap==4.2.1
Everything is seeded; a render takes about 20 s on two cores.
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path

from demo_scene.bodies import make_bodies
from demo_scene.cameras import make_cameras, write_cameras
from demo_scene.geometry import true_curves, unite, write_curves, write_surface

DEMO = Path(__file__).resolve().parents[1] / "tests" / "data" / "demo"
STAGES = ("geometry", "images", "sparse")


def main() -> None:
    arguments = parse_arguments()
    folder: Path = arguments.output_path
    folder.mkdir(parents=True, exist_ok=True)
    if "geometry" in arguments.stages:
        make_geometry(folder)
    if "images" in arguments.stages:
        make_images(folder / "images", arguments.samples, arguments.scale_percent)
    if "sparse" in arguments.stages:
        make_sparse(folder / "images", folder / "sparse", arguments.database_path)


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output_path", type=Path, default=DEMO)
    parser.add_argument("--stages", nargs="+", choices=STAGES, default=STAGES)
    parser.add_argument("--samples", type=int, default=16, help="rays a pixel, denoised")
    parser.add_argument("--scale_percent", type=int, default=100, help="size, for quick looks")
    parser.add_argument("--database_path", type=Path, help="COLMAP database to keep and go on from")
    return parser.parse_args()


def make_geometry(folder: Path) -> None:
    """Write the true surface, the true curves and the true cameras."""
    bodies = make_bodies()
    surface = unite(bodies)
    curves = true_curves(surface, bodies)
    write_surface(folder / "surface.ply", surface)
    write_curves(folder / "curves.npz", curves, surface, bodies)
    write_cameras(folder / "true_cameras.json", make_cameras())
    print(
        f"{len(surface.faces)} triangles, {curves.curve_id.max() + 1} curves "
        f"of {len(curves.edges)} segments"
    )


def make_images(folder: Path, samples: int, scale_percent: int) -> None:
    """Render the views."""
    from demo_scene.render import render_views  # needs Blender

    bodies = make_bodies()
    render_views(folder, unite(bodies), bodies, make_cameras(), samples, scale_percent)


def make_sparse(images: Path, folder: Path, database: Path | None) -> None:
    """Write the sparse model of the images."""
    from demo_scene.reconstruct import reconstruct, summary

    cameras = make_cameras()
    model = reconstruct(images, cameras, database)
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    model.write_binary(folder)
    print(summary(model, cameras))


if __name__ == "__main__":
    main()
