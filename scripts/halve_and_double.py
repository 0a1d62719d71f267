#!/usr/bin/env python3
"""Halve and double every constant of the method, and print what changes.

DATA holds scenes as folders of images/ and sparse/ with references: curves.npz (or
gt_curves.npz, gt_edges.ply), reference_depth/, surface.ply (or gt_mesh.ply), as made by
scripts/make_cad_objects.py. If it has no scene `demo`, tests/data/demo is added. The figures of a
scene are the length of its edges, F against its curves (at 0.005 of their size) and, without curves
or for constants of the mesher, the mean absolute error of the mesh's depth. Detected and traced
edges are reused if a constant does not affect them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import Field, dataclass, fields, replace
from pathlib import Path
from typing import Any

import click
import numpy as np

from colmap_edges.declared_options import Options, derived, group_prefix, is_constant
from colmap_edges.errors import ColmapEdgesError, exit_on_error
from colmap_edges.evaluation.metrics.curves import compare_curves
from colmap_edges.evaluation.protocols.scene import default_thresholds, evaluate_mesh
from colmap_edges.evaluation.readers.curves import load_curves
from colmap_edges.options import PipelineOptions, TracingOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run

DEMO = Path(__file__).resolve().parents[1] / "tests" / "data" / "demo"
PAPER = ("matching", "correspondence", "following", "visibility", "sampling")
CURVES = ("curves.npz", "gt_curves.npz", "gt_edges.ply")
SURFACES = ("reference_depth", "surface.ply", "gt_mesh.ply")


@dataclass(frozen=True, kw_only=True)
class Constant:
    """A number of an option group: the group's name in `PipelineOptions` and its own field."""

    group: str
    entry: Field[Any]

    @property
    def name(self) -> str:
        """The name in docs/constants.md."""
        return group_prefix(type(getattr(PipelineOptions(), self.group))) + self.entry.name

    @property
    def of_mesh(self) -> bool:
        """Whether it affects only the mesh."""
        return self.group == "meshing"

    def base(self, options: PipelineOptions) -> PipelineOptions:
        """The options with which the constant has an effect."""
        if self.group in PAPER:
            return replace(options, tracing=TracingOptions(method="paper"))
        if self.group == "bundle_adjustment":
            return replace(options, refine_poses=True)
        if "regular" in self.entry.name or "smoothing" in self.entry.name:
            graph = replace(options.edge_graph, filter_regular_length=True)
            return replace(options, edge_graph=graph)
        if self.entry.name.startswith("vote"):
            return replace(options, meshing=replace(options.meshing, method="carve"))
        return options

    def others(self) -> Iterator[Any]:
        """Half and double of the value, clipped to the range."""
        value, group = self.entry.default, getattr(PipelineOptions(), self.group)
        for factor in (0.5, 2):
            given = type(value)(factor * value)
            changed = getattr(derived(group, **{self.entry.name: given}), self.entry.name)
            if changed != value:
                yield changed


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A scene, and the figures measured on it."""

    folder: Path
    cache_path: Path

    def known(self, names: tuple[str, ...]) -> Path | None:
        """The first existing file of some names."""
        return next((p for name in names if (p := self.folder / name).exists()), None)

    def figures(self, options: PipelineOptions, of_mesh: bool) -> dict[str, float]:
        """Length, F and MAE, as far as references exist; with `of_mesh` the mesh's only."""
        curves, surface = self.known(CURVES), self.known(SURFACES)
        meshed = surface is not None and (of_mesh or curves is None)
        with tempfile.TemporaryDirectory() as folder:
            output = Path(folder) / "out"
            paths = Paths(
                image_path=self.folder / "images",
                input_path=self.folder / "sparse",
                output_path=output,
                cache_path=self.cache_path,
            )
            run("mesh" if meshed else "reconstruct", paths, options)
            found: dict[str, float] = {}
            if not of_mesh:
                edges = load_curves(output / "edges.ply")
                found["length"] = float(edges.lengths().sum())
                if curves is not None:
                    true = load_curves(curves)
                    threshold = default_thresholds(true, False)[0]
                    found["F"] = compare_curves(edges, true, [threshold]).scores[0].f_score
            if meshed:
                record = evaluate_mesh(output / "mesh.ply", paths.input_path, surface)
                found["MAE"] = record["depth"]["pooled"]["mae"]
        return found


