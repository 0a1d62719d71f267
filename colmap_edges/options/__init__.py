"""Options and constants of every stage, with their defaults, meanings and units.

Options are for users: they have a flag and a range, and every stage runs at both ends of it, which
tests/cli/test_option_extremes.py verifies. Constants are values of the method, plain fields that
only Python sets; the comment above each says where its value comes from.
"""

from colmap_edges.options.detecting import DetectionOptions, EdgeGraphOptions
from colmap_edges.options.meshing import BundleAdjustmentOptions, DenseOptions, MeshingOptions
from colmap_edges.options.paper import (
    CorrespondenceOptions,
    FollowingOptions,
    MatchingOptions,
    SamplingOptions,
    VisibilityOptions,
)
from colmap_edges.options.presets import METHODS, PRESETS, QUALITIES, chosen_preset, preset
from colmap_edges.options.resolving import of_later_rounds, recorded, resolved
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
    "DenseOptions",
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
    "preset",
    "recorded",
    "resolved",
]
