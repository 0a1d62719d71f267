"""Options and constants of tracing by depths along chains: 2D edge graphs -> 3D edges."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.declared_options import Options, constant, option

TRIED = "set by trial"


@dataclass(frozen=True, kw_only=True)
class ViewSelectionOptions(Options):
    """Which views are compared with which."""

    num_neighbors: int = option(
        6, "Number of views each view is compared with", within=(2, 100), basic=True
    )
    num_later_neighbors: int = constant(
        10,
        "Number of views each view is compared with in later rounds, in which few chains are left; "
        "num_neighbors at least",
        "tried on five scenes (docs/experiments.md, Thin bars)",
        within=(2, 100),
    )
    num_observing_views: int = option(
        40,
        "Largest number of views in which observations of an edge are looked for",
        within=(2, 1000),
    )
    good_angle_deg: float = constant(
        5.0,
        "Triangulation angle from which views are compared without loss, in degrees",
        TRIED,
        within=(0.1, 90),
    )
    max_angle_deg: float = option(
        60.0,
        "Largest triangulation angle between compared views, in degrees; where too few are within "
        "it, wider ones are compared, too",
        within=(1, 180),
        basic=True,
    )
    max_observing_angle_deg: float = constant(
        120.0,
        "Largest triangulation angle between a view and those in which observations of its edges "
        "are looked for, in degrees",
        "by trial (docs/experiments.md, Views from further aside); edges come twice with less",
        within=(1, 180),
    )


@dataclass(frozen=True, kw_only=True)
class ChainDepthOptions(Options):
    """Depths along chains from the agreement of many views."""

    sample_step_points: int = option(
        24,
        "Largest step from one sample on a chain to the next, in chain points (one for each pixel "
        "of the images as upsampled)",
        within=(1, 1000),
        basic=True,
    )
    max_disagreement_px: float = option(
        1.2,
        "Largest distance between agreeing crossings along the epipolar line, in pixels of the "
        "given images",
        within=(0.05, 20),
        basic=True,
        given_px=True,
    )
    min_epipolar_angle_deg: float = constant(
        5.0,
        "Smallest angle between an edge and the epipolar line, in degrees",
        "noise along the line is that across the chain over the angle's sine: 11 times here",
        within=(0, 90),
    )
    visibility_rate: float = constant(
        0.5,
        "Chance that an edge of one view is not hidden in another",
        "assumed",
        within=(0.01, 1),
    )
    detection_rate: float = constant(
        0.8,
        "Chance that an edge that is not hidden is detected",
        "assumed",
        within=(0.01, 0.95),
    )
    min_log_likelihood_ratio: float = constant(
        3.0,
        "Log likelihood ratio that the agreement of views must exceed to count",
        "odds of 20 to 1",
        within=(-10, 50),
    )
    later_log_likelihood_ratio_drop: float = constant(
        2.0,
        "By how much less agreement of views is asked for in later rounds, log likelihood",
        "odds of 3 to 1 in place of 20 to 1, where few chains are left",
        within=(0, 50),
    )
    break_penalty: float = constant(
        4.0,
        "Log likelihood lost where a chain changes from one depth to another",
        "odds of 55 to 1 against a break",
        within=(0, 100),
    )
    max_clusters: int = constant(
        6, "Depths of a sample between which the chain decides", TRIED, within=(1, 50)
    )


@dataclass(frozen=True, kw_only=True)
class RefinementOptions(Options):
    """Least squares on the depths of curves."""

    search_radius_px: float = constant(
        4.0,
        "Radius in which observations are first looked for, in pixels of the given images",
        "three times max_disagreement_px, rounded up",
        within=(0.1, 50),
        given_px=True,
    )
    max_residual_px: float = option(
        1.35,
        "Largest distance of an edge point to the chain that observes it, in pixels of the given "
        "images",
        within=(0.05, 20),
        given_px=True,
    )
    max_tangent_angle_deg: float = constant(
        12.0, "Largest angle between edge and observing chain, in degrees", TRIED, within=(1, 90)
    )
    robust_scale_px: float = constant(
        0.7,
        "Residual from which an observation loses influence, in pixels of the upsampled images",
        "about twice noise_px",
        within=(0.05, 20),
    )
    max_bend_px: float = constant(
        0.4,
        "Second difference of disparity from which bending costs less, in pixels of the upsampled "
        "images",
        TRIED,
        within=(0.01, 20),
    )
    side_gray_weight: float = constant(
        2.0,
        "Weight of the photometric term along edges, against residuals across them; 0 disables it",
        TRIED,
        within=(0, 100),
    )
    noise_px: float = constant(
        0.3,
        "Standard deviation of a chain across itself, in pixels of the upsampled images",
        "assumed: errors of detection and of poses together",
        within=(0.01, 10),
    )


@dataclass(frozen=True, kw_only=True)
class TracingOptions(Options):
    """From edge graphs to 3D edges; all but the method concerns the depths along chains."""

    method: str = constant(
        "chains",
        "How edges are traced: by depths along chains, or by the paper's correspondences",
        "set by --method",
        choices=("chains", "paper"),
    )
    num_rounds: int = option(
        2,
        "Number of matching rounds; later ones use only chains without a 3D edge, and ask for less "
        "agreement",
        within=(1, 10),
        basic=True,
    )
    max_inconsistency_px: float = constant(
        3.0,
        "Largest difference of two views' depths of one point, in pixels of disparity of the "
        "upsampled images",
        TRIED,
        within=(0.05, 50),
    )
    min_agreeing_views: int = option(
        2,
        "Other views that must find the same depth for a sample to be sure",
        within=(1, 100),
        basic=True,
    )
    min_confirmed_ratio: float = constant(
        0.7, "Share of sure samples that a run must have", TRIED, within=(0, 1)
    )
    min_run_samples: int = constant(
        2, "Samples that a run must have", "a run has two ends", within=(2, 100)
    )
    max_disparity_gradient: float = constant(
        1.0,
        "Largest change of disparity along a chain, in pixels a pixel",
        "the disparity gradient limit of human stereo (Burt and Julesz 1980)",
        within=(0.01, 100),
    )
    max_bridge_px: int = constant(
        200,
        "Longest stretch without depth inside a run, in pixels of the upsampled images",
        TRIED,
        within=(0, 10_000),
    )
    extension_px: int = constant(
        24,
        "How far a run is followed beyond its ends, in pixels of the upsampled images",
        "the default step between samples",
        within=(0, 1000),
    )
    curve_step_points: int = option(
        4,
        "Step from one point of a 3D edge to the next along its chain, in chain points (one for "
        "each pixel of the images as upsampled)",
        within=(1, 100),
        basic=True,
    )
    min_curve_points: int = option(3, "Edge points that a 3D edge must have", within=(2, 1000))
    min_observations: int = option(
        3, "Observations that an edge point must have (paper: k_v)", within=(2, 100), basic=True
    )
    occlusion_radius_px: float = constant(
        10.0,
        "How far around a point nearer ones hide it, in pixels of the upsampled images; 0 disables",
        TRIED,
        within=(0, 100),
    )
    max_sigma_ratio: float = constant(
        5.0,
        "Largest standard deviation of an edge point's depth, in medians of all",
        TRIED,
        within=(1, 1000),
    )
    max_residual_ratio: float = constant(
        1.7,
        "Largest scatter of observations around a 3D edge, in medians of all observations'",
        "set by trial: view-dependent contours scatter more",
        within=(1, 100),
    )
    min_residual_px: float = constant(
        0.22,
        "Scatter that any 3D edge may have, however little all have, in pixels of the given images",
        "a little less than sqrt(2 / pi) Refinement.noise_px, the mean distance of observations",
        within=(0.01, 50),
        given_px=True,
    )
    max_false_edges: float = option(
        1.0,
        "Expected number of accidental 3D edges in the whole scene (a-contrario test)",
        within=(1e-6, 1e6),
    )


@dataclass(frozen=True, kw_only=True)
class LinkingOptions(Options):
    """Pieces of 3D edges -> whole edges with nodes."""

    max_gap_spacings: float = option(
        8.0,
        "Largest gap across which 3D edges are joined where views observe an edge in it, in "
        "distances between edge points",
        within=(0, 50),
    )
    max_join_angle_deg: float = constant(
        30.0,
        "Largest turn where two 3D edges are joined, in degrees",
        "that of chains in images",
        within=(0, 90),
    )
    max_corner_spacings: float = option(
        8.0,
        "Longest way on which the end of a 3D edge is extended to a corner where it meets others, "
        "in distances between edge points; 0 extends none",
        within=(0, 50),
    )
    node_radius_spacings: float = constant(
        2.5,
        "Distance within which ends of 3D edges meet, in distances between edge points",
        TRIED,
        within=(0, 50),
    )


@dataclass(frozen=True, kw_only=True)
class CurvesOptions(Options):
    """What edges are: lines, arcs, circles, ellipses, splines."""

    regularize: bool = option(
        False,
        "Make lines and planes of arcs parallel, perpendicular and coplanar, and circles "
        "concentric, where they are so within their standard deviations",
    )
