#!/usr/bin/env python3
"""Measure wall seconds, CPU seconds and peak memory of the stages, as medians over runs.

Scenes are folders with images and a COLMAP model, or synthetic cities of any number of images. With
--compare or --setting, two variants run alternately, so that other load affects both alike. Writes
JSON and prints a table.

Examples:
  scripts/benchmark.py --data_path ../shared/data --scene fountain-P11
  scripts/benchmark.py --synthetic 200 --synthetic 2000 --runs 1
  scripts/benchmark.py --data_path ../shared/data --compare main
  scripts/benchmark.py --synthetic 100 --setting "--ChainDepth.sample_step_points 8"
"""

from __future__ import annotations

import json
import os
import platform
import shlex
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

import colmap_edges
from colmap_edges.colmap.workspace import find_images, find_model
from colmap_edges.errors import ColmapEdgesError, exit_on_error
from colmap_edges.evaluation.tables import markdown

ROOT = Path(__file__).resolve().parents[1]
MEASURES = ("wall_s", "cpu_s", "peak_mb")
WHOLE = "whole process"
Stages = dict[str, dict[str, Any]]  # entries of report.json by stage


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A scene: a folder with images and a model, or a synthetic city of `num_views` images."""

    name: str
    path: Path
    num_views: int = 0


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A variant: a source tree and flags."""

    name: str
    tree: Path
    flags: tuple[str, ...]


@click.command(help=__doc__.replace("\n\n", "\n\n\b\n") if __doc__ else None)
@click.option("--data_path", type=Path, help="Folder of scenes, each with images and a model.")
@click.option("--scene", "names", multiple=True, help="Scene of data_path [all]; can be repeated.")
@click.option(
    "--synthetic", type=int, multiple=True, help="Images of a synthetic city; repeatable."
)
@click.option("--points_per_view", default=650, show_default=True, help="SfM points of a city.")
@click.option("--command", default="mesh", type=click.Choice(("reconstruct", "mesh")))
@click.option("--runs", default=3, show_default=True, help="Runs of which medians are taken.")
@click.option("--flags", default="", help="Flags for all variants, as one string.")
@click.option("--compare", metavar="COMMIT", help="Compare with a build of this commit.")
@click.option("--setting", metavar="FLAGS", help="Compare with the same code with these flags.")
@click.option("--output_path", type=Path, default=Path("benchmark.json"), show_default=True)
@exit_on_error()
def main(
    data_path: Path | None,
    names: tuple[str, ...],
    synthetic: tuple[int, ...],
    points_per_view: int,
    command: str,
    runs: int,
    flags: str,
    compare: str | None,
    setting: str | None,
    output_path: Path,
) -> None:
    if compare and setting:
        raise click.UsageError("give either --compare or --setting")
    with (
        tempfile.TemporaryDirectory() as temporary,
        variants_of(shlex.split(flags), compare, setting) as variants,
    ):
        scenes = [
            *data_scenes(data_path, names),
            *(city_scene(n, points_per_view, Path(temporary)) for n in synthetic),
        ]
        if not scenes:
            raise click.UsageError("no scenes; give --data_path or --synthetic")
        records = measure(scenes, variants, command, runs, Path(temporary))
    result = {"machine": machine(), "command": command, "runs": runs, "scenes": records}
    output_path.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")
    print(table(records))


def data_scenes(data_path: Path | None, names: tuple[str, ...]) -> list[Scene]:
    """The scenes of a folder, those named or all."""
    if data_path is None:
        return []
    data_path = data_path.resolve()
    if not data_path.is_dir():
        raise ColmapEdgesError(f"data_path {data_path} is not a folder")
    chosen = names or sorted(p.name for p in data_path.iterdir() if (p / "images").is_dir())
    return [Scene(name=name, path=data_path / name) for name in chosen]


def city_scene(num_views: int, points_per_view: int, folder: Path) -> Scene:
    """Make a city and its model in a separate process, whose memory is not measured."""
    path = folder / f"city-{num_views}"
    arguments = ["--num_views", str(num_views), "--points_per_view", str(points_per_view)]
    make = [*city_command(arguments, path), "--only_write"]
    execute(make, ROOT)
    return Scene(name=path.name, path=path, num_views=num_views)


def city_command(arguments: list[str], folder: Path) -> list[str]:
    """The command that works on a city in `folder`."""
    script = ROOT / "scripts" / "synthetic_city.py"
    return [sys.executable, str(script), *arguments, "--folder", str(folder)]


@contextmanager
def variants_of(
    flags: list[str], compare: str | None, setting: str | None
) -> Iterator[list[Variant]]:
    """The variants to compare; a commit is built in a temporary worktree."""
    own = Variant(name="this tree", tree=ROOT, flags=tuple(flags))
    if setting is not None:
        other = (*flags, *shlex.split(setting))
        yield [own, Variant(name=setting, tree=ROOT, flags=other)]
    elif compare is not None:
        with built_commit(compare) as tree:
            yield [own, Variant(name=compare, tree=tree, flags=tuple(flags))]
    else:
        yield [own]


@contextmanager
def built_commit(commit: str) -> Iterator[Path]:
    """A worktree of a commit with its extensions compiled."""
    git = ["git", "-C", str(ROOT), "worktree"]
    with tempfile.TemporaryDirectory() as folder:
        tree = Path(folder) / "tree"
        execute([*git, "add", "--detach", str(tree), commit], ROOT)
        try:
            execute([str(tree / "scripts" / "build"), sys.executable], tree)
            yield tree
        finally:
            execute([*git, "remove", "--force", str(tree)], ROOT)


