#!/usr/bin/env python3
"""Make furnished, mostly plain rooms seen from inside, with ground truth.

Needs manifold3d in addition to the extra "evaluation". Each room is a folder of images/, sparse/
(true poses and SIFT points), surface.ply and curves.npz, for `colmap-edges mesh`,
scripts/evaluate.py scene and scripts/evaluate.py edges. A room takes 1 to 2 minutes on a core.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from demo_scene.cameras import TrueCamera
from demo_scene.geometry import true_curves, unite, write_curves, write_surface
from rooms.light import illuminate
from rooms.plans import ROOMS
from rooms.render import Pinhole, write_images

from colmap_edges.evaluation.triangulation import PosedImage, triangulate

CUT = 0.1  # maximum side of the triangles for which light is computed, metres
SIZE = (640, 480)  # pixels


@click.command(help=__doc__)
@click.option("--output_path", type=Path, required=True, help="Folder for the rooms' folders.")
@click.option(
    "--names",
    multiple=True,
    type=click.Choice(list(ROOMS)),
    default=list(ROOMS),
    help="Rooms to make; default: all.",
)
@click.option("--num_views", type=click.IntRange(2), help="The first views; default: all.")
@click.option("--size", type=click.IntRange(16), nargs=2, default=SIZE, show_default=True)
@click.option(
    "--cut", type=float, default=CUT, show_default=True, help="Side of triangles for light, metres."
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of noise and rays.")
def main(
    output_path: Path,
    names: tuple[str, ...],
    num_views: int | None,
    size: tuple[int, int],
    cut: float,
    seed: int,
) -> None:
    for name in names:
        room, folder = ROOMS[name](), output_path / name
        folder.mkdir(parents=True, exist_ok=True)
        surface = unite(room.bodies)
        write_surface(folder / "surface.ply", surface)
        curves = true_curves(surface, room.bodies)
        write_curves(folder / "curves.npz", curves, surface, room.bodies)
        cameras, pinhole = room.cameras[:num_views], Pinhole(width=size[0], height=size[1])
        lit = illuminate(unite(room.bodies, longest=cut), room, seed)
        write_images(lit, cameras, pinhole, folder / "images", seed)
        posed = [posed_image(camera, pinhole) for camera in cameras]
        model = triangulate(posed, folder / "images", folder / "sparse", num_threads=1)
        click.echo(
            f"{name}: {len(surface.faces)} triangles, {len(curves.edges)} segments of curves, "
            f"{len(cameras)} views, {model.num_points3D()} points"
        )


def posed_image(camera: TrueCamera, pinhole: Pinhole) -> PosedImage:
    """A view with its true pose."""
    focal = pinhole.focal
    calibration = [[focal, 0, pinhole.width / 2], [0, focal, pinhole.height / 2], [0, 0, 1]]
    return PosedImage(
        name=camera.name,
        width=pinhole.width,
        height=pinhole.height,
        calibration=np.array(calibration),
        rotation=camera.cam_from_world[:, :3],
        translation=camera.cam_from_world[:, 3],
    )


if __name__ == "__main__":
    main()
