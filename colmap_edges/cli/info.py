"""Short descriptions of models and output folders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.cli.terminal import duration
from colmap_edges.colmap.model import Model, load_model
from colmap_edges.colmap.workspace import find_model, is_model
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.report.outcome import VIEWERS, outcome
from colmap_edges.runtime.input_files import read_json
from colmap_edges.runtime.ownership import OUTPUT


def describe(path: Path, verbose: bool = False) -> list[str]:
    """Describe a COLMAP model, an output folder, or the model of a workspace, in lines.

    Args:
        path: the folder.
        verbose: list all counts of an output folder.

    Raises:
        ColmapEdgesError: if `path` is neither.
    """
    if (path / OUTPUT.record).is_file():
        return describe_output(path, verbose)
    if is_model(path) or not (path / "sparse").is_dir():
        return describe_model(load_model(path))
    found = find_model(path)
    return [f"{found}:", *describe_model(load_model(found))]


def describe_model(model: Model) -> list[str]:
    """Counts of a model, its camera models and its track lengths."""
    cameras = model.reconstruction.cameras
    kinds = sorted({f"{c.model.name} {c.width}x{c.height}" for c in cameras.values()})
    lines = [
        f"cameras: {len(cameras)} ({', '.join(kinds)})",
        f"images: {len(model.views)} with poses, {len(model.unposed_names)} without",
        f"points3D: {len(model.point3D_ids):,}, {len(model.track_views):,} observations",
    ]
    lengths = np.diff(model.track_offsets)
    if len(lengths):
        lines.append(f"track length: median {np.median(lengths):g}, longest {lengths.max()}")
    return lines


def describe_output(path: Path, verbose: bool) -> list[str]:
    """The results in an output folder, or with `verbose` all counts of its stages."""
    report = read_json(path / OUTPUT.record)
    try:
        lines = report_lines(report) if verbose else result_lines(report, path)
    except (KeyError, TypeError, AttributeError) as error:
        raise ColmapEdgesError(
            f"{path / OUTPUT.record} is damaged: the key {error} is missing; run again"
        ) from error
    if verbose and (path / "sparse").is_dir():
        lines += ["sparse:", *(f"  {line}" for line in describe_model(load_model(path / "sparse")))]
    return lines


def result_lines(report: dict[str, Any], path: Path) -> list[str]:
    """The results of a run in a user's words, and its files."""
    lines = [f"{'Made by:':9} colmap-edges {report['command']}"]
    lines += [f"{name + ':':9} {text}" for name, text in outcome(report).items()]
    seconds = sum(stage["wall_s"] for stage in report["stages"])
    lines.append(f"{'Time:':9} {duration(seconds)}")
    if frame := report.get("alignment"):
        unit = frame["unit"] or "unknown"
        lines.append(f"{'Aligned:':9} scaled by {frame['scale']:.6g}, unit {unit}")
    for finding in report.get("findings", []):
        lines.append(f"{'Note:':9} {finding['text']}. To change that: {finding['remedy']}.")
    files = [name for name in VIEWERS if (path / name).exists()]
    return [*lines, f"{'Files:':9} {', '.join(files)}"]


def report_lines(report: dict[str, Any]) -> list[str]:
    """The command of a run and the counts of its stages."""
    lines = [f"output of colmap-edges {report['command']}"]
    for stage in report["stages"]:
        lines.append(f"{stage['name']}: {stage['wall_s']} s, {stage['peak_mb']} MB")
        lines += count_lines(stage["counts"], "  ")
    return lines


def count_lines(counts: dict[str, Any], indent: str) -> list[str]:
    """Counts, one per line, nested ones indented."""
    lines = []
    for key, value in counts.items():
        nested = isinstance(value, dict)
        lines.append(f"{indent}{key.replace('_', ' ')}:{'' if nested else f' {value}'}")
        lines += count_lines(value, indent + "  ") if nested else []
    return lines
