"""What a run says at its end: what came out, where it is and what opens it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

# What to open the files of an output folder with.
VIEWERS = {
    "sparse": "COLMAP model: colmap gui, or any program that reads COLMAP models",
    "edges.ply": "3D edges: MeshLab, Blender",
    "edges.obj": "3D edges as polylines: Blender, CloudCompare",
    "edges.glb": "3D edges: glTF viewers, Blender, game engines",
    "edges.dxf": "3D edges as lines, arcs, circles, ellipses, splines: CAD programs",
    "edges.json": "what each edge is: points in the model, length, views, residual, curves",
    "mesh.ply": "mesh: MeshLab, Blender, CloudCompare",
    "mesh.obj": "mesh: MeshLab, Blender, CloudCompare",
    "mesh.glb": "mesh: Blender, any glTF viewer",
    "edge_graphs": "2D edge graphs: numpy.load",
    "overlays": "pictures of the 2D edge graphs",
    "report.html": "all of it to look at: a web browser, no network needed",
    "report.json": "options, versions, counts, times and memory of every stage",
}


def summary(report: dict[str, Any], output: Path, seconds: float) -> list[str]:
    """Say what came out, where the files are and what opens them."""
    lines = []
    for stage in report["stages"]:
        counts = (f"{value:,} {key.replace('_', ' ')}" for key, value in scalars(stage["counts"]))
        lines.append(f"{stage['name']:>8}  {stage['wall_s']:6.1f} s  {', '.join(counts)}")
    for finding in report["findings"]:
        lines.append(f"Note: {finding['text']}. To change that: {finding['remedy']}.")
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
