#!/usr/bin/env python3
"""Run the program on random scenes with truth, and print how good its meshes and edges are.

Each scene is meshed four times: SfM points only, with edges, with edges and the faces between them,
and with patches, too. Everything is kept in --output_path, so that a run can be interrupted, and is
done again only where the maker of the scenes, the program or the measures changed. Failed scenes
are repeated. The folder receives summary.md with the tables, and pictures of the worst scenes.
"""

from __future__ import annotations

import re
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import click
import cv2
import numpy as np
from trials import pictures, rules, running, summary
from trials.rules import Record
from trials.running import Store, TrialError, Version
from zoo import FAMILIES

NUM_PICTURES = 10


class Seeds(click.ParamType):
    """A range of seeds as in 0..99, or one seed."""

    name = "A..B"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> range:
        """Read both ends."""
        found = re.fullmatch(r"(\d+)(?:\.\.(\d+))?", str(value))
        if not found or int(found[2] or found[1]) < int(found[1]):
            self.fail(f"{value} is no range of seeds; give one such as 0..99", param, ctx)
        return range(int(found[1]), int(found[2] or found[1]) + 1)


@click.command(help=__doc__)
@click.option("--seeds", type=Seeds(), required=True, help="Seeds of each family, such as 0..99.")
@click.option(
    "--families",
    multiple=True,
    type=click.Choice(FAMILIES),
    default=FAMILIES,
    help="Families of scenes; may be given several times. Default: all.",
)
@click.option("--baseline", default="", help="Commit that the results are compared with.")
@click.option("--check", is_flag=True, help="Exit with 1 and say why if a rule is broken.")
@click.option("--jobs", type=click.IntRange(1), default=1, help="Scenes at a time.")
@click.option(
    "--output_path",
    type=Path,
    default=Path("trials_output"),
    show_default=True,
    help="Folder of scenes, runs, results and pictures.",
)
def main(
    seeds: range,
    families: tuple[str, ...],
    baseline: str,
    check: bool,
    jobs: int,
    output_path: Path,
) -> None:
    store = Store(path=output_path.resolve())
    scenes = [(family, seed) for seed in seeds for family in families]
    try:
        base = running.version_at(baseline, store) if baseline else None
        versions = [running.present_version(), *([base] if base else [])]
        for version in versions:  # an installed one is tried if this tree is not in PYTHONPATH
            click.echo(f"{version.name} is in {version.root}", err=True)
        records, *others = (try_all(store, version, scenes, jobs) for version in versions)
    except TrialError as error:
        raise click.ClickException(str(error)) from error
    text = summary.report(records, others[0] if others else (), baseline)
    running.write_whole(store.path / "summary.md", text + "\n")
    click.echo(text)
    draw_worst(store, versions, records, others[0] if others else [])
    broken = rules.broken_rules(records, others[0] if others else ())
    if check and broken:
        click.echo("Broken: " + "; ".join(broken))
        raise SystemExit(1)


def try_all(
    store: Store, version: Version, scenes: list[tuple[str, int]], jobs: int
) -> list[Record]:
    """The results of a version on all scenes, in order."""

    def one(scene: tuple[str, int]) -> Record:
        record = running.try_scene(store, version, *scene)
        click.echo(f"{version.name} {rules.name_of(record)}: {outcome(record)}", err=True)
        return record

    with ThreadPoolExecutor(jobs) as workers:
        futures = [workers.submit(one, scene) for scene in scenes]
        try:
            return [future.result() for future in futures]
        finally:
            workers.shutdown(cancel_futures=True)


def outcome(record: Record) -> str:
    """A result in one line."""
    if "failure" in record:
        return f"failed: {record['failure']}"
    right = [record["meshes"][mesh][rules.RIGHT] for mesh in summary.MESH_NAMES]
    return "right at 1 %: " + ", ".join(f"{share:.3f}" for share in right)


def draw_worst(
    store: Store, versions: list[Version], records: list[Record], baseline: list[Record]
) -> None:
    """Write pictures of the worst scenes: by their loss against the baseline, or by right pixels.

    With a baseline its pictures are below those of the present version.
    """
    value = rules.of_mesh("patches", rules.RIGHT)
    before = {rules.name_of(record): value(record) or 0.0 for record in baseline}
    measured = [(record, now) for record in records if (now := value(record)) is not None]
    order = sorted(measured, key=lambda pair: pair[1] - before.get(rules.name_of(pair[0]), 0.0))
    for rank, (record, now) in enumerate(order[:NUM_PICTURES], start=1):
        scene = store.scene(record["family"], record["seed"])
        runs = [run for version in versions if (run := store.run(version, scene)).is_file()]
        if not runs:  # removed to save space
            continue
        drawn = np.vstack([pictures.draw(scene, run) for run in runs])
        path = store.path / f"worst_{rank:02d}_{record['family']}_{record['seed']}.png"
        cv2.imwrite(str(path), drawn)
        click.echo(f"{path}: right at 1 %: {now:.3f}")


if __name__ == "__main__":
    main()
