"""Markdown tables of evaluation records."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Any

ERROR_COLUMNS = ("mae", "rmse", "sigma", "median", "p90")
SHARE_COLUMNS = ("coverage", "right_0_5_percent", "right_1_percent", "right_2_percent")
_ERROR_NAMES = ("MAE", "RMSE", "σ", "median", "P90")
_SHARE_NAMES = ("coverage", "right at 0.5 %", "right at 1 %", "right at 2 %")


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


def mesh_tables(record: dict[str, Any]) -> str:
    """Tables of the result of `scene.evaluate_mesh`."""
    parts = [f"{record['faces']:,} faces; errors in world units"]
    names = (*_ERROR_NAMES, *_SHARE_NAMES)
    if "depth" in record:
        parts_of = record["depth"]
        views = {"all views": parts_of["pooled"]}
        if len(parts_of["views"]) > 1:
            views["mean of views"] = parts_of["mean_of_views"]
        views |= parts_of["views"]
        rows = [_error_row(name, statistics) for name, statistics in views.items()]
        parts.append(markdown(("depth error", *names), rows))
    if "points_depth" in record:
        rows = [_error_row(name, s) for name, s in record["points_depth"].items()]
        parts.append(markdown(("depth error at SfM observations", *names), rows))
    if "accuracy" in record:
        rows = [
            [name, *(record[name][column] for column in ERROR_COLUMNS)]
            for name in ("accuracy", "completeness")
        ]
        parts.append(markdown(("distance", *_ERROR_NAMES), rows))
        parts.append(score_table(record["scores"]))
    return "\n\n".join(parts)


def _error_row(name: str, statistics: dict[str, Any]) -> list[Any]:
    return [name, *map(statistics.get, (*ERROR_COLUMNS, *SHARE_COLUMNS))]


def score_table(scores: list[dict[str, float]]) -> str:
    """Precision, recall and F at thresholds."""
    names = ("threshold", "precision", "recall", "f_score")
    rows = [[row[name] for name in names] for row in scores]
    return markdown(("threshold", "precision", "recall", "F"), rows)


def edge_tables(record: dict[str, Any]) -> str:
    """Tables of the result of `scene.evaluate_edges`."""
    parts = []
    if "curves" in record:
        parts += [score_table(record["curves"]["scores"]), _distance_table(record["curves"])]
        if "recall_by_views" in record["curves"]:
            parts.append(_visible_curve_table(record["curves"]))
    if "kinds" in record:
        parts.append(_kind_table(record["kinds"]))
    if "times_found" in record:
        parts.append(_times_found_table(record["times_found"]))
    if "corners" in record:
        parts.append(_corner_table(record["corners"]))
    if "twins" in record:
        header = [f"parallel twin within {row['limit_px']:g} px" for row in record["twins"]]
        parts.append(markdown(header, [[row["share"] for row in record["twins"]]]))
    if "depth" in record:
        parts.append(_depth_table(record["depth"]))
    if "reprojection" in record:
        parts.append(_reprojection_table(record["reprojection"]))
    return "\n\n".join([*parts, _length_table(record["lengths"])])


def _kind_table(errors: dict[str, Any]) -> str:
    header = (
        "true curves found",
        "curves",
        "times each is found",
        "length of the right kind",
        "radii within 1 %",
        "median error of the radius",
    )
    names = ("num_true", "num_found", "times_found", "right_kind", "right_radius")
    return markdown(header, [[*(errors[name] for name in names), errors["median_radius_error"]]])


def _distance_table(errors: dict[str, Any]) -> str:
    names = ("accuracy", "completeness", "spacing", "unit")
    header = ("accuracy (mean)", "completeness (mean)", "sample spacing", "unit")
    return markdown(header, [[errors[name] for name in names]])


def _times_found_table(rows: list[dict[str, float]]) -> str:
    names = ("threshold", "result_length", "found_length", "times")
    header = ("threshold", "edges on true curves", "true curves found", "times each is found")
    return markdown(header, [[row[name] for name in names] for row in rows])


def _corner_table(corners: dict[str, Any]) -> str:
    names = ("threshold", "precision", "recall", "f_score")
    header = ("corners: threshold", "precision", "recall", "F", "found", "true")
    counts = (corners["result_corners"], corners["reference_corners"])
    return markdown(header, [[*(row[n] for n in names), *counts] for row in corners["scores"]])


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


_POINT_COLUMNS = ("mae", "rmse", "sigma", "median")
_TABLE_NOTE = """\
Points: distance to the reference cloud, or (reference depth only) depth error in the views
that observe them, smallest in 5x5 pixels. Rows with edges or lines count the points on these
alone, rows without them the SfM points. Mesh: depth error from the reference's cameras.
σ is the standard deviation of the absolute errors. Lengths in each scene's unit.
Right at 1 %: share of all reference pixels at which the mesh lies within 1 % of the pixel's
depth; holes are wrong.
Average variation: mean change of an error against {baseline}, over all scenes that have both."""
_ALL_POINTS_NOTE = "The SfM points are among the points of every row."


def _records(results: dict[str, Any]) -> list[tuple[str, str, dict[str, Any]]]:
    return [
        (scene, method, record)
        for scene, entry in results.items()
        for method, record in entry["methods"].items()
    ]


def _main_table(results: dict[str, Any], baseline: str) -> str:
    header = (
        "scene", "method", "points", "points MAE", "RMSE", "σ", "median", "mesh MAE", "RMSE", "σ",
        "median", "P90", *_SHARE_NAMES, "faces",
    )  # fmt: skip
    nan = float("nan")
    rows = []
    for scene, method, record in _records(results):
        if "error" in record:
            continue
        points, mesh = record["points"], record.get("mesh", {})
        unit = results[scene]["unit"]
        rows.append(
            [f"{scene} ({unit})", method, points["count"]]
            + [points.get(name, nan) for name in _POINT_COLUMNS]
            + [mesh.get(name, nan) for name in (*ERROR_COLUMNS, *SHARE_COLUMNS)]
            + [record["faces"]]
        )
    kinds = [("points", name) for name in _POINT_COLUMNS]
    kinds += [("mesh", name) for name in ERROR_COLUMNS]
    variations = [[*row, *[""] * 5] for row in _variation_rows(results, baseline, kinds)]
    return markdown(header, rows + variations)


def _all_points_table(results: dict[str, Any], baseline: str) -> str:
    header = ("scene", "method", "points", "points MAE", "RMSE", "σ", "median")
    rows = [
        [f"{scene} ({results[scene]['unit']})", method, record["all_points"]["count"]]
        + [record["all_points"].get(name) for name in _POINT_COLUMNS]
        for scene, method, record in _records(results)
        if "all_points" in record
    ]
    kinds = [("all_points", name) for name in _POINT_COLUMNS]
    return markdown(header, rows + _variation_rows(results, baseline, kinds))


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
    names = ("accuracy", "completeness", "overall", "accuracy_median", "completeness_median")
    header = ("scan", "method", *(name.replace("_", " ") for name in names))
    rows = [
        [scene, method, *(record["dtu"][name] for name in names)]
        for scene, method, record in _records(results)
        if "dtu" in record
    ]
    return markdown(header, rows)


def run_tables(record: dict[str, Any]) -> str:
    """Tables of the result of `evaluation.run`."""
    parts = []
    if "mesh" in record:
        parts.append(mesh_tables(record["mesh"]))
    if "held_out_points" in record:
        rows = [
            _error_row(f"{name}, {kind}", errors)
            for name, kinds in record["held_out_points"].items()
            for kind, errors in kinds.items()
        ]
        header = ("depth error at left-out points", *_ERROR_NAMES, *_SHARE_NAMES)
        parts.append(markdown(header, rows))
    if "edges" in record:
        parts.append(edge_tables(record["edges"]))
    if "held_out_views" in record:
        parts.append(held_out_view_table(record["held_out_views"]))
    return "\n\n".join(parts)


def held_out_view_table(errors: list[dict[str, Any]]) -> str:
    """Table of `held_out.ViewErrors`."""
    names = ("view", "points", "median_px", "within_1_px", "within_2_px", "chance_2_px")
    header = ("left-out image", "edge points", "median px", "within 1 px", "2 px", "2 px by chance")
    return markdown(header, [[error[name] for name in names] for error in errors])
