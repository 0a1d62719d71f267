"""Options and constants of the paper's tracing (--method paper)."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.declared_options import Options, constant, option


@dataclass(frozen=True, kw_only=True)
class MatchingOptions(Options):
    """Polyline similarity and PECs (paper: Edge Matching and PEC generation)."""

    # Maximum distance of an SfM point that counts as close to a polyline (the paper's d_s), in
    # pixels of the given images.
    max_point_distance_px: float = constant(10.0, given_px=True)
    # Minimum similarity of polylines linked in the similarity graph (the paper
    # has none, and --method paper sets 0).
    min_similarity: float = 0.3
    # Resolution of the Louvain communities; larger values give smaller PECs (the standard
    # modularity).
    resolution: float = 1.0


@dataclass(frozen=True, kw_only=True)
class CorrespondenceOptions(Options):
    """Potential edge-point correspondences (paper: PEPC generation)."""

    # Source of PEPCs: SfM points, PECs or both (the paper uses both).
    strategy: str = "both"
    # Radius around an SfM point in which starting points are searched (the paper's r_I), in
    # pixels of the sharpest of the given images.
    inner_radius_px: float = constant(10.0, given_px=True)
    # Radius around an SfM point in which correspondences are searched (the paper's r_O), in
    # pixels of the sharpest of the given images.
    outer_radius_px: float = constant(30.0, given_px=True)
    # Spacing of starting points along the polylines of a PEC, in pixels of the upsampled images
    # (set by trial).
    sample_spacing_px: float = 20.0


@dataclass(frozen=True, kw_only=True)
class FollowingOptions(Options):
    """PEPC validation and 3D edge generation (paper: PEPC validation)."""

    # Step along the leading polyline between edge points, in pixels of the upsampled images (set by
    # trial).
    step_px: float = 10.0
    max_error_px: float = option(
        2.0,
        "Maximum reprojection error of a valid triangulation (epsilon), in pixels of the given "
        "images",
        within=(0.05, 50),
        given_px=True,
    )
    # Maximum step in another view, relative to the expected one (1 / cos 75 degrees: an edge
    # foreshortened to that angle in one view).
    max_step_ratio: float = 4.0
    # Minimum angle between an edge and an epipolar line, in degrees (that of depths along chains).
    min_epipolar_angle_deg: float = 5.0
    # Triangulation angle above which views get full weight in view selection, in degrees (set by
    # trial).
    full_triangulation_angle_deg: float = 10.0
    # Maximum 3D length of a step, relative to a step parallel to the image plane (1 / sin 6
    # degrees: an edge at that angle to the viewing ray).
    max_stretch: float = 10.0
    # Number of directions in which a starting point must be followable (1 or 2) (set by trial).
    min_steps: int = 2
    # Maximum number of selections tried per starting point, best supported first, and of view
    # triples tried per selection, best conditioned first (set by trial).
    max_selections: int = 3


@dataclass(frozen=True, kw_only=True)
class VisibilityOptions(Options):
    """Visibility refinement and outlier filter (paper: Visibility refinement)."""

    # Radius in which the polyline of a further view is searched (the paper's d_v), in pixels
    # of the given images.
    max_distance_px: float = constant(4.0, given_px=True)
    # Maximum reprojection error including the new observation, in pixels of the given images (that
    # of a valid triangulation).
    max_error_px: float = constant(2.0, given_px=True)
    # Maximum angle between the projected edge and the polyline, in degrees (set by trial).
    max_tangent_angle_deg: float = 20.0
    # Maximum root mean square distance between a projected 3D edge and the chains that observe it
    # in one view, relative to max_error_px (chains scatter by 0.2 to 0.5 px around true edges, by
    # 0.6 to 1 px around wrong ones).
    max_rms_ratio: float = 0.25
    min_views: int = option(
        4,
        "Minimum number of views of a 3D edge, even if the median over all edges is lower",
        within=(2, 100),
    )


@dataclass(frozen=True, kw_only=True)
class SamplingOptions(Options):
    """Dense sampling of 3D edges to edge points."""

    # Minimum distance of traced edge points between which further ones are inserted, in pixels of
    # the sharpest upsampled view (two steps of following; more points make the mesh of the paper's
    # votes worse).
    spacing_px: float = 20.0
