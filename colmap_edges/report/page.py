"""The page: template, data, plotly.js and the script that ties them, in one file."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

from colmap_edges.colmap.model import Model, observation_residuals
from colmap_edges.export.edges import edge_lengths
from colmap_edges.report.charts import edge_charts, stage_chart
from colmap_edges.report.contents import Contents, ImagePicture, Trace, typed
from colmap_edges.report.pictures import data_uri, reprojected_layer
from colmap_edges.report.scene3d import scene_figure
from colmap_edges.report.tracks import edge_data, views_per_edge


def write_report(path: Path, contents: Contents, record: Mapping[str, Any]) -> dict[str, int]:
    """Write report.html.

    Args:
        path: the file to write.
        contents: what the run made.
        record: what report.json holds.

    Returns:
        Counts: pictures, bytes of the file.
    """
    from plotly.offline import get_plotlyjs

    pictures = contents.pictures
    template = Template(resource("page.html"))
    page = template.substitute(
        title=html.escape(f"colmap-edges {record['command']}"),
        findings=findings_html(record["findings"]),
        funnel=funnel_html(record["funnel"]),
        stages=table_html(stage_rows(record["stages"])),
        versions=html.escape(", ".join(f"{k} {v}" for k, v in record["versions"].items())),
        paths=table_html([(key, str(value)) for key, value in record["paths"].items()]),
        options=table_html(option_rows(record["options"])),
        pictures=pictures_html(contents),
        picture_note=html.escape(picture_note(contents.model, pictures)),
        data=script_json(page_data(contents, record)),
        plotly=get_plotlyjs(),
        script=resource("page.js"),
    )
    # Names of folders may be bytes that are no text.
    path.write_text(page, encoding="utf-8", errors="backslashreplace")
    return {"pictures": len(pictures), "bytes": path.stat().st_size}


def resource(name: str) -> str:
    """A text file of this package."""
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def page_data(contents: Contents, record: Mapping[str, Any]) -> Trace:
    """Everything the page's script reads."""
    figure, starts = scene_figure(contents)
    charts = [stage_chart(record["stages"])]
    data: Trace = {"scene": figure, "edges": None}
    model, edges = contents.model, contents.edges
    if edges is not None:
        residuals = observation_residuals(model, edges)
        num_views = views_per_edge(edges, len(model.views))
        charts = edge_charts(num_views, residuals, edge_lengths(edges)) + charts
        pictured = [picture.view for picture in contents.pictures]
        data["edges"] = edge_data(model, edges, residuals, pictured)
        data["edges"]["starts"] = typed(starts, "i4")
    return {**data, "charts": charts}


def script_json(data: Any) -> str:
    """JSON that can stand in a script element: no character in it can end that."""
    text = json.dumps(data, separators=(",", ":"), allow_nan=False)
    return text.replace("&", "\\u0026").replace("<", "\\u003c").replace(">", "\\u003e")


def table_html(rows: Sequence[tuple[str, ...]]) -> str:
    """A table of texts, escaped; the first of each row is its head."""
    lines = []
    for head, *cells in rows:
        data = "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        lines.append(f"<tr><th>{html.escape(head)}</th>{data}</tr>")
    return f"<table>{''.join(lines)}</table>"


def findings_html(findings: Sequence[Mapping[str, str]]) -> str:
    """What the user should know, with the remedy of each."""
    if not findings:
        return "<p>Nothing unusual.</p>"
    items = (
        f"<li><b>{html.escape(sentence(f['text']))}</b> {html.escape(sentence(f['remedy']))}</li>"
        for f in findings
    )
    return f'<ul class="findings">{"".join(items)}</ul>'


def sentence(text: str) -> str:
    """The text with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def funnel_html(funnel: Sequence[Mapping[str, Any]]) -> str:
    """The section on what is left after each step, with the share of the step before."""
    if not funnel:
        return ""
    rows = [
        (
            step["name"],
            f"{step['count']:,}",
            "" if step["share"] is None else f"{100 * step['share']:.0f} %",
        )
        for step in funnel
    ]
    title = "Where edges were lost: what is left after each step"
    return f"<section><h2>{title}</h2>{table_html(rows)}</section>"


def stage_rows(stages: Sequence[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Seconds, memory and counts of every stage."""
    rows: list[tuple[str, ...]] = []
    for stage in stages:
        counts = {k: v for k, v in stage["counts"].items() if isinstance(v, int | float)}
        text = ", ".join(f"{value:,} {key.replace('_', ' ')}" for key, value in counts.items())
        rows.append((stage["name"], f"{stage['wall_s']:.2f} s", f"{stage['peak_mb']:.0f} MB", text))
    return rows


def option_rows(options: Mapping[str, Any], prefix: str = "") -> list[tuple[str, ...]]:
    """Every option with its value, groups joined by a dot."""
    rows: list[tuple[str, ...]] = []
    for key, value in options.items():
        if isinstance(value, Mapping):
            rows += option_rows(value, f"{prefix}{key}.")
        else:
            rows.append((prefix + key, str(value)))
    return rows


def pictures_html(contents: Contents) -> str:
    """One figure an image: the photograph under its layers, and its name."""
    figures = []
    for number, picture in enumerate(contents.pictures):
        name = html.escape(contents.model.views[picture.view].name)
        reprojected = reprojected_layer(picture, contents.model, contents.edges)
        layers = {
            "detected": picture.detected,
            "dropped": picture.dropped,
            "reprojected": reprojected,
        }
        images = "".join(
            f'<img class="layer {kind}" alt="" src="{data_uri("png", data)}">'
            for kind, data in layers.items()
            if data
        )
        figures.append(
            f'<figure data-picture="{number}"><div class="stack">'
            f'<img class="photo" alt="{name}" src="{data_uri("jpeg", picture.photo)}">'
            f"{images}</div><figcaption>{name}</figcaption></figure>"
        )
    return "".join(figures)


def picture_note(model: Model, pictures: Sequence[ImagePicture]) -> str:
    """How many of the images are shown."""
    if len(pictures) == len(model.views):
        return f"All {len(pictures)} images."
    return f"{len(pictures)} of {len(model.views)} images, evenly spread."
