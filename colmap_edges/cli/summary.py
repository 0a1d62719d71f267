"""What a run says at its end: what came out, and the one file to open."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from colmap_edges.report.outcome import VIEWERS, outcome

# The first of these that a run made is where to look.
LOOK_AT = {
    "report.html": "in any web browser",
    "mesh.ply": "in MeshLab, Blender or CloudCompare",
    "mesh.obj": "in MeshLab, Blender or CloudCompare",
    "mesh.glb": "in Blender or any glTF viewer",
    "edges.ply": "in MeshLab or Blender",
    "overlays": "with any viewer of pictures",
}


def summary(report: dict[str, Any], output: Path, seconds: float, verbose: bool) -> list[str]:
    """Say what came out in a user's words; last, which file to open.

    Args:
        report: what report.json holds.
        output: the folder that was made.
        seconds: how long the run took.
        verbose: also say what each stage did, and name every file.
    """
    lines = details(report, output, seconds) if verbose else []
    for finding in report["findings"]:
        lines.append(f"Note: {finding['text']}. To change that: {finding['remedy']}.")
    for name, text in outcome(report).items():
        lines.append(f"{name + ':':9} {text}")
    found = ((name, how) for name, how in LOOK_AT.items() if (output / name).exists())
    name, how = next(found, ("", "what came out"))
    return [*lines, f"{'Look at:':9} {output / name} ({how})"]


def details(report: dict[str, Any], output: Path, seconds: float) -> list[str]:
    """What each stage did and in which time, and what each file is."""
    lines = []
    for stage in report["stages"]:
        counts = (f"{value:,} {key.replace('_', ' ')}" for key, value in scalars(stage["counts"]))
        lines.append(f"{stage['name']:>8}  {stage['wall_s']:6.1f} s  {', '.join(counts)}")
    lines.append(f"Done in {seconds:.1f} s. In {output}:")
    for name, what in VIEWERS.items():
        if (output / name).exists():
            lines.append(f"  {name:12} {what}")
    return lines


def scalars(counts: dict[str, Any]) -> Iterator[tuple[str, float]]:
    """The counts that are single numbers."""
    for key, value in counts.items():
        if isinstance(value, int | float):
            yield key, value
