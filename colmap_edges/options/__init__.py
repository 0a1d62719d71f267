"""Every option and constant of every stage, with its default, meaning, unit and range.

An option is what a user can want to turn. A constant is a value of the method itself: it has no
flag, but tests and `scripts/halve_and_double.py` can set it. Ranges are of what can be wanted in
the unit: pixels within which things in an image are near each other, angles up to a quarter or half
a turn, numbers of views as photographers take them. Every stage runs at both ends of each;
tests/cli/test_option_extremes.py holds us to it.
"""

from colmap_edges.options.detecting import DetectionOptions, EdgeGraphOptions
from colmap_edges.options.meshing import BundleAdjustmentOptions, MeshingOptions
from colmap_edges.options.paper import (
    CorrespondenceOptions,
    FollowingOptions,
    MatchingOptions,
    SamplingOptions,
    VisibilityOptions,
)
from colmap_edges.options.presets import METHODS, PRESETS, QUALITIES, chosen_preset, preset
from colmap_edges.options.resolving import of_later_rounds, of_pose_edges, recorded, resolved
from colmap_edges.options.tracing import (
    ChainDepthOptions,
    CurvesOptions,
    LinkingOptions,
    RefinementOptions,
    TracingOptions,
    ViewSelectionOptions,
)
from colmap_edges.options.whole import PipelineOptions

__all__ = [
    "METHODS",
    "PRESETS",
    "QUALITIES",
    "BundleAdjustmentOptions",
    "ChainDepthOptions",
    "CorrespondenceOptions",
    "CurvesOptions",
    "DetectionOptions",
    "EdgeGraphOptions",
    "FollowingOptions",
    "LinkingOptions",
    "MatchingOptions",
    "MeshingOptions",
    "PipelineOptions",
    "RefinementOptions",
    "SamplingOptions",
    "TracingOptions",
    "ViewSelectionOptions",
    "VisibilityOptions",
    "chosen_preset",
    "of_later_rounds",
    "of_pose_edges",
    "preset",
    "recorded",
    "resolved",
]
