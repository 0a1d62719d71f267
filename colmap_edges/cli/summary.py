"""The summary printed at the end of a run: results, findings and the file to open."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from colmap_edges.cli.terminal import duration
from colmap_edges.report.outcome import VIEWERS, outcome


def summary(report: dict[str, Any], output: Path, seconds: float, verbose: bool) -> list[str]:
    """The lines of the summary: findings, results and, last, the file to open.

    Args:
        report: the contents of report.json.
        output: the output folder.
        seconds: duration of the run.
        verbose: also list the counts of each stage and every file.
    """
    lines = details(report, output) if verbose else []
    for finding in report["findings"]:
        lines.append(f"Note: {finding['text']}. To change that: {finding['remedy']}.")
    for name, text in outcome(report).items():
        lines.append(f"{name + ':':9} {text}")
    names = ("report.html", "mesh.ply", "mesh.obj", "mesh.glb", "edges.ply", "overlays")
    name = next((name for name in names if (output / name).exists()), "")
    how = f"in {VIEWERS[name].rpartition(': ')[2]}" if name else "the results"
    lines.append(f"{'Time:':9} {duration(seconds)}")
    return [*lines, f"{'Look at:':9} {output / name} ({how})"]


def details(report: dict[str, Any], output: Path) -> list[str]:
    """The duration and counts of each stage, and a description of each file."""
    lines = []
    for stage in report["stages"]:
        counts = (f"{value:,} {key.replace('_', ' ')}" for key, value in scalars(stage["counts"]))
        lines.append(f"{stage['name']:>8}  {stage['wall_s']:6.1f} s  {', '.join(counts)}")
    lines.append(f"In {output}:")
    for name, what in VIEWERS.items():
        if (output / name).exists():
            lines.append(f"  {name:12} {what}")
    return lines


def scalars(counts: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """The counts that are single numbers."""
    for key, value in counts.items():
        if isinstance(value, int | float):
            yield key, value
