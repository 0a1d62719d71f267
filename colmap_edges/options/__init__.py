"""Options and constants of every stage, with their defaults, meanings, units and ranges.

Options are for users and have flags. Constants are values of the method: they have no flag, but
tests and `scripts/halve_and_double.py` can set them. Ranges cover all useful values; every stage
runs at both ends of each range, which tests/cli/test_option_extremes.py verifies.
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
