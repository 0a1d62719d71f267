"""Export of curves projected into one image as SVG, dashed where the image does not see them."""

from __future__ import annotations

import html
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    offsets_of,
    owners_of,
    ranks_of,
)
from colmap_edges.core.checks import checked
from colmap_edges.core.curves3d import KINDS, LINE, Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View
from colmap_edges.errors import printable
from colmap_edges.images.files import path_of_image
from colmap_edges.runtime.output import write_whole

COLORS = ("#1f4e9c", "#b8431c", "#b8431c", "#1c7d4c", "#1c7d4c", "#7a3fa0")  # by kind
HEAD = """<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}"
 viewBox="0 0 {width} {height}">
<title>{title}</title>
<style>
path {{ fill: none; stroke-width: {stroke:.3g}; stroke-linecap: round; stroke-linejoin: round }}
.hidden {{ stroke-dasharray: {dash:.3g} {dash:.3g}; stroke-opacity: 0.45 }}
{styles}
</style>
"""


@checked
def write_svg(
    edges: Edges3D,
    curves: Curves3D,
    view: View,
    index: int,
    path: Path,
    *,
    overwrite: bool = True,
) -> None:
    """Write curves projected into a view, grouped by kind, dashed where they are not observed.

    Args:
        edges: the edges.
        curves: the curves that they consist of.
        view: the view.
        index: index of the view in the model.
        path: file to write.
        overwrite: replace an existing file.

    Raises:
        ColmapEdgesError: if the file cannot be written, or exists and `overwrite` is false.
    """
    curves.check("curves", edges)
    seen = points_seen(edges, index)
    size = max(view.width, view.height)
    styles = "\n".join(f".{kind} {{ stroke: {c} }}" for kind, c in zip(KINDS, COLORS, strict=True))
    title = html.escape(printable(view.name))  # XML cannot hold control characters
    lines = [
        HEAD.format(
            width=view.width,
            height=view.height,
            title=title,
            stroke=size / 800,
            dash=size / 200,
            styles=styles,
        )
    ]
    # Segments of a drawn curve; distortion bends lines, too.
    steps = np.where(curves.kinds == LINE, 32, 128)
    offsets = offsets_of(steps + 1)
    owners = owners_of(offsets)
    pixels, depths = view.project(curves.at(owners, ranks_of(steps + 1) / steps[owners]))
    inside = view.holds(pixels, depths)
    for kind, name in enumerate(KINDS):
        lines.append(f'<g class="{name}">\n')
        for curve in np.flatnonzero(curves.kinds == kind).tolist():
            drawn = slice(*offsets[curve : curve + 2])
            lines += paths_of(edges, curves, curve, seen, pixels[drawn], inside[drawn])
        lines.append("</g>\n")
    write_whole(path, ("".join(lines) + "</svg>\n").encode(), "curves", overwrite=overwrite)


def write_svgs(
    edges: Edges3D,
    curves: Curves3D,
    views: Sequence[View],
    folder: Path,
    *,
    overwrite: bool = True,
) -> None:
    """Write an SVG for each view into a folder, by the view's name; see `write_svg`."""
    for index, view in enumerate(views):
        path = path_of_image(folder, f"{view.name}.svg")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_svg(edges, curves, view, index, path, overwrite=overwrite)


def points_seen(edges: Edges3D, index: int) -> BoolArray:
    """(N,) whether a view observes an edge point, or points nearby on both sides of it."""
    observed = np.zeros(edges.num_points, bool)
    observed[edges.observations.points[edges.observations.views == index]] = True
    where = np.arange(edges.num_points)
    before = np.maximum.accumulate(np.where(observed, where, -edges.num_points))
    after = np.minimum.accumulate(np.where(observed, where, 2 * edges.num_points)[::-1])[::-1]
    first = edges.edge_offsets[:-1][edges.edge_ids]
    last = edges.edge_offsets[1:][edges.edge_ids] - 1
    # Up to three points between observed ones count as observed, too.
    between = (before >= first) & (after <= last) & (after - before <= 4)
    return np.asarray(observed | between)


def paths_of(
    edges: Edges3D,
    curves: Curves3D,
    curve: int,
    seen: BoolArray,
    pixels: FloatArray,
    inside: BoolArray,
) -> list[str]:
    """The SVG paths of a curve: its stretches in the image, observed and unobserved.

    Args:
        edges: the edges.
        curves: the curves.
        curve: index of the curve.
        seen: (N,) whether the view observes the edge points.
        pixels: (n, 2) projections of evenly spread points of the curve.
        inside: (n,) whether these are in the image.
    """
    first, end = curves.ranges[curve].tolist()
    start = int(edges.edge_offsets[curves.edges[curve]])
    size = int(edges.edge_offsets[curves.edges[curve] + 1]) - start
    rows = first + np.rint(np.linspace(0, 1, len(pixels)) * (end - 1 - first)).astype(np.int64)
    shown = seen[start + (rows - start) % size]
    drawn = inside[:-1] & inside[1:]
    states = np.where(drawn, np.where(shown[:-1] & shown[1:], 2, 1), 0)
    return [
        path_of(pixels[a : b + 1], state == 2) for a, b, state in stretches(states) if state > 0
    ]


def stretches(states: IntArray) -> list[tuple[int, int, int]]:
    """Half-open index range and state of each stretch of equal (n,) states."""
    cuts = [0, *(np.flatnonzero(np.diff(states)) + 1).tolist(), len(states)]
    return [(a, b, int(states[a])) for a, b in pairwise(cuts)]


def path_of(pixels: FloatArray, is_seen: bool) -> str:
    """One path through (n, 2) pixels."""
    points = " ".join(f"{x:.2f},{y:.2f}" for x, y in pixels.tolist())
    style = "" if is_seen else ' class="hidden"'
    return f'<path{style} d="M {points}"/>\n'
