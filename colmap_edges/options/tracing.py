"""Options and constants of tracing by depths along chains (2D edge graphs to 3D edges)."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.declared_options import Options, constant, option


@dataclass(frozen=True, kw_only=True)
class ViewSelectionOptions(Options):
    """Selection of the views in which matches and observations are searched."""

    num_neighbors: int = option(
        6, "Number of views that each view is matched with", within=(2, 100), basic=True
    )
    # Number of views that each view is matched with in later rounds; at least num_neighbors (tried
    # on five scenes (docs/experiments.md, Thin bars)).
    num_later_neighbors: int = 10
    num_observing_views: int = option(
        40,
        "Maximum number of views in which observations of a 3D edge are searched",
        within=(2, 1000),
    )
    # Triangulation angle above which views get full weight in view selection, in degrees (set by
    # trial).
    good_angle_deg: float = 5.0
    max_angle_deg: float = option(
        60.0,
        "Maximum triangulation angle between matched views, in degrees; exceeded only if too few "
        "views are within it",
        within=(1, 180),
        basic=True,
    )
    # Maximum triangulation angle between a reference view and the views in which observations of
    # its edges are searched, in degrees (set by trial (docs/experiments.md, Views from further
    # aside); smaller values duplicate edges).
    max_observing_angle_deg: float = 120.0


@dataclass(frozen=True, kw_only=True)
class ChainDepthOptions(Options):
    """Estimation of depths along chains from the agreement of several views."""

    sample_step_points: int = option(
        24,
        "Maximum spacing of the samples on a chain at which depths are estimated, in pixels of the "
        "upsampled images",
        within=(1, 1000),
    )
    max_disagreement_px: float = option(
        1.2,
        "Maximum disagreement of matches that support one depth, measured across the edge in "
        "pixels of the given images",
        within=(0.05, 20),
        basic=True,
        given_px=True,
    )
    # Minimum angle between an edge and the epipolar line, in degrees (noise along the line is that
    # across the chain over the angle's sine: 11 times here).
    min_epipolar_angle_deg: float = 5.0
    # Probability that an edge seen in one view is not occluded in another (assumed).
    visibility_rate: float = 0.5
    # Probability that an unoccluded edge is detected (assumed).
    detection_rate: float = 0.8
    # Minimum log likelihood ratio of a depth against accidental agreement of views (odds of 20 to
    # 1).
    min_log_likelihood_ratio: float = 3.0
    # Reduction of min_log_likelihood_ratio in later rounds (odds of 3 to 1 instead of 20 to 1,
    # since few chains remain).
    later_log_likelihood_ratio_drop: float = 2.0
    # Penalty for a depth discontinuity along a chain, log likelihood (odds of 55 to 1 against a
    # break).
    break_penalty: float = 4.0
    # Maximum number of depth candidates per sample (set by trial).
    max_clusters: int = 6


@dataclass(frozen=True, kw_only=True)
class RefinementOptions(Options):
    """Least-squares refinement of the depths of curves."""

    # Initial search radius for observations, in pixels of the given images (three times
    # max_disagreement_px, rounded up).
    search_radius_px: float = constant(4.0, given_px=True)
    max_residual_px: float = option(
        1.35,
        "Maximum residual of an observation: the distance of a projected edge point to the chain, "
        "in pixels of the given images",
        within=(0.05, 20),
        given_px=True,
    )
    # Maximum angle between a projected edge and the chain that observes it, in degrees (set by
    # trial).
    max_tangent_angle_deg: float = 12.0
    # Scale of the Geman-McClure loss of residuals, in pixels of the upsampled images (about twice
    # noise_px).
    robust_scale_px: float = 0.7
    # Scale of the Cauchy loss of the second difference of disparity along a curve, in pixels of the
    # upsampled images (set by trial).
    max_bend_px: float = 0.4
    # Weight of the photometric term along edges relative to residuals across them; 0 disables it
    # (set by trial).
    side_gray_weight: float = 2.0
    # Standard deviation of a chain point across the chain, in pixels of the upsampled images
    # (assumed for errors of detection and poses together).
    noise_px: float = 0.3


@dataclass(frozen=True, kw_only=True)
class TracingOptions(Options):
    """Tracing of 3D edges; all options except the method apply to depths along chains."""

    # Tracing method: depths along chains, or the paper's correspondences (set by --method).
    method: str = constant("chains", choices=("chains", "paper"))
    num_rounds: int = option(
        2,
        "Number of matching rounds; later ones match only chains without a 3D edge and require "
        "less agreement of views",
        within=(1, 10),
        basic=True,
    )
    # Maximum difference between the depths that two views find for one point, in pixels of
    # disparity in the upsampled images (set by trial).
    max_inconsistency_px: float = 3.0
    min_agreeing_views: int = option(
        2,
        "Minimum number of other views that must find the same depth for a sample to be reliable",
        within=(1, 100),
        basic=True,
    )
    # Minimum share of reliable samples in a run (set by trial).
    min_confirmed_ratio: float = 0.7
    # Minimum number of samples in a run (a run has two ends).
    min_run_samples: int = 2
    # Maximum change of disparity along a chain, in pixels per pixel (the disparity gradient limit
    # of human stereo (Burt and Julesz 1980)).
    max_disparity_gradient: float = 1.0
    # Maximum length of a stretch without depth inside a run, in pixels of the upsampled images (set
    # by trial).
    max_bridge_px: int = 200
    # Distance by which a run is extended beyond its ends, in pixels of the upsampled images (the
    # default step between samples).
    extension_px: int = 24
    curve_step_points: int = option(
        4,
        "Spacing of the points of a 3D edge along its chain, in pixels of the upsampled images",
        within=(1, 100),
    )
    # Minimum number of edge points in a 3D edge (the fewest that show whether an edge is straight).
    min_curve_points: int = 3
    min_observations: int = option(
        3,
        "Minimum number of views that must observe an edge point (paper: k_v)",
        within=(2, 100),
        basic=True,
    )
    # Radius in which nearer points are counted as occluders of a point, in pixels of the upsampled
    # images; 0 disables the test (set by trial).
    occlusion_radius_px: float = 10.0
    # Maximum standard deviation of an edge point's depth, relative to the median over all edge
    # points (set by trial).
    max_sigma_ratio: float = 5.0
    # Maximum mean residual of a 3D edge, relative to the median over all observations; larger ones
    # mark view-dependent contours (set by trial).
    max_residual_ratio: float = 1.7
    # Mean residual below which a 3D edge is never a view-dependent contour, in pixels of the
    # upsampled images (tried on 22 scenes: docs/experiments.md, Contours, again).
    min_residual_px: float = 0.35
    # Maximum displacement of a 3D edge next to overexposed pixels, in pixels of the given images
    # (0.3 to 0.5 pixels were measured).
    max_displacement_px: float = constant(0.7, given_px=True)
    max_false_edges: float = option(
        1.0,
        "Expected number of accidental 3D edges in the whole scene (a-contrario test); smaller "
        "values keep fewer edges",
        within=(1e-6, 1e6),
    )


@dataclass(frozen=True, kw_only=True)
class LinkingOptions(Options):
    """Joining of 3D edge pieces to whole edges with nodes."""

    # Maximum gap across which 3D edges are joined if views observe an edge in the gap, in distances
    # between edge points (set by trial).
    max_gap_spacings: float = 8.0
    # Maximum turn between two joined 3D edges, in degrees (that of chains in images).
    max_join_angle_deg: float = 30.0
    # Maximum length by which the end of a 3D edge is extended to a corner with other edges, in
    # distances between edge points; 0 extends none (that of gaps).
    max_corner_spacings: float = 8.0
    # Maximum distance of edge ends that share a node, in distances between edge points (set by
    # trial).
    node_radius_spacings: float = 2.5


@dataclass(frozen=True, kw_only=True)
class CurvesOptions(Options):
    """Description of edges by lines, arcs, circles, ellipses and splines."""

    regularize: bool = option(
        False,
        "Make curves exactly parallel, perpendicular, coplanar or concentric if they are so within "
        "their standard deviations",
    )
