"""Conversion of options as given to settings as used, for the whole run and for single steps."""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from typing import Any

from colmap_edges.declared_options import Options, derived
from colmap_edges.options.whole import PipelineOptions


def resolved(options: PipelineOptions, scale: float) -> PipelineOptions:
    """The settings of a run, with lengths in pixels of the scaled images.

    Options that bound errors of poses and distortion are in pixels of the given images, whereas
    stages measure in pixels of the scaled images. Soft images, which are downsampled, localise
    features, and therefore poses, no better than the downsampled ones; lengths are then taken as
    pixels of the downsampled images. Call this once per run; nothing else converts.

    Args:
        options: the options as given.
        scale: upsampling factor of the images; below 1 for downsampled images.

    Returns:
        The options with `given_px` lengths converted to pixels of the scaled images.
    """
    groups: dict[str, Any] = {}
    times = max(1.0, scale)
    for entry in fields(options):
        group = getattr(options, entry.name)
        if isinstance(group, Options):
            declared = fields(group)  # type: ignore[arg-type]
            given = [inner.name for inner in declared if inner.metadata.get("given_px")]
            groups[entry.name] = derived(group, **{n: times * getattr(group, n) for n in given})
    return replace(options, **groups)


def of_later_rounds(settings: PipelineOptions) -> PipelineOptions:
    """The settings of later matching rounds: few chains remain, so less agreement suffices."""
    depths, views = settings.chain_depth, settings.tracing.min_agreeing_views
    least = depths.min_log_likelihood_ratio - depths.later_log_likelihood_ratio_drop
    return replace(
        settings,
        chain_depth=derived(depths, min_log_likelihood_ratio=least),
        tracing=derived(settings.tracing, min_agreeing_views=views - 1),
    )


def recorded(settings: PipelineOptions) -> dict[str, Any]:
    """The settings of a run for report.json, with the deviating settings of single steps."""
    steps = {}
    if settings.tracing.method == "chains" and settings.tracing.num_rounds > 1:
        steps["later_rounds"] = of_later_rounds(settings)
    return asdict(settings) | {name: differences(settings, of) for name, of in steps.items()}


def differences(settings: PipelineOptions, others: PipelineOptions) -> dict[str, dict[str, Any]]:
    """The values of `others` that differ from `settings`, by group."""
    before, after = asdict(settings), asdict(others)
    return {
        group: {name: value for name, value in values.items() if value != before[group][name]}
        for group, values in after.items()
        if values != before[group]
    }