def numbers(with_options: bool) -> list[Constant]:
    """Every nonzero numeric constant and, on request, every such option."""
    found = []
    for whole in fields(PipelineOptions):
        group = getattr(PipelineOptions(), whole.name)
        for entry in fields(group) if isinstance(group, Options) else ():  # type: ignore[arg-type]
            wanted = (with_options or is_constant(entry)) and entry.metadata["within"]
            if wanted and entry.default != 0:
                found.append(Constant(group=whole.name, entry=entry))
    return found


def find_scenes(data: Path, names: tuple[str, ...], cache_path: Path) -> list[Scene]:
    """The named scenes of a folder; all if no name is given.

    Raises:
        ColmapEdgesError: if one is missing, or there is none.
    """
    found = {path.parent.name: path.parent for path in sorted(data.glob("*/sparse"))}
    found.setdefault("demo", DEMO)
    for name in names or found:
        if name not in found:
            raise ColmapEdgesError(f"{data} holds no scene {name}; it has {', '.join(found)}")
    return [Scene(folder=found[name], cache_path=cache_path) for name in names or found]


def shown(figures: dict[str, float]) -> str:
    """Figures as text."""
    return ", ".join(f"{name} {value:.4g}" for name, value in figures.items())


def compared(before: dict[str, float], after: dict[str, float]) -> str:
    """The relative change of each figure, in per cent."""
    return ", ".join(
        f"{name} {100 * (after[name] / value - 1):+.1f} %"
        for name, value in before.items()
        if value and np.isfinite(value) and np.isfinite(after[name])
    )


def rows(
    scenes: list[Scene], constants: list[Constant], options: PipelineOptions
) -> Iterator[list[str]]:
    """One row for the defaults, then one for each half and double as soon as it is measured."""
    before: dict[str, dict[str, float]] = {}
    for constant in constants:
        base = constant.base(options)
        for value in constant.others():
            group = derived(getattr(base, constant.group), **{constant.entry.name: value})
            changed = replace(base, **{constant.group: group})
            keys = [f"{scene.folder} {constant.of_mesh} {base}" for scene in scenes]
            if keys[0] not in before:
                found = [scene.figures(base, constant.of_mesh) for scene in scenes]
                before |= dict(zip(keys, found, strict=True))
                yield ["none", "", "", *map(shown, found)]
            cells = []
            for scene, key in zip(scenes, keys, strict=True):
                try:
                    after = scene.figures(changed, constant.of_mesh)
                    cells.append(compared(before[key], after))
                except ColmapEdgesError as error:
                    cells.append(f"fails: {error}")
            yield [f"`{constant.name}`", f"{constant.entry.default:g}", f"{value:g}", *cells]


@click.command(help=__doc__)
@click.argument("data", type=click.Path(path_type=Path, file_okay=False, exists=True))
@click.option("--scenes", "names", multiple=True, help="Scenes to run; default: all.")
@click.option("--constants", "chosen", multiple=True, help="Names, or groups; default: all.")
@click.option("--with_options", type=bool, default=False, help="Options that are numbers, too.")
@click.option("--cache_path", type=Path, help="Folder of reused results; default: temporary.")
@click.option("--num_threads", type=int, default=-1, show_default=True)
@exit_on_error()
def main(
    data: Path,
    names: tuple[str, ...],
    chosen: tuple[str, ...],
    with_options: bool,
    cache_path: Path | None,
    num_threads: int,
) -> None:
    constants = numbers(with_options)
    known = {name for c in constants for name in (c.name, c.name.partition(".")[0])}
    for name in chosen:
        if name not in known:
            raise ColmapEdgesError(f"there is no constant {name}; docs/constants.md lists them")
    if chosen:
        constants = [c for c in constants if {c.name, c.name.partition(".")[0]} & {*chosen}]
    options = PipelineOptions(report=False, num_threads=num_threads)
    with tempfile.TemporaryDirectory() as folder:
        scenes = find_scenes(data, names, cache_path or Path(folder))
        click.echo(f"| constant | is | set to | {' | '.join(s.folder.name for s in scenes)} |")
        click.echo(f"|{'---|' * (3 + len(scenes))}")
        for row in rows(scenes, constants, options):
            click.echo(f"| {' | '.join(row)} |")


if __name__ == "__main__":
    main()
