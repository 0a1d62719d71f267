#!/usr/bin/env python3
"""Make a random scene of a family with its truth.

Needs manifold3d in addition to the extra "evaluation". The folder holds images/, sparse/ (with
errors of poses and points), surface.ply, curves.npz, true_cameras.json, and all that was drawn in
scene.json. The same family and seed give the same scene.
"""

from __future__ import annotations

from pathlib import Path

import click
from zoo.make import FAMILIES, SIZE, make_scene


class Size(click.ParamType):
    """Width and height as in 640x480."""

    name = "WIDTHxHEIGHT"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """Read both numbers."""
        if isinstance(value, tuple):
            return value
        numbers = str(value).split("x")
        if len(numbers) != 2 or not all(n.isdigit() and int(n) >= 16 for n in numbers):
            self.fail(f"{value} is no size; give width and height such as 640x480", param, ctx)
        return int(numbers[0]), int(numbers[1])


@click.command(help=__doc__)
@click.argument("family", type=click.Choice(FAMILIES))
@click.argument("seed", type=click.IntRange(0))
@click.option("--output_path", type=Path, required=True, help="Folder for the scene.")
@click.option("--size", type=Size(), default=SIZE, help="Of the images; default: 640x480.")
@click.option("--num_views", type=click.IntRange(2), help="Number of views; default: random.")
def main(
    family: str, seed: int, output_path: Path, size: tuple[int, int], num_views: int | None
) -> None:
    make_scene(family, seed, output_path, size=size, num_views=num_views)


if __name__ == "__main__":
    main()
