"""Every option of every stage, with its default, meaning, unit and range."""

from __future__ import annotations

import operator
from dataclasses import dataclass, field, fields
from typing import Any

from colmap_edges.errors import OptionError


def option(
    default: Any,
    help: str,
    *,
    ge: float | None = None,
    gt: float | None = None,
    le: float | None = None,
    choices: tuple[str, ...] | None = None,
) -> Any:
    """Declare one option: its default, one line of help with the unit, and its range."""
    limits = {"ge": ge, "gt": gt, "le": le}
    return field(default=default, metadata={"help": help, "limits": limits, "choices": choices})


class Options:
    """Base of the option groups: checks every field against its declared range."""

    def __post_init__(self) -> None:
        """Raise `OptionError` for the first value outside its range."""
        for entry in fields(self):  # type: ignore[arg-type]
            name = f"{type(self).__name__.removesuffix('Options')}.{entry.name}"
            check_range(name, getattr(self, entry.name), entry.metadata)


def check_range(name: str, value: Any, metadata: Any) -> None:
    """Raise `OptionError` when `value` is outside the limits or choices in `metadata`."""
    choices = metadata.get("choices")
    if choices and value not in choices:
        raise OptionError(f"{name} is {value!r}; choose one of: {', '.join(choices)}")
    limits = metadata.get("limits", {})
    for key, sign, holds in (
        ("ge", ">=", operator.ge),
        ("gt", ">", operator.gt),
        ("le", "<=", operator.le),
    ):
        bound = limits.get(key)
        if bound is not None and not holds(value, bound):
            raise OptionError(f"{name} is {value}; it must be {sign} {bound}")


@dataclass(frozen=True, kw_only=True)
class DetectionOptions(Options):
    """Image -> pixel chains (EdgeDrawing)."""

    min_chain_length_px: int = option(12, "Shortest chain kept, in pixels", ge=2)
    sigma_px: float = option(
        1.0, "Gaussian blur before gradients of the sub-pixel step, in pixels", gt=0
    )


@dataclass(frozen=True, kw_only=True)
class EdgeGraphOptions(Options):
    """Chains -> 2D edge graph (paper: 2D Edge-Graphs)."""

    max_smoothing_distance_px: float = option(
        1.0, "Largest distance between a chain and its smoothed polyline, in pixels", gt=0
    )
    max_regular_angle_deg: float = option(
        20.0, "Largest turn within a regular length (alpha_R), in degrees", gt=0, le=180
    )
    top_regular_length_ratio: float = option(
        0.1, "Share of polylines, longest first, that sets the regular-length threshold", gt=0, le=1
    )
    filter_regular_length: bool = option(
        False, "Drop components without a polyline of the threshold's regular length"
    )
    max_gap_px: float = option(4.0, "Largest gap across which chains are joined, in pixels", ge=0)
    max_join_angle_deg: float = option(
        30.0, "Largest turn where two chains are joined, in degrees", ge=0, le=90
    )


@dataclass(frozen=True, kw_only=True)
class MeshingOptions(Options):
    """Points and rays -> triangle mesh; every option is free of the model's unit."""

    method: str = option(
        "graphcut",
        "How free cells are told from solid ones: minimum cut, votes of rays, or votes with a "
        "region that grows as a manifold (the paper's)",
        choices=("graphcut", "carve", "manifold"),
    )
    sigma_factor: float = option(
        1.0, "Softness of a point's depth (sigma), in lower quartiles of edge lengths", gt=0
    )
    quality_weight: float = option(
        0.2, "Weight of well-shaped triangles against one ray; more is smoother", ge=0
    )
    vote_crossed: float = option(
        1.0, "carve, manifold: vote of a ray for a cell it crosses (w1)", ge=0
    )
    vote_near: float = option(0.2, "carve, manifold: vote for the cells around (w2)", ge=0)
    vote_far: float = option(0.0, "carve, manifold: vote for the cells around those (w3)", ge=0)
    vote_threshold: float = option(1.0, "carve, manifold: votes that make a cell free", gt=0)
    min_segment_factor: float = option(
        0.25,
        "Split 3D edges until they are edges of the mesh, down to this length in medians of their "
        "segments; 0 splits none",
        ge=0,
    )
    long_facet_factor: float = option(
        25.0, "Drop triangles with a longer side, in 95th percentiles of sides; 0 keeps all", ge=0
    )
    min_component_faces: int = option(1, "Drop connected components of fewer triangles", ge=1)
    num_threads: int = option(0, "Threads; 0 takes all cores", ge=0)
