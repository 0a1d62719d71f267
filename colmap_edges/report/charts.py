"""Charts of the report: histograms of the edges, losses per step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import FloatArray, IntArray

Chart = dict[str, Any]
Row = tuple[str, float, str]


def edge_charts(num_views: IntArray, residuals: FloatArray, lengths: FloatArray) -> list[Chart]:
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
) -> Chart:
    """A histogram of `values` in `bins`, as drawn by page.html in 360 x 220 units."""
    left, right, top, base = 52, 346, 12, 178  # of the bars
    counts, _ = np.histogram(values, bins)
    scale = np.log10 if log else np.asarray
    low, high, most = float(scale(bins[0])), float(scale(bins[-1])), max(int(counts.max()), 1)
    x = left + (scale(bins) - low) / (high - low) * (right - left)
    heights = counts / most * (base - top)
    sides = np.column_stack([x[:-1], base - heights, np.maximum(np.diff(x) - 0.5, 0.5), heights])
    bars = [
        (*side, f"{first:.4g} to {last:.4g}: {count:,} {y_title}")
        for side, first, last, count in zip(
            sides.round(1).tolist(), bins[:-1], bins[1:], counts, strict=True
        )
        if count
    ]
    labels: list[tuple[float, float, str, str]] = []
    lines = [round(base - value / most * (base - top), 1) for value in nice_ticks(0, most)]
    for y, value in zip(lines, nice_ticks(0, most), strict=True):
        labels.append((left - 8, y + 4, shortened(value), "end"))
    for value in decades(low, high) if log else nice_ticks(low, high):
        at = left + (float(scale(value)) - low) / (high - low) * (right - left)
        labels.append((round(at, 1), base + 16, shortened(value), "middle"))
    labels.append(((left + right) / 2, 214, x_title, "middle"))
    middle = f"median {np.median(values):.4g}" if len(values) else "none"
    description = f"{title}: {len(values):,} {y_title}, {x_title}, {middle}"
    return {
        "title": title,
        "description": description,
        "lines": lines,
        "bars": bars,
        "labels": labels,
    }


def shortened(value: float) -> str:
    """A number as an axis label: 0.25, 20,000, 3 M."""
    return f"{value:,.10g}" if abs(value) < 1e6 else f"{value / 1e6:,.10g} M"


def nice_ticks(low: float, high: float) -> list[float]:
    """About four round numbers from `low` to `high`: multiples of 1, 2 or 5 times 10^n."""
    power = 10.0 ** np.floor(np.log10((high - low) / 4))
    step = next(m * power for m in (1, 2, 5, 10) if (high - low) / (m * power) <= 5)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(f"{i * step:.10g}") for i in range(first, last + 1)]


def decades(low: float, high: float) -> list[float]:
    """Round numbers between 10^low and 10^high."""
    factors = (1,) if high - low > 2 else (1, 2, 5)
    step = max(int((high - low) // 4), 1)
    powers = range(int(np.floor(low)), int(np.ceil(high)) + 1, step)
    found = [f * 10.0**p for p in powers for f in factors]
    return [value for value in found if low <= np.log10(value) <= high]


def funnel_rows(funnel: Sequence[Mapping[str, Any]]) -> dict[str, list[Row]]:
    """Name, count and text of each step of tracing by unit; empty if nothing was found."""
    rows: dict[str, list[Row]] = {}
    for step in funnel if any(step["count"] for step in funnel) else ():
        part = "" if step["share"] is None else f" ({100 * step['share']:.0f} % of the line above)"
        row = (step["name"], float(step["count"]), f"{step['count']:,}{part}")
        rows.setdefault(step["unit"], []).append(row)
    return rows
