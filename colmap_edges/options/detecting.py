"""Options and constants of detection: images -> chains -> 2D edge graphs."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.declared_options import Options, constant, option


@dataclass(frozen=True, kw_only=True)
class DetectionOptions(Options):
    """Image -> pixel chains (EdgeDrawing)."""

    min_chain_points: int = option(
        12,
        "Shortest chain kept, in chain points (one for each pixel of the images as upsampled)",
        within=(2, 1000),
        basic=True,
    )
    gamma: float = option(
        2.2,
        "Gamma used to linearise intensities; 1 for linear images",
        within=(0.25, 4),
        basic=True,
    )
    sigma_px: float = constant(
        1.0,
        "Gaussian blur of the sub-pixel step, in pixels of the upsampled images",
        "as EdgeDrawing blurs; 0.7 was tried (docs/experiments.md, Sharp images are enlarged)",
        within=(0.1, 10),
    )
    min_blur_px: float = option(
        0.8,
        "Upsample images whose edges are blurred less than this standard deviation, in pixels of "
        "the given images (at most 1.5 times, up to 3200 px), and reduce those blurred more "
        "than 2.8 px; 0 works on images as they are",
        within=(0, 5),
        basic=True,
    )


@dataclass(frozen=True, kw_only=True)
class EdgeGraphOptions(Options):
    """Chains -> 2D edge graph (paper: 2D Edge-Graphs)."""

    max_smoothing_distance_px: float = constant(
        1.0,
        "Largest distance between a chain and its smoothed polyline, in pixels of the upsampled "
        "images",
        "about three times Refinement.noise_px",
        within=(0.05, 20),
    )
    max_regular_angle_deg: float = constant(
        20.0,
        "Largest turn within a regular length (alpha_R), in degrees",
        "the paper",
        within=(1, 180),
    )
    top_regular_length_ratio: float = constant(
        0.1,
        "Share of polylines, longest first, that sets the regular-length threshold",
        "the paper",
        within=(0, 1),
    )
    filter_regular_length: bool = option(
        False, "Drop components without a polyline of the threshold's regular length", basic=True
    )
    max_gap_points: float = option(
        4.0,
        "Largest gap across which chains are joined, in distances between chain points (one for "
        "each pixel of the images as upsampled)",
        within=(0, 50),
    )
    max_join_angle_deg: float = constant(
        30.0,
        "Largest turn where two chains are joined, in degrees",
        "below the smallest corner, 45 degrees",
        within=(0, 90),
    )
    min_corner_angle_deg: float = option(
        45.0,
        "Smallest turn of a corner, where chains are cut, in degrees; 180: nowhere",
        within=(1, 180),
    )
