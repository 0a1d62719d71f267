"""Tables of results on random scenes by family, in Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from colmap_edges.evaluation.tables import markdown
from trials.rules import COMPARED, Record, Value, differences, families, of_edges, of_mesh, pairs

MESH_NAMES = {
    "sfm": "SfM only",
    "edges": "edges",
    "faces": "edges and faces",
    "patches": "edges, faces, patches",
}
# Figures by header, and the percentile that shows the worst scenes.
MESH_FIGURES = {
    "right at 1 %": ("right_1_percent", 5),
    "MAE / depth": ("mae", 95),
    "coverage": ("coverage", 5),
    "normals: median °": ("normals_median_deg", 95),
    "within 10°": ("normals_10_deg", 5),
    "within 30°": ("normals_30_deg", 5),
    "sky covered": ("sky_covered", 95),
}
EDGE_FIGURES = {
    "precision": ("precision", 5),
    "recall": ("recall", 5),
    "F": ("f_score", 5),
    "times each is found": ("times", 95),
}
NOTE = """\
Each cell is the median over the scenes of a family and, in brackets, the worst one in twenty.
Figures are defined in docs/evaluation.md. MAE is in shares of the pixel's depth. Sky covered is the
share of the pixels that show no surface at which there is a mesh. Edges are right within 0.005 of
the size of all true curves; recall counts the curves that at least three views see."""
BASELINE_NOTE = "Differences to {baseline}: median, mean, and the worst scene with its seed."


def report(records: Sequence[Record], baseline: Sequence[Record] = (), name: str = "") -> str:
    """All tables, and the failures."""
    parts = [NOTE, mesh_table(records), edge_table(records)]
    if baseline:
        parts += [BASELINE_NOTE.format(baseline=name), baseline_table(records, baseline)]
    for title, some in (("Failed", records), (f"Failed at {name}", baseline)):
        failed = [record for record in some if "failure" in record]
        if failed:
            parts += [f"## {title}", *(failure_text(record) for record in failed)]
    return "\n\n".join(parts)


def failure_text(record: Record) -> str:
    """A failure and the end of its error output."""
    line = f"- {record['family']} {record['seed']}: {record['failure']}"
    return f"{line}\n\n```\n{record['trace']}\n```" if record.get("trace") else line


def mesh_table(records: Sequence[Record]) -> str:
    """A row for each mesh of each family."""
    rows = []
    for family in families(records):
        ours = [record for record in records if record["family"] == family]
        for mesh, title in MESH_NAMES.items():
            figures = [
                spread_text(values(ours, of_mesh(mesh, key)), percentile)
                for key, percentile in MESH_FIGURES.values()
            ]
            rows.append([family, title, *figures])
    return markdown(("family", "mesh", *MESH_FIGURES), rows)


def edge_table(records: Sequence[Record]) -> str:
    """A row for each family: scenes, failures, edges, time."""
    rows = []
    for family in families(records):
        ours = [record for record in records if record["family"] == family]
        figures = [
            spread_text(values(ours, of_edges(key)), percentile)
            for key, percentile in EDGE_FIGURES.values()
        ]
        scores = values(ours, of_edges("f_score"))
        mean = float(np.mean(scores)) if len(scores) else None
        failed = sum("failure" in record for record in ours)
        seconds = spread_text(values(ours, lambda record: record.get("seconds")), 95)
        rows.append([family, len(ours), failed, *figures, mean, seconds])
    return markdown(("family", "scenes", "failed", *EDGE_FIGURES, "mean F", "CPU s"), rows)


def baseline_table(records: Sequence[Record], baseline: Sequence[Record]) -> str:
    """A row for each family: differences of the compared figures, and of the time."""
    rows = []
    for family in families(records):
        paired = pairs([r for r in records if r["family"] == family], baseline)
        cells = [difference_text(differences(paired, value)) for value in COMPARED.values()]
        seconds = differences(paired, lambda record: record.get("seconds"))
        change = float(np.median(list(seconds.values()))) if seconds else None
        rows.append([family, *cells, change])
    return markdown(("family", *COMPARED, "CPU s: median"), rows)


def difference_text(by_seed: dict[int, float]) -> str:
    """Median, mean and worst of differences by seed."""
    if not by_seed:
        return ""
    changes, worst = list(by_seed.values()), min(by_seed, key=by_seed.__getitem__)
    return f"{np.median(changes):+.4f}, {np.mean(changes):+.4f}, {by_seed[worst]:+.3f} ({worst})"


def values(records: Sequence[Record], value: Value) -> Any:
    """The finite values of records (N,)."""
    found = [value(record) for record in records]
    return np.array([each for each in found if each is not None and np.isfinite(each)])


def spread_text(found: Any, percentile: float) -> str:
    """Median and a percentile in brackets; empty without values."""
    if not len(found):
        return ""
    return f"{np.median(found):.3g} ({np.percentile(found, percentile):.3g})"
