"""What --quality sets."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from colmap_edges.errors import OptionError
from colmap_edges.options.whole import PipelineOptions

# What --quality sets; medium is the defaults.
PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "low": {
        "detection": {"min_blur_px": 0.0},
        "view_selection": {"num_neighbors": 5, "num_later_neighbors": 5, "num_observing_views": 20},
        "chain_depth": {"sample_step_points": 36},
        "tracing": {"curve_step_points": 6},
    },
    "medium": {},
    "high": {
        "detection": {"min_blur_px": 1.2},
        "view_selection": {"num_neighbors": 16, "num_observing_views": 60},
        "chain_depth": {"sample_step_points": 8},
        "tracing": {"curve_step_points": 3},
    },
}


def preset(quality: str) -> PipelineOptions:
    """The options of a preset.

    Args:
        quality: low, medium or high; medium is `PipelineOptions()`.

    Raises:
        OptionError: when there is no such preset.
    """
    if quality not in PRESETS:
        raise OptionError(f"quality is {quality!r}; choose one of: {', '.join(PRESETS)}")
    defaults = PipelineOptions()
    groups = {
        name: replace(getattr(defaults, name), **values)
        for name, values in PRESETS[quality].items()
    }
    return replace(defaults, **groups)
