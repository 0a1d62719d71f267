"""Histograms of the edges and the seconds of the stages, as figures of plotly.js."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.report.contents import Trace


def edge_charts(num_views: IntArray, residuals: FloatArray, lengths: FloatArray) -> list[Trace]:
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
    return [
        histogram("Views per edge", "views", "edges", num_views, views),
        histogram(
            "Residuals",
            "distance of observation from projection, px",
            "observations",
            finite,
            np.linspace(0, limit, 51),
        ),
        histogram("Lengths of edges", "length, world units", "edges", lengths, logs, log=True),
    ]


def histogram(
    title: str,
    x_title: str,
    y_title: str,
    values: NDArray[Any],
    bins: FloatArray,
    *,
    log: bool = False,
) -> Trace:
    """Counts of `values` in `bins` as bars."""
    counts, _ = np.histogram(values, bins)
    middles = np.sqrt(bins[1:] * bins[:-1]) if log else (bins[1:] + bins[:-1]) / 2
    bars = {
        "type": "bar",
        "x": middles.tolist(),
        "y": counts.tolist(),
        "width": np.diff(bins).tolist(),
        "marker": {"color": "#3b7dd8"},
        "hovertemplate": "%{x:.4g}: %{y}<extra></extra>",
    }
    axis = {"title": {"text": x_title}, "type": "log" if log else "linear"}
    return {"data": [bars], "layout": chart_layout(title, axis, {"title": {"text": y_title}})}


def stage_chart(stages: Sequence[Mapping[str, Any]]) -> Trace:
    """Seconds of every stage as bars."""
    bars = {
        "type": "bar",
        "orientation": "h",
        "y": [stage["name"] for stage in stages],
        "x": [stage["wall_s"] for stage in stages],
        "text": [f"{stage['wall_s']:.2f} s" for stage in stages],
        "textposition": "auto",
        "marker": {"color": "#5aa469"},
        "hoverinfo": "skip",
    }
    y_axis = {"autorange": "reversed"}
    return {"data": [bars], "layout": chart_layout("Time", {"title": {"text": "seconds"}}, y_axis)}


def chart_layout(title: str, x_axis: Trace, y_axis: Trace) -> Trace:
    """Title, axes and margins of a chart."""
    return {
        "title": {"text": title, "font": {"size": 15}},
        "xaxis": {**x_axis, "automargin": True},
        "yaxis": {**y_axis, "automargin": True},
        "margin": {"l": 50, "r": 15, "t": 40, "b": 45},
        "height": 280,
        "bargap": 0,
    }
