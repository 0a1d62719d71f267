"""Options and constants of the paper's way of tracing (--method paper)."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.declared_options import Options, constant, option

TRIED = "set by trial"


@dataclass(frozen=True, kw_only=True)
class MatchingOptions(Options):
    """Polyline similarity and PECs (paper: Edge Matching and PEC generation)."""

    max_point_distance_px: float = option(
        10.0,
        "Largest distance of an SfM point that is close to a polyline (d_s), in pixels of the "
        "given images",
        within=(0.1, 100),
        given_px=True,
    )
    min_similarity: float = option(
        0.3, "Smallest similarity that links two polylines in the similarity graph", within=(0, 1)
    )
    resolution: float = constant(
        1.0,
        "Resolution of the Louvain communities; larger makes smaller PECs",
        "the standard modularity",
        within=(0.01, 100),
    )


@dataclass(frozen=True, kw_only=True)
class CorrespondenceOptions(Options):
    """Potential edge-point correspondences (paper: PEPC generation)."""

    strategy: str = constant(
        "both",
        "Where PEPCs come from",
        "the paper uses both",
        choices=("both", "sfm_points", "pecs"),
    )
    inner_radius_px: float = option(
        10.0,
        "Radius around an SfM point in which starts are sought (r_I), in pixels of the sharpest "
        "of the given images",
        within=(0.1, 100),
        given_px=True,
    )
    outer_radius_px: float = option(
        30.0,
        "Radius in which correspondences are sought (r_O), in pixels of the sharpest of the given "
        "images",
        within=(0.1, 200),
        given_px=True,
    )
    sample_spacing_px: float = constant(
        20.0,
        "Distance between starts along the polylines of a PEC, in pixels of the upsampled images",
        TRIED,
        within=(1, 1000),
    )


@dataclass(frozen=True, kw_only=True)
class FollowingOptions(Options):
    """PEPC validation and 3D edge generation (paper: PEPC validation)."""

    step_px: float = constant(
        10.0,
        "Walk along the leading polyline between edge points, in pixels of the upsampled images",
        TRIED,
        within=(1, 100),
    )
    max_error_px: float = option(
        2.0,
        "Largest reprojection error of a valid triangulation (epsilon), in pixels of the given "
        "images",
        within=(0.05, 50),
        given_px=True,
    )
    max_step_ratio: float = constant(
        4.0,
        "Longest walk in another view for one step, in expected steps",
        "1 / cos 75 degrees: edges that one view sees as far aside",
        within=(1, 100),
    )
    min_epipolar_angle_deg: float = constant(
        5.0,
        "Smallest angle between an edge and an epipolar line, in degrees",
        "that of depths along chains",
        within=(0, 90),
    )
    full_triangulation_angle_deg: float = constant(
        10.0,
        "Triangulation angle from which a view counts fully when views are chosen, in degrees",
        TRIED,
        within=(0.1, 90),
    )
    max_stretch: float = constant(
        10.0,
        "Longest 3D step, relative to the same step seen frontally",
        "1 / sin 6 degrees: edges so near to the line of sight",
        within=(1, 1000),
    )
    min_steps: int = constant(
        2, "Directions that must be followable from a start (1 or 2)", TRIED, within=(1, 2)
    )
    max_selections: int = constant(
        3,
        "Selections tried until one is valid, those that most views agree with first, and triples "
        "of views tried for each, best conditioned first",
        TRIED,
        within=(1, 100),
    )


@dataclass(frozen=True, kw_only=True)
class VisibilityOptions(Options):
    """Visibility refinement and outlier filter (paper: Visibility refinement)."""

    max_distance_px: float = option(
        4.0,
        "Distance within which a further view's polyline is sought (d_v), in pixels of the given "
        "images",
        within=(0.1, 100),
        given_px=True,
    )
    max_error_px: float = constant(
        2.0,
        "Largest reprojection error with the new observation, in pixels of the given images",
        "that of a valid triangulation",
        within=(0.05, 50),
        given_px=True,
    )
    max_tangent_angle_deg: float = constant(
        20.0,
        "Largest angle between the projected edge and the polyline, in degrees",
        TRIED,
        within=(0, 90),
    )
    max_rms_ratio: float = constant(
        0.25,
        "Largest root mean square distance, across them, of a 3D edge from the chains of a view "
        "that observes it, in parts of max_error_px",
        "chains scatter by 0.2 to 0.5 px around true edges, by 0.6 to 1 px around wrong ones",
        within=(0.01, 1),
    )
    min_views: int = option(
        4, "Smallest number of views of a 3D edge, whatever the median", within=(2, 100)
    )


@dataclass(frozen=True, kw_only=True)
class SamplingOptions(Options):
    """Fine sampling of 3D edges to edge points."""

    spacing_px: float = constant(
        20.0,
        "Distance from which edge points are put between those followed, in pixels of the sharpest "
        "view as upsampled",
        "two steps of following; more points make the mesh of the paper's votes worse",
        within=(0.5, 100),
    )
