"""Options and constants of edge detection and of 2D edge graphs."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.declared_options import Options, option


@dataclass(frozen=True, kw_only=True)
class DetectionOptions(Options):
    """Detection of edge chains in images (EdgeDrawing)."""

    min_chain_points: int = option(
        12,
        "Minimum length of a detected edge chain, in pixels of the upsampled images",
        within=(2, 1000),
        basic=True,
    )
    gamma: float = option(
        2.2,
        "Gamma to linearise intensities; 1 for linear images",
        within=(0.25, 4),
        basic=True,
    )
    # Standard deviation of the Gaussian blur before sub-pixel localisation, in pixels of the
    # upsampled images (the blur of EdgeDrawing; 0.7 was tried (docs/experiments.md, Sharp images
    # are enlarged)).
    sigma_px: float = 1.0
    # Slope of the faint straight edges that EdgeDrawing lacks, in standard deviations of the
    # image's slopes; 0: none are looked for (2 to 5 find nearly the same in rooms
    # (docs/experiments.md, Faint straight edges)).
    faint_noises: float = 4.0
    min_blur_px: float = option(
        0.8,
        "Upsample images whose edge blur is below this standard deviation, in pixels of the given "
        "images (at most 1.5 times, up to 3200 px), and downsample images with more than 2.8 px; "
        "0 keeps the size",
        within=(0, 5),
        basic=True,
    )


@dataclass(frozen=True, kw_only=True)
class EdgeGraphOptions(Options):
    """Joining of chains to 2D edge graphs (paper: 2D Edge-Graphs)."""

    # Maximum distance between a chain and its smoothed polyline, in pixels of the upsampled images
    # (about three times Refinement.noise_px).
    max_smoothing_distance_px: float = 1.0
    # Maximum turn within a regular length (alpha_R), in degrees (the paper).
    max_regular_angle_deg: float = 20.0
    # Share of the longest polylines, whose shortest regular length becomes the threshold (the
    # paper).
    top_regular_length_ratio: float = 0.1
    filter_regular_length: bool = option(
        False,
        "Drop connected edges in an image if none of them has a long enough stretch without turns",
    )
    max_gap_points: float = option(
        4.0,
        "Maximum gap between chains that are joined, in pixels of the upsampled images",
        within=(0, 50),
    )
    # Maximum turn between two joined chains, in degrees (below the smallest corner, 45 degrees).
    max_join_angle_deg: float = 30.0
    # Minimum turn at which a chain is cut as a corner, in degrees; 180 disables cutting.
    min_corner_angle_deg: float = 45.0
