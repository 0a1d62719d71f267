"""Records as Markdown tables."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

ERROR_COLUMNS = ("mae", "rmse", "sigma", "median", "p90")


def markdown(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A Markdown table; numbers with four significant digits."""
    lines = [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(cell(value) for value in row) + " |" for row in rows),
    ]
    return "\n".join(lines)


def cell(value: Any) -> str:
    """Text of one value."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if isinstance(value, int):
        return f"{value:,}"
    if math.isnan(value):
        return "-"
    return f"{value:.4g}"


def mesh_tables(record: dict[str, Any]) -> str:
    """Tables of what `scene.evaluate_mesh` returns."""
    parts = [f"{record['faces']:,} faces; errors in world units"]
    names = ("MAE", "RMSE", "σ", "median", "P90", "coverage")
    if "depth" in record:
        views = {"all views": record["depth"]["pooled"], **record["depth"]["views"]}
        rows = [_error_row(name, statistics) for name, statistics in views.items()]
        parts.append(markdown(("depth error", *names), rows))
    if "points_depth" in record:
        rows = [_error_row(name, s) for name, s in record["points_depth"].items()]
        parts.append(markdown(("depth error at SfM observations", *names), rows))
    if "accuracy" in record:
        rows = [_error_row(name, record[name]) for name in ("accuracy", "completeness")]
        parts.append(markdown(("distance", *names), rows))
        parts.append(score_table(record["scores"]))
    return "\n\n".join(parts)


def _error_row(name: str, statistics: dict[str, Any]) -> list[Any]:
    values = [statistics[column] for column in ERROR_COLUMNS]
    return [name, *values, statistics.get("coverage", float("nan"))]


def score_table(scores: list[dict[str, float]]) -> str:
    """Precision, recall and F at thresholds."""
    names = ("threshold", "precision", "recall", "f_score")
    rows = [[row[name] for name in names] for row in scores]
    return markdown(("threshold", "precision", "recall", "F"), rows)


def edge_tables(record: dict[str, Any]) -> str:
    """Tables of what `scene.evaluate_edges` returns."""
    parts = []
    if "curves" in record:
        parts += [score_table(record["curves"]["scores"]), _distance_table(record["curves"])]
    if "depth" in record:
        parts.append(_depth_table(record["depth"]))
    return "\n\n".join(
        [*parts, _reprojection_table(record["reprojection"]), _length_table(record["lengths"])]
    )


def _distance_table(errors: dict[str, Any]) -> str:
    names = ("accuracy", "completeness", "spacing", "unit")
    header = ("accuracy (mean)", "completeness (mean)", "sample spacing", "unit")
    return markdown(header, [[errors[name] for name in names]])


def _depth_table(errors: dict[str, Any]) -> str:
    header = ("relative depth error", "pairs", "median", "P90", "within 0.2 %", "within 1 %")
    rows = []
    for name, kind in errors.items():
        relative = [kind["relative"][column] for column in ("count", "median", "p90")]
        rows.append([name, *relative, kind["within_0_2_percent"], kind["within_1_percent"]])
    return markdown(header, rows)


def _reprojection_table(errors: dict[str, Any]) -> str:
    header = ("edge points", "observations each", "reprojection median px", "P95 px", "within 1 px")
    pixels = errors["distance_px"]
    row = (errors["points"], errors["observations_mean"], pixels["median"], pixels["p95"])
    return markdown(header, [[*row, errors["within_1_px"]]])


def _length_table(lengths: dict[str, Any]) -> str:
    names = ("count", "total", "median", "p95", "longest", "gross", "gross_total")
    header = ("segments", "total length", "median", "P95", "longest", "gross", "gross length")
    return markdown(header, [[lengths[name] for name in names]])
