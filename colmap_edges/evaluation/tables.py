"""Records of an evaluation as Markdown tables and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from colmap_edges.runtime.output import write_whole

# Columns of tables: keys of records, with their headers unless these are the same.
SCORES = "threshold | precision | recall | f_score: F"


def headers(columns: str) -> dict[str, str]:
    """Headers by keys of a text such as `SCORES`."""
    pairs = (column.split(": ", 1) for column in columns.split(" | "))
    return {key: header[0] if header else key for key, *header in pairs}


ERRORS = headers("mae: MAE | rmse: RMSE | sigma: σ | median | p90: P90")
SHARES = headers(
    "coverage | right_0_5_percent: right at 0.5 % | right_1_percent: right at 1 %"
    " | right_2_percent: right at 2 %"
)
NORMALS = headers(
    "normals_median_deg: normals: median ° | normals_10_deg: normals within 10°"
    " | normals_30_deg: within 30°"
)


def write_figures(path: Path, record: dict[str, Any]) -> None:
    """Write figures as JSON.

    Raises:
        ColmapEdgesError: The file cannot be written.
    """
    write_whole(path, f"{json.dumps(record, indent=2)}\n".encode(), "figures")


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


def table(columns: Mapping[str, str] | str, records: Iterable[Mapping[str, Any]]) -> str:
    """A table of records, with a column for each key of `columns`; see `headers`."""
    columns = headers(columns) if isinstance(columns, str) else columns
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
        parts.append(table(SCORES, curves["scores"]))
        means = "accuracy: accuracy (mean) | completeness: completeness (mean)"
        parts.append(table(f"{means} | spacing: sample spacing | unit", [curves]))
        if "recall_by_views" in curves:
            parts.append(_visible_curve_table(curves))
    if "kinds" in record:
        columns = (
            "num_true: true curves found | num_found: curves | times_found: times each is found"
            " | right_kind: length of the right kind | right_radius: radii within 1 %"
            " | median_radius_error: median error of the radius"
        )
        parts.append(table(columns, [record["kinds"]]))
    if "times_found" in record:
        columns = (
            "threshold | result_length: edges on true curves | found_length: true curves found"
            " | times: times each is found"
        )
        parts.append(table(columns, record["times_found"]))
    if corners := record.get("corners"):
        columns = f"{SCORES} | result_corners: found | reference_corners: true"
        rows = [corners | row for row in corners["scores"]]
        parts.append(table(f"threshold: corners: {columns}", rows))
    if "twins" in record:
        header = [f"parallel twin within {row['limit_px']:g} px" for row in record["twins"]]
        parts.append(markdown(header, [[row["share"] for row in record["twins"]]]))
    return "\n\n".join([*parts, *_depth_and_length_tables(record)])


def _depth_and_length_tables(record: dict[str, Any]) -> list[str]:
    parts = []
    if depths := record.get("depth"):
        columns = (
            "name: relative depth error | count: pairs | median | p90: P90"
            " | within_0_2_percent: within 0.2 % | within_1_percent: within 1 %"
        )
        rows = [{"name": name} | of | of["relative"] for name, of in depths.items()]
        parts.append(table(columns, rows))
    if errors := record.get("reprojection"):
        columns = (
            "points: edge points | observations_mean: observations each"
            " | median: reprojection median px | p95: P95 px | within_1_px: within 1 px"
        )
        parts.append(table(columns, [errors | errors["distance_px"]]))
    columns = (
        "count: segments | total: total length | median | p95: P95 | longest | gross"
        " | gross_total: gross length"
    )
    return [*parts, table(columns, [record["lengths"]])]


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
    records = [
        {"scene": scene, "label": f"{scene} ({entry['unit']})", "method": method} | record
        for scene, entry in results.items()
        for method, record in entry["methods"].items()
    ]
    note = """\
Points: distance to the reference cloud, or (reference depth only) depth error in the views
that observe them, smallest in 5x5 pixels. Rows with edges or lines count the points on these
alone, rows without them the SfM points. Mesh: depth error from the reference's cameras.
σ is the standard deviation of the absolute errors. Lengths in each scene's unit.
Right at 1 %: share of all reference pixels at which the mesh lies within 1 % of the pixel's
depth; holes are wrong. Normals within 10° likewise, of the pixels at which the reference has
a normal; their median is that of the pixels with mesh.
Average variation: mean change of an error against {baseline}, over all scenes that have both."""
    parts = ["# Errors of points and meshes", note.replace("{baseline}", baseline)]
    parts += [_error_rows(records, baseline, "points", mesh=True)]
    if any("all_points" in record for record in records):
        parts += ["## Points counted as the paper's authors do"]
        parts += ["The SfM points are among the points of every row."]
        parts += [_error_rows(records, baseline, "all_points", mesh=False)]
    if any("dtu" in record for record in records):
        columns = (
            "scene: scan | method | accuracy | completeness | overall"
            " | accuracy_median: accuracy median | completeness_median: completeness median"
        )
        rows = [record | record["dtu"] for record in records if "dtu" in record]
        parts += ["## DTU's own distances (mm)", table(columns, rows)]
    notes = [f"- {r['scene']}: {note}" for r in records for note in r.get("notes", ())]
    if notes:
        parts += ["## Left empty", "\n".join(dict.fromkeys(notes))]
    failures = [f"- {r['scene']}, {r['method']}: {r['error']}" for r in records if "error" in r]
    if failures:
        parts += ["## Failed", "\n".join(failures)]
    return "\n\n".join(parts)


def _error_rows(records: list[dict[str, Any]], baseline: str, points: str, *, mesh: bool) -> str:
    """A row for each scene and method, then each method's average variation."""
    of_points, shares = [*ERRORS][:4], SHARES | NORMALS
    header = ["scene", "method", "points", "points MAE", *[*ERRORS.values()][1:4]]
    kinds = [(points, name) for name in of_points]
    if mesh:
        header += ["mesh MAE", *[*ERRORS.values()][1:], *shares.values(), "faces"]
        kinds += [("mesh", name) for name in ERRORS]
    rows = []
    for record in (record for record in records if points in record):
        row = [record["label"], record["method"], record[points]["count"]]
        row += [record.get(part, {}).get(name, math.nan) for part, name in kinds]
        if mesh:
            row += [record.get("mesh", {}).get(name, math.nan) for name in shares]
            row += [record["faces"]]
        rows.append(row)
    empty = [""] * (len(header) - 3 - len(kinds))
    for method in dict.fromkeys(record["method"] for record in records):
        cells = [_variation(records, baseline, method, *kind) for kind in kinds]
        if method != baseline and any(cells):
            rows.append(["**average variation**", method, "", *cells, *empty])
    return markdown(header, rows)


def _variation(records: list[dict[str, Any]], base: str, method: str, part: str, name: str) -> str:
    """Mean over scenes of a method's error against the baseline's, in percent."""
    errors: dict[str, dict[str, float]] = {base: {}, method: {}}
    for record in records:
        error = record.get(part, {}).get(name)
        if record["method"] in errors and error is not None and math.isfinite(error):
            errors[record["method"]][record["scene"]] = error
    both = [s for s, error in errors[base].items() if error and s in errors[method]]
    changes = [errors[method][scene] / errors[base][scene] - 1 for scene in both]
    return f"{100 * sum(changes) / len(changes):+.1f} %" if changes else ""


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
        columns = (
            "view: left-out image | points: edge points | median_px: median px"
            " | within_1_px: within 1 px | within_2_px: 2 px | chance_2_px: 2 px by chance"
        )
        parts.append(table(columns, record["held_out_views"]))
    return "\n\n".join(parts)
