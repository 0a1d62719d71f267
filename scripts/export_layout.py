#!/usr/bin/env python3
"""Write an undistorted COLMAP model's images and poses in the layout of a benchmark.

neus: image/ and cameras_sphere.npz, a common form of DTU. strecha: images with .camera files.
Images are linked, not copied.
"""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError, exit_on_error


@click.command(help=__doc__)
@click.option("--layout", type=click.Choice(["neus", "strecha"]), required=True)
@click.option("--image_path", type=Path, required=True, help="Folder of the images.")
@click.option("--input_path", type=Path, required=True, help="COLMAP model.")
@click.option("--output_path", type=Path, required=True, help="Folder to write to.")
@exit_on_error(OSError)
def main(layout: str, image_path: Path, input_path: Path, output_path: Path) -> None:
    model = load_model(input_path)
    distorted = [view.name for view in model.views if not view.camera.is_undistorted()]
    if distorted:
        raise ColmapEdgesError(
            f"{distorted[0]} is distorted, which neither layout supports; undistort it first"
        )
    folder = output_path / "image" if layout == "neus" else output_path
    folder.mkdir(parents=True, exist_ok=True)
    for view in model.views:
        link(image_path / view.name, folder / Path(view.name).name)
    (write_neus if layout == "neus" else write_strecha)(model, output_path)


def link(source: Path, target: Path) -> None:
    target.unlink(missing_ok=True)
    target.symlink_to(source.resolve(strict=True))


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
        size = f"{view.width} {view.height}"
        path = folder / f"{Path(view.name).name}.camera"
        path.write_text("\n".join([*lines, size]) + "\n")


if __name__ == "__main__":
    main()
