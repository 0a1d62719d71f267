"""Assembly of report.html from template, data, plotly.js and script."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model, observation_residuals
from colmap_edges.core.arrays import FloatArray
from colmap_edges.export.edges import edge_lengths
from colmap_edges.report.charts import edge_charts, funnel_charts, stage_chart
from colmap_edges.report.contents import Contents, ImagePicture, Trace
from colmap_edges.report.outcome import VIEWERS, headline, outcome, scene_name
from colmap_edges.report.packing import compressed, data_uri, embedded, pack
from colmap_edges.report.pictures import reprojected_layer
from colmap_edges.report.scene3d import scene_figure
from colmap_edges.report.still import still_picture
from colmap_edges.report.tracks import edge_data, views_per_edge
from colmap_edges.runtime.output import write_whole


def write_report(path: Path, contents: Contents, record: Mapping[str, Any]) -> dict[str, int]:
    """Write report.html.

    Args:
        path: the file to write.
        contents: the results of the run.
        record: the contents of report.json.

    Returns:
        Counts: pictures, bytes of the file.
    """
    from plotly.offline import get_plotlyjs

    pictures, residuals = contents.pictures, residuals_of(contents)
    name = scene_name(record["paths"])
    made = f"{record['date'][:10]} at {record['date'][11:16]} UTC"
    what = {"3D edges": contents.edges, "mesh": contents.mesh}
    kinds = " and ".join(kind for kind, there in what.items() if there is not None) or "model"
    template = Template(resource("page.html"))
    page = template.substitute(
        title=html.escape(f"{name}: {kinds}, {record['date'][:10]}"),
        scene=html.escape(name),
        headline=html.escape(headline(record)),
        made=html.escape(
            f"Made by colmap-edges {record['command']} "
            f"(version {record['versions']['colmap-edges']}) on {made}."
        ),
        facts=table_html(list(outcome(record).items())),
        findings=findings_html(record["findings"]),
        still=data_uri("webp", still_picture(contents)),
        funnel=funnel_html(record["funnel"]),
        charts="".join(charts(contents, residuals)),
        seconds=stage_chart(record["stages"]),
        stages=stages_html(record["stages"]),
        files=files_html(path.parent),
        versions=html.escape(", ".join(f"{k} {v}" for k, v in record["versions"].items())),
        paths=table_html([(key, str(value)) for key, value in record["paths"].items()]),
        options=table_html(option_rows(record["options"])),
        pictures=pictures_html(contents),
        picture_note=html.escape(picture_note(contents.model, pictures)),
        data=embedded(pack(page_data(contents, residuals))),
        plotly=embedded(compressed(get_plotlyjs().encode())),
        script=resource("page.js"),
    )
    # Folder names may not be valid text.
    data = page.encode("utf-8", "backslashreplace")
    write_whole(path, data, "report")
    return {"pictures": len(pictures), "bytes": len(data)}


def resource(name: str) -> str:
    """A text file of this package."""
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def residuals_of(contents: Contents) -> FloatArray:
    """(T,) distances of the observations of edge points from projections, pixels."""
    if contents.edges is None:
        return np.zeros(0)
    return observation_residuals(contents.model, contents.edges)


def page_data(contents: Contents, residuals: FloatArray) -> Trace:
    """The data read by the page's script."""
    figure, starts = scene_figure(contents)
    model, edges = contents.model, contents.edges
    if edges is None or edges.num_edges == 0:
        return {"scene": figure, "edges": None}
    pictured = [picture.view for picture in contents.pictures]
    data = edge_data(model, edges, residuals, pictured)
    return {"scene": figure, "edges": {**data, "starts": starts.astype(np.int32)}}


def charts(contents: Contents, residuals: FloatArray) -> list[str]:
    """The histograms of the 3D edges, if there are any."""
    edges = contents.edges
    if edges is None:
        return []
    num_views = views_per_edge(edges, len(contents.model.views))
    return edge_charts(num_views, residuals, edge_lengths(edges))


def table_html(rows: Sequence[tuple[str, ...]]) -> str:
    """A table of escaped texts; the first text of each row is its header."""
    lines = []
    for head, *cells in rows:
        data = "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        lines.append(f'<tr><th scope="row">{html.escape(head)}</th>{data}</tr>')
    return f"<table>{''.join(lines)}</table>"


def findings_html(findings: Sequence[Mapping[str, str]]) -> str:
    """The findings with their remedies."""
    if not findings:
        return "<p>Nothing unusual.</p>"
    items = (
        f"<li><b>{html.escape(sentence(f['text']))}</b> {html.escape(sentence(f['remedy']))}</li>"
        for f in findings
    )
    return f'<ul class="findings">{"".join(items)}</ul>'


def sentence(text: str) -> str:
    """The text as a sentence, with a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."


def funnel_html(funnel: Sequence[Mapping[str, Any]]) -> str:
    """The section with the numbers left after each step, and their shares."""
    if not any(step["count"] for step in funnel):
        return ""
    title = "Where edges were lost: numbers left after each step"
    return f'<section id="funnel"><h2>{title}</h2>{funnel_charts(funnel)}</section>'


def files_html(folder: Path) -> str:
    """Links to the files next to the page, with programs that open them.

    report.json is written later.
    """
    made = [name for name in VIEWERS if (folder / name).exists() or name == "report.json"]
    lines = (
        f'<tr><th scope="row"><a href="{name}">{name}</a></th>'
        f"<td>{html.escape(VIEWERS[name])}</td></tr>"
        for name in made
        if name != "report.html"
    )
    return f"<table>{''.join(lines)}</table>"


def stages_html(stages: Sequence[Mapping[str, Any]]) -> str:
    """Memory and counts of every stage, without line breaks between number and name."""
    rows = []
    for stage in stages:
        counts = {k: v for k, v in stage["counts"].items() if isinstance(v, int | float)}
        texts = (html.escape(count_text(k, v)) for k, v in counts.items())
        cells = " ".join(f'<span class="count">{text}</span>' for text in texts)
        name, memory = html.escape(stage["name"]), f"{stage['peak_mb']:.0f} MB"
        rows.append(
            f'<tr><th scope="row">{name}</th><td class="number">{memory}</td><td>{cells}</td></tr>'
        )
    return f"<table>{''.join(rows)}</table>"


def count_text(name: str, value: float) -> str:
    """A count as "24 images", any other figure as "length 273.4"."""
    words = name.replace("_", " ")
    if words.endswith(" px"):
        return f"{words.removesuffix(' px')} {value:,} px"
    return f"{words} {value:,}" if isinstance(value, float) else f"{value:,} {words}"


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
    """One figure per image: the photograph under its layers, and its name."""
    figures = []
    edges = contents.edges if contents.edges and contents.edges.num_edges else None
    for number, picture in enumerate(contents.pictures):
        name = html.escape(contents.model.views[picture.view].name)
        layers = {
            "detected": picture.detected,
            "dropped": picture.dropped,
            "reprojected": reprojected_layer(picture, contents.model, edges) if edges else None,
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
    """The number of images shown."""
    if len(pictures) == len(model.views):
        return f"All {len(pictures)} images."
    return f"{len(pictures)} of {len(model.views)} images, evenly spread."
