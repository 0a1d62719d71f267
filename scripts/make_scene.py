#!/usr/bin/env python3
"""Make a scene with its truth: a random one of a family, or a fixed one.

SCENE is a seed for a random scene of the families rooms, facades, cad, smooth and clutter. Fixed
scenes have names: rooms living, attic, corridor; cad bracket, gear, shaft, tray, elbow, plate,
impeller, wedge, knob; demo geometry, images, sparse, or all of these three.

Needs manifold3d in addition to the extra "evaluation". The folder holds images/, sparse/,
surface.ply and curves.npz; of random scenes also true_cameras.json, and all that was drawn in
scene.json. The same scene has the same bytes each time. To render the demo takes Blender, and an
environment of its own with Python 3.11:

pip install bpy==5.0.1 manifold3d==3.5.4 pycolmap==4.2.1 pillow click embreex scipy trimesh
"""

from __future__ import annotations

from pathlib import Path

import click
from zoo import FAMILIES


class Size(click.ParamType):
    """Width and height as in 640x480."""

    name = "WIDTHxHEIGHT"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        """Read both numbers."""
        numbers = str(value).split("x")
        if len(numbers) != 2 or not all(n.isdigit() and int(n) >= 16 for n in numbers):
            self.fail(f"{value} is no size; give width and height such as 640x480", param, ctx)
        return int(numbers[0]), int(numbers[1])


@click.command(help=__doc__)
@click.argument("family", type=click.Choice([*FAMILIES, "demo"]))
@click.argument("scene")
@click.option("--output_path", type=Path, required=True, help="Folder for the scene.")
@click.option("--size", type=Size(), help="Of the images; default: the family's own.")
@click.option("--num_views", type=click.IntRange(2), help="Number of views; default: the scene's.")
@click.option("--seed", type=click.IntRange(0), default=0, help="Of the noise in a fixed scene.")
def main(
    family: str,
    scene: str,
    output_path: Path,
    size: tuple[int, int] | None,
    num_views: int | None,
    seed: int,
) -> None:
    # Each needs other libraries.
    if family == "demo":
        from zoo.demo import STAGES, make_demo

        names, make = STAGES, make_demo
    else:
        from zoo.fixed import FIXED

        names, make = FIXED.get(family, ((), None))
    if scene in names:
        click.echo(make(scene, output_path, size=size, num_views=num_views, seed=seed))
    elif scene.isdigit() and family in FAMILIES:
        from zoo.make import make_scene

        make_scene(family, int(scene), output_path, size=size, num_views=num_views)
    else:
        known = [*names, *(["a seed, such as 0"] if family in FAMILIES else [])]
        raise click.UsageError(f"{family} has no scene {scene}; give {', '.join(known)}")


if __name__ == "__main__":
    main()
