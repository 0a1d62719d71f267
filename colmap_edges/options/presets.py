"""Presets: the option values set by --quality and --method."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from colmap_edges.declared_options import shown
from colmap_edges.errors import OptionError
from colmap_edges.options.whole import PipelineOptions

METHODS = ("chains", "paper")
# Values set by --quality; medium keeps the defaults.
QUALITIES: dict[str, dict[str, Any]] = {
    "low": {
        "detection": {"min_blur_px": 0.1},  # downsamples soft images but never upsamples
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


# Values set by --method paper: those of Bignoli et al., the mesher votes of their
# published program, and no step beyond theirs.
PAPER: dict[str, Any] = {
    "detection": {"min_blur_px": 0.0, "faint_noises": 0.0},
    "edge_graph": {
        "filter_regular_length": True,
        "min_corner_angle_deg": 180.0,
        "max_gap_points": 0.0,
    },
    "tracing": {"method": "paper"},
    "matching": {"min_similarity": 0.0},
    "meshing": {
        "method": "manifold",
        "vote_crossed": 1.0,
        "vote_near": 0.0,
        "vote_far": 0.0,
        "vote_behind": 0.0,
        "vote_threshold": 2.1,
        "min_segment_factor": 0.0,
    },
    "refine_poses": False,
    "use_faces": False,
    "use_patches": False,
    "refine_mesh": False,
}
PRESETS = {**QUALITIES, "paper": PAPER}


def preset(name: str) -> PipelineOptions:
    """The options of a preset.

    Args:
        name: low, medium, high or paper. medium equals `PipelineOptions()`; paper traces and
            meshes as Bignoli et al. do.

    Raises:
        OptionError: for an unknown name.
    """
    if not isinstance(name, str) or name not in PRESETS:
        raise OptionError(f"there is no preset {shown(name)}; choose one of: {', '.join(PRESETS)}")
    defaults = PipelineOptions()
    changed = {
        key: replace(getattr(defaults, key), **value) if isinstance(value, dict) else value
        for key, value in PRESETS[name].items()
    }
    return replace(defaults, **changed)


def chosen_preset(method: str | None, quality: str | None) -> PipelineOptions:
    """The preset chosen by the flags --method and --quality.

    Raises:
        OptionError: if --quality is combined with --method paper, which has only one quality.
    """
    if method != "paper":
        return preset(quality or "medium")
    if quality:
        raise OptionError("quality has no effect with --method paper; leave it out")
    return preset("paper")
