"""Charts of the report as SVG: histograms of the edges, losses per step, seconds per stage."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import FloatArray, IntArray

WIDTH, HEIGHT = 360, 220  # size of a chart in SVG units; the page scales it
LEFT, RIGHT, TOP, BOTTOM = 52, 14, 12, 42  # margins around the bars
EDGE_COLOR = "#2f6db5"
NUM_TICKS = 4  # approximate number of ticks of an axis


def edge_charts(num_views: IntArray, residuals: FloatArray, lengths: FloatArray) -> list[str]:
    """Histograms of views per edge, residuals of observations, and lengths.

    Args:
        num_views: (E,) views that observe each edge.
        residuals: (T,) distances of observations from projections, pixels.
        lengths: (E,) lengths, world units.
    """
    if len(num_views) == 0:
        return []
    finite = residuals[np.isfinite(residuals)]
    views = np.arange(num_views.min(), num_views.max() + 2, dtype=np.float64) - 0.5
    limit = max(float(np.percentile(finite, 99.5)), 1e-3) if len(finite) else 1.0
    low, high = max(lengths.min(), 1e-12), max(lengths.max(), 1e-12)
    logs = np.logspace(np.log10(low) - 0.01, np.log10(high) + 0.01, 41)
    pixels = "reprojection error, px"
    return [
        histogram("Edges by number of views", "views", "edges", num_views, views),
        histogram(
            "Observations by residual", pixels, "observations", finite, np.linspace(0, limit, 51)
        ),
        histogram("Edges by length", "length, scene units", "edges", lengths, logs, log=True),
    ]


def histogram(
    title: str,
    x_title: str,
    y_title: str,
    values: NDArray[Any],
    bins: FloatArray,
    *,
    log: bool = False,
) -> str:
    """A figure with the histogram of `values` in `bins`."""
    counts, _ = np.histogram(values, bins)
    scale = np.log10 if log else np.asarray
    low, high, top = float(scale(bins[0])), float(scale(bins[-1])), max(int(counts.max()), 1)
    right = LEFT + (scale(bins) - low) / (high - low) * (WIDTH - LEFT - RIGHT)
    base = HEIGHT - BOTTOM
    heights = counts / top * (base - TOP)
    parts = []
    for value in nice_ticks(0, top):
        at = base - value / top * (base - TOP)
        parts.append(f'<path d="M{LEFT - 4} {at:.1f}H{WIDTH - RIGHT}"/>')
        parts.append(label(LEFT - 8, at + 4, shortened(value), "end"))
    parts += [
        f'<rect x="{x:.1f}" y="{base - height:.1f}" width="{max(end - x - 0.5, 0.5):.1f}" '
        f'height="{height:.1f}"><title>{first:.4g} to {last:.4g}: {count:,} {y_title}</title>'
        "</rect>"
        for x, end, height, first, last, count in zip(
            right[:-1], right[1:], heights, bins[:-1], bins[1:], counts, strict=True
        )
        if count
    ]
    for value in decades(low, high) if log else nice_ticks(low, high):
        at = LEFT + (float(scale(value)) - low) / (high - low) * (WIDTH - LEFT - RIGHT)
        parts.append(label(at, base + 16, shortened(value), "middle"))
    parts.append(label((LEFT + WIDTH - RIGHT) / 2, HEIGHT - 6, x_title, "middle"))
    middle = f"median {np.median(values):.4g}" if len(values) else "none"
    return chart(title, f"{title}: {len(values):,} {y_title}, {x_title}, {middle}", parts)


def label(x: float, y: float, text: str, anchor: str) -> str:
    """A short text of a drawing."""
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{html.escape(text)}</text>'


def shortened(value: float) -> str:
    """A number as an axis label: 0.25, 20,000, 3 M."""
    return f"{value:,.10g}" if abs(value) < 1e6 else f"{value / 1e6:,.10g} M"


def chart(title: str, description: str, parts: Sequence[str]) -> str:
    """A figure with title and chart of counts; `description` is for screen readers."""
    return (
        f'<figure class="chart"><figcaption>{html.escape(title)} '
        '<span class="unit">(count)</span></figcaption>'
        f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{html.escape(description)}" '
        f'fill="{EDGE_COLOR}">{"".join(parts)}</svg></figure>'
    )


def nice_ticks(low: float, high: float) -> list[float]:
    """Round numbers from `low` to `high`: multiples of 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10((high - low) / NUM_TICKS))
    step = next(m * power for m in (1, 2, 5, 10) if (high - low) / (m * power) <= NUM_TICKS + 1)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(f"{i * step:.10g}") for i in range(first, last + 1)]


def decades(low: float, high: float) -> list[float]:
    """Round numbers between 10^low and 10^high."""
    factors = (1,) if high - low > 2 else (1, 2, 5)
    step = max(int((high - low) // NUM_TICKS), 1)
    powers = range(int(np.floor(low)), int(np.ceil(high)) + 1, step)
    found = [f * 10.0**p for p in powers for f in factors]
    return [value for value in found if low <= np.log10(value) <= high]


def bar_rows(rows: Sequence[tuple[str, float, str]], title: str, description: str) -> str:
    """A table with a name, a bar and a text per row; bars are scaled to the largest value.

    Args:
        rows: name, value and text of each row.
        title: the heading over the rows, with the unit.
        description: text for screen readers.
    """
    most = max((value for _, value, _ in rows), default=0.0) or 1.0
    lines = [
        f'<tr><th scope="row">{html.escape(name)}</th>'
        f'<td class="bar"><span style="width:{100 * value / most:.1f}%"></span></td>'
        f'<td class="number">{html.escape(text)}</td></tr>'
        for name, value, text in rows
    ]
    hidden = f'<span class="heard">: {html.escape(description)}</span>'
    caption = f"<caption>{html.escape(title)}{hidden}</caption>"
    return f'<table class="bars">{caption}{"".join(lines)}</table>'


def stage_chart(stages: Sequence[Mapping[str, Any]]) -> str:
    """Seconds of every stage as bars."""
    rows = [(s["name"], float(s["wall_s"]), f"{s['wall_s']:.2f} s") for s in stages]
    return bar_rows(rows, "Time (seconds)", "seconds of each stage")


def funnel_charts(funnel: Sequence[Mapping[str, Any]]) -> str:
    """Charts of the numbers left after each step of tracing, one per unit."""
    groups: dict[str, list[tuple[str, float, str]]] = {}
    for step in funnel:
        part = "" if step["share"] is None else f" ({100 * step['share']:.0f} % of the line above)"
        row = (step["name"], float(step["count"]), f"{step['count']:,}{part}")
        groups.setdefault(step["unit"], []).append(row)
    ends = [f"{text} {name}" for ((name, _, text), *more) in groups.values() if not more]
    tables = [
        bar_rows(rows, f"Number of {unit}", "numbers left after each step")
        for unit, rows in groups.items()
        if len(rows) > 1
    ]
    return f"<p>{html.escape(', '.join(ends))}.</p>{''.join(tables)}"
