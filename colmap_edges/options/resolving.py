"""Options as given -> settings as used, by the whole run and by those of its steps that differ."""

from __future__ import annotations

from dataclasses import asdict, fields, replace
from typing import Any

from colmap_edges.declared_options import Options, derived
from colmap_edges.options.whole import PipelineOptions


def resolved(options: PipelineOptions, scale: float) -> PipelineOptions:
    """The settings of a run whose images are upsampled or reduced, in the stages' pixels.

    Poses and distortion are off by pixels of the images as they are given, so what users say of
    them is in these pixels. Stages work on scaled images and measure in their pixels. Where images
    are reduced because they are soft, features are placed no better than in the reduced images,
    and poses with them: lengths are then so many pixels of the reduced images. This is the
    only place that converts; it is called once a run. The settings are not to be converted again.

    Args:
        options: as given, every length of them as it was declared.
        scale: how many times the images are upsampled; below 1 where they are reduced.

    Returns:
        The same, with what was declared in pixels of the given images in those of the scaled ones.
    """
    groups: dict[str, Any] = {}
    times = max(1.0, scale)
    for entry in fields(options):
        group = getattr(options, entry.name)
        if isinstance(group, Options):
            declared = fields(group)  # type: ignore[arg-type]
            given = [inner.name for inner in declared if inner.metadata["given_px"]]
            groups[entry.name] = derived(group, **{n: times * getattr(group, n) for n in given})
    return replace(options, **groups)


def of_later_rounds(settings: PipelineOptions) -> PipelineOptions:
    """The settings of later rounds: where fewer chains are left, less agreement is enough."""
    depths, views = settings.chain_depth, settings.tracing.min_agreeing_views
    least = depths.min_log_likelihood_ratio - depths.later_log_likelihood_ratio_drop
    return replace(
        settings,
        chain_depth=derived(depths, min_log_likelihood_ratio=least),
        tracing=derived(settings.tracing, min_agreeing_views=views - 1),
    )


def of_pose_edges(settings: PipelineOptions) -> PipelineOptions:
    """The settings by which the edges are traced that poses are refined on.

    By the first round alone, whose edges are the surest, in views that look from near by, and by
    their places across the chains, for nothing else is known of edges when poses are refined. More
    densely sampled chains give more of them. The paper's tracing has none of these options.
    """
    if settings.tracing.method == "paper":
        return settings
    selection, depths = settings.view_selection, settings.chain_depth
    step = int(settings.bundle_adjustment.sample_step_ratio * depths.sample_step_points)
    return replace(
        settings,
        chain_depth=derived(depths, sample_step_points=step),
        view_selection=replace(selection, max_observing_angle_deg=selection.max_angle_deg),
        refinement=replace(settings.refinement, side_gray_weight=0.0),
        tracing=replace(settings.tracing, num_rounds=1),
    )


def recorded(settings: PipelineOptions) -> dict[str, Any]:
    """The settings of a run for its record, with those by which some of its steps differ."""
    steps = {}
    if settings.tracing.method == "chains" and settings.tracing.num_rounds > 1:
        steps["later_rounds"] = of_later_rounds(settings)
    if settings.refine_poses:
        steps["pose_edges"] = of_pose_edges(settings)
    return asdict(settings) | {name: differences(settings, of) for name, of in steps.items()}


def differences(settings: PipelineOptions, others: PipelineOptions) -> dict[str, dict[str, Any]]:
    """By group, the values of `others` that are not those of `settings`."""
    before, after = asdict(settings), asdict(others)
    return {
        group: {name: value for name, value in values.items() if value != before[group][name]}
        for group, values in after.items()
        if values != before[group]
    }
