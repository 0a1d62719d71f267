"""Markdown tables of evaluation records."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

# Headers of columns by keys of the records.
ERRORS = {"mae": "MAE", "rmse": "RMSE", "sigma": "σ", "median": "median", "p90": "P90"}
SHARES = {
    "coverage": "coverage",
    "right_0_5_percent": "right at 0.5 %",
    "right_1_percent": "right at 1 %",
    "right_2_percent": "right at 2 %",
}
NORMALS = {
    "normals_median_deg": "normals: median °",
    "normals_10_deg": "normals within 10°",
    "normals_30_deg": "within 30°",
}
SCORES = {"threshold": "threshold", "precision": "precision", "recall": "recall", "f_score": "F"}
CORNERS = {
    **SCORES,
    "threshold": "corners: threshold",
    "result_corners": "found",
    "reference_corners": "true",
}
DISTANCES = {
    "accuracy": "accuracy (mean)",
    "completeness": "completeness (mean)",
    "spacing": "sample spacing",
    "unit": "unit",
}
KINDS = {
    "num_true": "true curves found",
    "num_found": "curves",
    "times_found": "times each is found",
    "right_kind": "length of the right kind",
    "right_radius": "radii within 1 %",
    "median_radius_error": "median error of the radius",
}
TIMES_FOUND = {
    "threshold": "threshold",
    "result_length": "edges on true curves",
    "found_length": "true curves found",
    "times": "times each is found",
}
DEPTHS = {
    "name": "relative depth error",
    "count": "pairs",
    "median": "median",
    "p90": "P90",
    "within_0_2_percent": "within 0.2 %",
    "within_1_percent": "within 1 %",
}
REPROJECTION = {
    "points": "edge points",
    "observations_mean": "observations each",
    "median": "reprojection median px",
    "p95": "P95 px",
    "within_1_px": "within 1 px",
}
LENGTHS = {
    "count": "segments",
    "total": "total length",
    "median": "median",
    "p95": "P95",
    "longest": "longest",
    "gross": "gross",
    "gross_total": "gross length",
}
HELD_OUT_VIEWS = {
    "view": "left-out image",
    "points": "edge points",
    "median_px": "median px",
    "within_1_px": "within 1 px",
    "within_2_px": "2 px",
    "chance_2_px": "2 px by chance",
}
DTU = {
    "accuracy": "accuracy",
    "completeness": "completeness",
    "overall": "overall",
    "accuracy_median": "accuracy median",
    "completeness_median": "completeness median",
}


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
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    if isinstance(value, int):
        return f"{value:,}"
    if math.isnan(value):
        return "-"
    return f"{value:.4g}"


def table(columns: Mapping[str, str], records: Iterable[Mapping[str, Any]]) -> str:
    """A table of records, with a column for each key."""
    return markdown(
        [*columns.values()], [[record.get(key) for key in columns] for record in records]
    )


def error_table(title: str, errors: Mapping[str, Mapping[str, Any]]) -> str:
    """A table of statistics of errors and shares of pixels by name, normals where known."""
    has_normals = any(name in row for row in errors.values() for name in NORMALS)
    columns = {"name": title} | ERRORS | SHARES | (NORMALS if has_normals else {})
    return table(columns, [{"name": name} | dict(row) for name, row in errors.items()])


def mesh_tables(record: dict[str, Any]) -> str:
    """Tables of the result of `scene.evaluate_mesh`."""
    parts = [f"{record['faces']:,} faces; errors in world units"]
    if "depth" in record:
        parts_of = record["depth"]
        views = {"all views": parts_of["pooled"]}
        if len(parts_of["views"]) > 1:
            views["mean of views"] = parts_of["mean_of_views"]
        parts.append(error_table("depth error", views | parts_of["views"]))
    if "points_depth" in record:
        parts.append(error_table("depth error at SfM observations", record["points_depth"]))
    if "accuracy" in record:
        rows = [{"name": name} | record[name] for name in ("accuracy", "completeness")]
        parts.append(table({"name": "distance"} | ERRORS, rows))
        parts.append(table(SCORES, record["scores"]))
    return "\n\n".join(parts)


def edge_tables(record: dict[str, Any]) -> str:
    """Tables of the result of `scene.evaluate_edges`."""
    parts = []
    if curves := record.get("curves"):
        parts += [table(SCORES, curves["scores"]), table(DISTANCES, [curves])]
        if "recall_by_views" in curves:
            parts.append(_visible_curve_table(curves))
    if "kinds" in record:
        parts.append(table(KINDS, [record["kinds"]]))
    if "times_found" in record:
        parts.append(table(TIMES_FOUND, record["times_found"]))
    if corners := record.get("corners"):
        parts.append(table(CORNERS, [corners | row for row in corners["scores"]]))
    if "twins" in record:
        header = [f"parallel twin within {row['limit_px']:g} px" for row in record["twins"]]
        parts.append(markdown(header, [[row["share"] for row in record["twins"]]]))
    if depths := record.get("depth"):
        rows = [{"name": name} | of | of["relative"] for name, of in depths.items()]
        parts.append(table(DEPTHS, rows))
    if errors := record.get("reprojection"):
        parts.append(table(REPROJECTION, [errors | errors["distance_px"]]))
    return "\n\n".join([*parts, table(LENGTHS, [record["lengths"]])])


def _visible_curve_table(errors: dict[str, Any]) -> str:
    limits = [f"within {score['threshold']:g} px" for score in errors["scores"]]
    rows: list[list[Any]] = []
    for part in errors["recall_by_views"]:
        low, high = part["min_views"], part["max_views"]
        views = str(low) if low == high else f"{low} to {high}"
        rows.append([f"found, of true curves {views} views see", part["length"], *part["recall"]])
    if errors["on_surface"]:
        length = errors["result_samples"] * errors["spacing"]
        rows.append(["3D edges on the true surface", length, *errors["on_surface"]])
    if errors.get("sfm_points_on_surface"):
        rows.append(["SfM points on the true surface", "", *errors["sfm_points_on_surface"]])
    return markdown(("share", "length", *limits), rows)


def paper_tables(results: dict[str, Any], baseline: str) -> str:
    """Tables of the result of `benchmark.run`, with the paper's layout.

    Args:
        results: By scene, by method.
        baseline: Method or peer to which the average variation refers.
    """
    parts = ["# Errors of points and meshes", _TABLE_NOTE.format(baseline=baseline)]
    parts += [_main_table(results, baseline)]
    if any("all_points" in record for _, _, record in _records(results)):
        parts += ["## Points counted as the paper's authors do", _ALL_POINTS_NOTE]
        parts += [_all_points_table(results, baseline)]
    if any("dtu" in record for _, _, record in _records(results)):
        parts += ["## DTU's own distances (mm)", _dtu_table(results)]
    notes = [
        f"- {scene}: {note}"
        for scene, _, record in _records(results)
        for note in record.get("notes", ())
    ]
    if notes:
        parts += ["## Left empty", "\n".join(dict.fromkeys(notes))]
    failures = [
        f"- {scene}, {method}: {record['error']}"
        for scene, method, record in _records(results)
        if "error" in record
    ]
    if failures:
        parts += ["## Failed", "\n".join(failures)]
    return "\n\n".join(parts)


_POINT_ERRORS = [*ERRORS][:4]
_POINT_HEADER = ("scene", "method", "points", "points MAE", *[*ERRORS.values()][1:4])
_TABLE_NOTE = """\
Points: distance to the reference cloud, or (reference depth only) depth error in the views
that observe them, smallest in 5x5 pixels. Rows with edges or lines count the points on these
alone, rows without them the SfM points. Mesh: depth error from the reference's cameras.
σ is the standard deviation of the absolute errors. Lengths in each scene's unit.
Right at 1 %: share of all reference pixels at which the mesh lies within 1 % of the pixel's
depth; holes are wrong. Normals within 10° likewise, of the pixels at which the reference has
a normal; their median is that of the pixels with mesh.
Average variation: mean change of an error against {baseline}, over all scenes that have both."""
_ALL_POINTS_NOTE = "The SfM points are among the points of every row."


def _records(results: dict[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    return [
        (scene, method, record)
        for scene, entry in results.items()
        for method, record in entry["methods"].items()
    ]


def _main_table(results: dict[str, Any], baseline: str) -> str:
    shares = SHARES | NORMALS
    header = (*_POINT_HEADER, "mesh MAE", *[*ERRORS.values()][1:], *shares.values(), "faces")
    rows = [
        _point_cells(results, scene, method, record["points"])
        + [record.get("mesh", {}).get(name, math.nan) for name in (*ERRORS, *shares)]
        + [record["faces"]]
        for scene, method, record in _records(results)
        if "error" not in record
    ]
    kinds = [("points", name) for name in _POINT_ERRORS] + [("mesh", name) for name in ERRORS]
    empty = [""] * (len(shares) + 1)
    variations = [[*row, *empty] for row in _variation_rows(results, baseline, kinds)]
    return markdown(header, rows + variations)


def _all_points_table(results: dict[str, Any], baseline: str) -> str:
    rows = [
        _point_cells(results, scene, method, record["all_points"])
        for scene, method, record in _records(results)
        if "all_points" in record
    ]
    kinds = [("all_points", name) for name in _POINT_ERRORS]
    return markdown(_POINT_HEADER, rows + _variation_rows(results, baseline, kinds))


def _point_cells(
    results: dict[str, Any], scene: str, method: str, points: Mapping[str, Any]
) -> list[Any]:
    errors = [points.get(name, math.nan) for name in _POINT_ERRORS]
    return [f"{scene} ({results[scene]['unit']})", method, points["count"], *errors]


def _variation_rows(
    results: dict[str, Any], baseline: str, kinds: Sequence[tuple[str, str]]
) -> list[list[Any]]:
    """Mean over scenes of each method's errors against the baseline's, in percent."""
    methods = list(dict.fromkeys(method for _, method, _ in _records(results)))
    rows = []
    for method in methods:
        cells = [_variation(results, baseline, method, *kind) for kind in kinds]
        if method != baseline and any(cells):
            rows.append(["**average variation**", method, "", *cells])
    return rows


def _variation(results: dict[str, Any], base: str, method: str, part: str, name: str) -> str:
    changes = []
    for entry in results.values():
        before = entry["methods"].get(base, {}).get(part, {}).get(name)
        after = entry["methods"].get(method, {}).get(part, {}).get(name)
        if before and after is not None and math.isfinite(before) and math.isfinite(after):
            changes.append(after / before - 1)
    return f"{100 * sum(changes) / len(changes):+.1f} %" if changes else ""


def _dtu_table(results: dict[str, Any]) -> str:
    rows = [
        {"scan": scene, "method": method} | record["dtu"]
        for scene, method, record in _records(results)
        if "dtu" in record
    ]
    return table({"scan": "scan", "method": "method"} | DTU, rows)


def run_tables(record: dict[str, Any]) -> str:
    """Tables of the result of `evaluation.run`."""
    parts = []
    if "mesh" in record:
        parts.append(mesh_tables(record["mesh"]))
    if "held_out_points" in record:
        errors = {
            f"{name}, {kind}": errors
            for name, kinds in record["held_out_points"].items()
            for kind, errors in kinds.items()
        }
        parts.append(error_table("depth error at left-out points", errors))
    if "edges" in record:
        parts.append(edge_tables(record["edges"]))
    if "held_out_views" in record:
        parts.append(table(HELD_OUT_VIEWS, record["held_out_views"]))
    return "\n\n".join(parts)
