"""Options as given -> settings as used: tolerances in pixels of the images that are worked on."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

from colmap_edges.declared_options import Options, derived
from colmap_edges.options.whole import PipelineOptions


def resolved(options: PipelineOptions, scale: float) -> PipelineOptions:
    """The settings of a run whose images are upsampled, in the stages' pixels.

    Poses and distortion are off by pixels of the images as they are given, so what users say of
    them is in these pixels. Stages work on upsampled images and measure in theirs. This is the
    only place that converts; it is called once a run. The settings are not to be converted again.

    Args:
        options: as given, every length of them as it was declared.
        scale: how many times the images are upsampled, 1 at least.

    Returns:
        The same, with what was declared in pixels of the given images in those of the upsampled.
    """
    groups: dict[str, Any] = {}
    for entry in fields(options):
        group = getattr(options, entry.name)
        if isinstance(group, Options):
            declared = fields(group)  # type: ignore[arg-type]
            given = [inner.name for inner in declared if inner.metadata["given_px"]]
            groups[entry.name] = derived(group, **{n: scale * getattr(group, n) for n in given})
    return replace(options, **groups)
