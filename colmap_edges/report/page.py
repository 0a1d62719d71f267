"""Assembly of report.html from template, data, three.js and script."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import observation_residuals
from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.report.charts import Chart, edge_charts, funnel_rows
from colmap_edges.report.contents import Contents, ImagePicture, Packed
from colmap_edges.report.outcome import VIEWERS, headline, outcome, scene_name, verdict
from colmap_edges.report.packing import compressed, data_uri, embedded, pack
from colmap_edges.report.pictures import reprojected_layer
from colmap_edges.report.scene3d import scene_data
from colmap_edges.report.still import still_picture
from colmap_edges.report.tracks import edge_data, edge_details
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
    from jinja2 import Environment, StrictUndefined

    model, residuals = contents.model, residuals_of(contents)
    what = {"3D edges": contents.edges, "mesh": contents.mesh}
    environment = Environment(
        autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    page = environment.from_string(resource("page.html")).render(
        record=record,
        name=scene_name(record["paths"]),
        kinds=" and ".join(kind for kind, there in what.items() if there is not None) or "model",
        headline=headline(record),
        verdict=verdict(record, path.parent),
        facts=outcome(record),
        still=data_uri("webp", still_picture(contents)),
        funnel=funnel_rows(record["funnel"]),
        charts=charts(contents, residuals),
        seconds=[(s["name"], s["wall_s"], f"{s['wall_s']:.2f} s") for s in record["stages"]],
        stages=list(map(stage_row, record["stages"])),
        files=file_rows(path.parent),
        options=option_rows(record["options"]),
        pictures=[picture_row(contents, picture) for picture in contents.pictures],
        num_images=len(model.views),
        data=embedded(pack(page_data(contents, residuals))),
        three=embedded(compressed(resource("three.min.js").encode())),
        script=resource("page.js"),
    )
    # Folder names may not be valid text.
    data = page.encode("utf-8", "backslashreplace")
    write_whole(path, data, "report")
    return {"pictures": len(contents.pictures), "bytes": len(data)}


def resource(name: str) -> str:
    """A text file of this package."""
    return resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


def residuals_of(contents: Contents) -> FloatArray:
    """(T,) distances of the observations of edge points from projections, pixels."""
    if contents.edges is None:
        return np.zeros(0)
    return observation_residuals(contents.model, contents.edges)


def page_data(contents: Contents, residuals: FloatArray) -> Packed:
    """The data read by the page's script."""
    scene, starts = scene_data(contents)
    model, edges = contents.model, contents.edges
    if not edges:
        return {"scene": scene, "edges": None}
    pictured = [picture.view for picture in contents.pictures]
    data = edge_data(model, edges, residuals, pictured)
    curves = Curves3D.none() if contents.curves is None else contents.curves
    data |= edge_details(edges, curves, np.array(scene["origin"]))
    return {"scene": scene, "edges": {**data, "starts": starts.astype(np.int32)}}


def charts(contents: Contents, residuals: FloatArray) -> list[Chart]:
    """The histograms of the 3D edges, if there are any."""
    edges = contents.edges
    if edges is None:
        return []
    return edge_charts(edges.num_views, residuals, edges.lengths())


def file_rows(folder: Path) -> list[tuple[str, str]]:
    """The files next to the page, with programs that open them; report.json is written later."""
    made = {path.name for path in folder.iterdir()} | {"report.json"}
    return [(name, VIEWERS[name]) for name in VIEWERS if name in made - {"report.html"}]


def stage_row(stage: Mapping[str, Any]) -> tuple[str, str, list[str]]:
    """Name, memory and counts of a stage."""
    counts = {k: v for k, v in stage["counts"].items() if isinstance(v, int | float)}
    texts = [count_text(name, value) for name, value in counts.items()]
    return stage["name"], f"{stage['peak_mb']:.0f} MB", texts


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


def picture_row(contents: Contents, picture: ImagePicture) -> tuple[str, str, dict[str, str]]:
    """Name of an image, its photograph, and the layers that are drawn over it."""
    edges = contents.edges
    layers = {
        "detected": picture.detected,
        "dropped": picture.dropped,
        "reprojected": reprojected_layer(picture, contents.model, edges) if edges else None,
    }
    drawn = {kind: data_uri("png", data) for kind, data in layers.items() if data}
    return contents.model.views[picture.view].name, data_uri("jpeg", picture.photo), drawn