def measure(
    scenes: list[Scene], variants: list[Variant], command: str, runs: int, folder: Path
) -> list[dict[str, Any]]:
    """Run all variants in turn on each scene; the medians by scene, variant and stage."""
    records = []
    for scene in scenes:
        taken: list[list[Stages]] = [[] for _ in variants]
        for run in range(runs):
            for index, variant in enumerate(variants):
                click.echo(f"{scene.name}, {variant.name}: run {run + 1} of {runs}", err=True)
                taken[index].append(run_once(scene, variant, command, folder))
        for variant, stages in zip(variants, taken, strict=True):
            records.append(
                {
                    "scene": scene.name,
                    "variant": variant.name,
                    "stages": medians(stages),
                    "counts": {name: found.get("counts") for name, found in stages[-1].items()},
                }
            )
    return records


def run_once(scene: Scene, variant: Variant, command: str, folder: Path) -> Stages:
    """Records by stage of one run in a separate process."""
    if scene.num_views:
        report = folder / "report.json"
        arguments = ["--num_views", str(scene.num_views), "--report", str(report)]
        whole = execute([*city_command(arguments, scene.path), *variant.flags], variant.tree)
    else:
        output = folder / "output"
        report = output / "report.json"
        arguments = [sys.executable, "-m", "colmap_edges", command, "--overwrite"]
        for name, path in (
            ("image_path", find_images(scene.path)),
            ("input_path", find_model(scene.path)),
            ("output_path", output),
        ):
            arguments += [f"--{name}", str(path)]
        whole = execute([*arguments, *variant.flags], variant.tree)
    records = json.loads(report.read_text(encoding="utf-8"))["stages"]
    # Each stage resets the process's peak, so that its own is that since the last stage began.
    whole["peak_mb"] = max(whole["peak_mb"], *(record["peak_mb"] for record in records))
    return {record["name"]: record for record in records} | {WHOLE: whole}


def execute(command: list[str], tree: Path) -> dict[str, float]:
    """Run a command with the package of another source tree, or this process's own; its measures.

    Raises:
        ColmapEdgesError: with the last line it wrote, when it fails.
    """
    package = Path(colmap_edges.__file__).parents[1] if tree == ROOT else tree
    environment = os.environ | {"PYTHONPATH": str(package), "PYTHONSAFEPATH": "1"}
    begin = time.perf_counter()
    with tempfile.TemporaryFile() as log:
        process = subprocess.Popen(command, cwd=tree, env=environment, stdout=log, stderr=log)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall = time.perf_counter() - begin
        log.seek(0)
        lines = log.read().decode(errors="replace").strip().splitlines()
    if process.returncode:
        last = lines[-1] if lines else f"exit code {process.returncode}"
        raise ColmapEdgesError(f"{shlex.join(command)} failed: {last}")
    return {
        "wall_s": wall,
        "cpu_s": usage.ru_utime + usage.ru_stime,
        "peak_mb": usage.ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3),
    }


def medians(runs: list[Stages]) -> dict[str, dict[str, float]]:
    """Medians over runs of every measure of every stage."""
    return {
        stage: {
            name: round(statistics.median(run[stage][name] for run in runs), 3) for name in MEASURES
        }
        for stage in runs[0]
    }


def machine() -> dict[str, Any]:
    """A description of the machine."""
    return {
        "processor": processor_name(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None,
        "platform": platform.platform(),
        "python": platform.python_version(),
        "load_average": os.getloadavg(),
    }


def processor_name() -> str:
    """The processor's name, if known."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(": ")[1] for line in lines if line.startswith("model name")), "")


def table(records: list[dict[str, Any]]) -> str:
    """The medians as a Markdown table; ratios are those of the first variant to the second."""
    by_scene: dict[str, list[dict[str, Any]]] = {}
    for record in records:
        by_scene.setdefault(record["scene"], []).append(record)
    compared = any(len(variants) > 1 for variants in by_scene.values())
    heads = ["scene", "variant", "stage", "wall s", "CPU s", "peak MB"]
    heads += ["wall ratio", "CPU ratio", "memory ratio"] if compared else []
    rows = []
    for scene, variants in by_scene.items():
        for stage in variants[0]["stages"]:
            for index, record in enumerate(variants):
                found = record["stages"].get(stage)
                if found:
                    row = [scene, record["variant"], stage, *written(found)]
                    other = variants[-1]["stages"].get(stage)
                    rows.append(row + (ratios(found, other if index == 0 else None, compared)))
    return markdown(heads, rows)


def written(measures: dict[str, float]) -> list[str]:
    """The measures of a row of the table."""
    return [f"{measures['wall_s']:.2f}", f"{measures['cpu_s']:.2f}", f"{measures['peak_mb']:.0f}"]


def ratios(measures: dict[str, float], other: dict[str, float] | None, compared: bool) -> list[str]:
    """The ratios of a row; empty without a second variant."""
    if not compared:
        return []
    if other is None:
        return ["", "", ""]
    return [f"{measures[n] / other[n]:.2f}" if other[n] else "" for n in MEASURES]


if __name__ == "__main__":
    main()
