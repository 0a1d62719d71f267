"""Every option of every stage, with its default, meaning, unit and range.

Ranges are of what can be wanted in the option's unit: pixels within which things in an image are
near each other, angles up to a quarter or half a turn, numbers of views as photographers take them.
Every stage runs at both ends of each; `tests/test_option_extremes.py` holds us to it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from colmap_edges.declared_options import Options, option
from colmap_edges.errors import OptionError


@dataclass(frozen=True, kw_only=True)
class DetectionOptions(Options):
    """Image -> pixel chains (EdgeDrawing)."""

    min_chain_length_px: int = option(
        12, "Shortest chain kept, in pixels", within=(2, 1000), basic=True
    )
    gamma: float = option(
        2.2,
        "Exponent from the images' grays to light; 1 for cameras whose grays are light itself",
        within=(0.25, 4),
        basic=True,
    )
    sigma_px: float = option(
        1.0, "Gaussian blur of the sub-pixel step, in pixels", within=(0.1, 10)
    )
    min_blur_px: float = option(
        0.8,
        "Blur of edges (standard deviation, in pixels) below which images are enlarged, at most "
        "1.5 times and up to 3200 px; other options' pixels are then these, unless they say "
        "otherwise; 0: never",
        within=(0, 5),
        basic=True,
    )


@dataclass(frozen=True, kw_only=True)
class EdgeGraphOptions(Options):
    """Chains -> 2D edge graph (paper: 2D Edge-Graphs)."""

    max_smoothing_distance_px: float = option(
        1.0,
        "Largest distance between a chain and its smoothed polyline, in pixels",
        within=(0.05, 20),
    )
    max_regular_angle_deg: float = option(
        20.0, "Largest turn within a regular length (alpha_R), in degrees", within=(1, 180)
    )
    top_regular_length_ratio: float = option(
        0.1,
        "Share of polylines, longest first, that sets the regular-length threshold",
        within=(0, 1),
    )
    filter_regular_length: bool = option(
        False, "Drop components without a polyline of the threshold's regular length", basic=True
    )
    max_gap_px: float = option(
        4.0, "Largest gap across which chains are joined, in pixels", within=(0, 50)
    )
    max_join_angle_deg: float = option(
        30.0, "Largest turn where two chains are joined, in degrees", within=(0, 90)
    )
    min_corner_angle_deg: float = option(
        45.0,
        "Smallest turn of a corner, where chains are cut, in degrees; 180: nowhere",
        within=(1, 180),
    )


@dataclass(frozen=True, kw_only=True)
class ViewSelectionOptions(Options):
    """Which views are compared with which."""

    num_neighbors: int = option(
        6, "Number of views each view is compared with", within=(2, 100), basic=True
    )
    num_later_neighbors: int = option(
        10,
        "Number of views each view is compared with in later rounds, in which few chains are left; "
        "num_neighbors at least",
        within=(2, 100),
    )
    num_observing_views: int = option(
        40,
        "Largest number of views in which observations of an edge are looked for",
        within=(2, 1000),
    )
    good_angle_deg: float = option(
        5.0,
        "Triangulation angle from which views are compared without loss, in degrees",
        within=(0.1, 90),
    )
    max_angle_deg: float = option(
        60.0,
        "Largest triangulation angle between compared views, in degrees; where too few are within "
        "it, max_observing_angle_deg counts",
        within=(1, 180),
        basic=True,
    )
    max_observing_angle_deg: float = option(
        120.0,
        "Largest triangulation angle between a view and those in which observations of its edges "
        "are looked for, in degrees",
        within=(1, 180),
    )


@dataclass(frozen=True, kw_only=True)
class ChainDepthOptions(Options):
    """Depths along chains from the agreement of many views."""

    sample_step_px: int = option(
        24,
        "Largest distance between samples along a chain, in pixels",
        within=(1, 1000),
        basic=True,
    )
    max_disagreement_px: float = option(
        1.2,
        "Largest distance between agreeing crossings along the epipolar line, in pixels of the "
        "given images",
        within=(0.05, 20),
        basic=True,
    )
    min_epipolar_angle_deg: float = option(
        5.0, "Smallest angle between an edge and the epipolar line, in degrees", within=(0, 90)
    )
    visibility_rate: float = option(
        0.5, "Chance that an edge of one view is not hidden in another", within=(0.01, 1)
    )
    detection_rate: float = option(
        0.8, "Chance that an edge that is not hidden is detected", within=(0.01, 0.95)
    )
    min_log_likelihood_ratio: float = option(
        3.0,
        "Log likelihood ratio that the agreement of views must exceed to count",
        within=(-10, 50),
    )
    break_penalty: float = option(
        4.0, "Log likelihood lost where a chain changes from one depth to another", within=(0, 100)
    )
    max_clusters: int = option(
        6, "Depths of a sample between which the chain decides", within=(1, 50)
    )


@dataclass(frozen=True, kw_only=True)
class RefinementOptions(Options):
    """Least squares on the depths of curves."""

    search_radius_px: float = option(
        4.0,
        "Radius in which observations are first looked for, in pixels of the given images",
        within=(0.1, 50),
    )
    max_residual_px: float = option(
        1.35,
        "Largest distance of an edge point to the chain that observes it, in pixels of the given "
        "images",
        within=(0.05, 20),
    )
    max_tangent_angle_deg: float = option(
        12.0, "Largest angle between edge and observing chain, in degrees", within=(1, 90)
    )
    robust_scale_px: float = option(
        0.7, "Residual from which an observation loses influence, in pixels", within=(0.05, 20)
    )
    max_bend_px: float = option(
        0.4,
        "Second difference of disparity from which bending costs less, in pixels",
        within=(0.01, 20),
    )
    side_gray_weight: float = option(
        2.0,
        "Weight of the gray beside edges, which tells how far they are moved along themselves, "
        "against their places across; 0 leaves it aside",
        within=(0, 100),
    )
    noise_px: float = option(
        0.3, "Standard deviation of a chain across itself, in pixels", within=(0.01, 10)
    )


@dataclass(frozen=True, kw_only=True)
class TracingOptions(Options):
    """From edge graphs to 3D edges; all but the method concerns the depths along chains."""

    method: str = option(
        "chains",
        "How edges are traced: by depths along chains, or by the paper's correspondences",
        choices=("chains", "paper"),
        basic=True,
    )
    num_rounds: int = option(
        2,
        "Times that views are compared: the second time what no edge runs through, with less "
        "agreement asked for",
        within=(1, 10),
        basic=True,
    )
    max_inconsistency_px: float = option(
        3.0,
        "Largest difference of two views' depths of one point, in pixels of disparity",
        within=(0.05, 50),
    )
    min_agreeing_views: int = option(
        2,
        "Other views that must find the same depth for a sample to be sure",
        within=(1, 100),
        basic=True,
    )
    min_confirmed_ratio: float = option(
        0.7, "Share of sure samples that a run must have", within=(0, 1)
    )
    min_run_samples: int = option(2, "Samples that a run must have", within=(2, 100))
    max_disparity_gradient: float = option(
        1.0, "Largest change of disparity along a chain, in pixels a pixel", within=(0.01, 100)
    )
    max_bridge_px: int = option(
        200, "Longest stretch without depth inside a run, in pixels", within=(0, 10_000)
    )
    extension_px: int = option(
        24, "How far a run is followed beyond its ends, in pixels", within=(0, 1000)
    )
    point_spacing_px: int = option(
        4, "Distance of edge points along the driving chain, in pixels", within=(1, 100), basic=True
    )
    min_curve_points: int = option(3, "Edge points that a 3D edge must have", within=(2, 1000))
    min_observations: int = option(
        3, "Observations that an edge point must have (paper: k_v)", within=(2, 100), basic=True
    )
    occlusion_radius_px: float = option(
        10.0,
        "How far around a point nearer ones hide it, in pixels; 0 hides nothing",
        within=(0, 100),
    )
    max_sigma_ratio: float = option(
        5.0,
        "Largest standard deviation of an edge point's depth, in medians of all",
        within=(1, 1000),
    )
    max_residual_ratio: float = option(
        1.7,
        "Largest scatter of observations around a 3D edge, in medians of all observations'",
        within=(1, 100),
    )
    max_false_edges: float = option(
        1.0, "Number of 3D edges that chance may make in the whole scene", within=(1e-6, 1e6)
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
    max_join_angle_deg: float = option(
        30.0, "Largest turn where two 3D edges are joined, in degrees", within=(0, 90)
    )
    max_corner_spacings: float = option(
        8.0,
        "Longest way on which the end of a 3D edge is led to a corner where it meets others, in "
        "distances between edge points; 0 leads none",
        within=(0, 50),
    )
    node_radius_spacings: float = option(
        2.5,
        "Distance within which ends of 3D edges meet, in distances between edge points",
        within=(0, 50),
    )


@dataclass(frozen=True, kw_only=True)
class MatchingOptions(Options):
    """Polyline similarity and PECs (paper: Edge Matching and PEC generation)."""

    max_point_distance_px: float = option(
        10.0,
        "Largest distance of an SfM point that is close to a polyline (d_s), in pixels",
        within=(0.1, 100),
    )
    min_similarity: float = option(
        0.3, "Smallest similarity that links two polylines in the similarity graph", within=(0, 1)
    )
    resolution: float = option(
        1.0, "Resolution of the Louvain communities; larger makes smaller PECs", within=(0.01, 100)
    )


@dataclass(frozen=True, kw_only=True)
class CorrespondenceOptions(Options):
    """Potential edge-point correspondences (paper: PEPC generation)."""

    strategy: str = option("both", "Where PEPCs come from", choices=("both", "sfm_points", "pecs"))
    inner_radius_px: float = option(
        10.0,
        "Radius around an SfM point in which starts are sought (r_I), in sharpest pixels",
        within=(0.1, 100),
    )
    outer_radius_px: float = option(
        30.0,
        "Radius in which correspondences are sought (r_O), in sharpest pixels",
        within=(0.1, 200),
    )
    sample_spacing_px: float = option(
        20.0, "Distance between starts along the polylines of a PEC, in pixels", within=(1, 1000)
    )


@dataclass(frozen=True, kw_only=True)
class FollowingOptions(Options):
    """PEPC validation and 3D edge generation (paper: PEPC validation)."""

    step_px: float = option(
        10.0, "Walk along the leading polyline between edge points, in pixels", within=(1, 100)
    )
    max_error_px: float = option(
        2.0,
        "Largest reprojection error of a valid triangulation (epsilon), in pixels",
        within=(0.05, 50),
    )
    max_step_ratio: float = option(
        4.0, "Longest walk in another view for one step, in expected steps", within=(1, 100)
    )
    min_epipolar_angle_deg: float = option(
        5.0, "Smallest angle between an edge and an epipolar line, in degrees", within=(0, 90)
    )
    full_triangulation_angle_deg: float = option(
        10.0,
        "Triangulation angle from which a view counts fully when views are chosen",
        within=(0.1, 90),
    )
    max_stretch: float = option(
        10.0, "Longest 3D step, relative to the same step seen frontally", within=(1, 1000)
    )
    min_steps: int = option(
        2, "Directions that must be followable from a start (1 or 2)", within=(1, 2)
    )
    max_view_triples: int = option(
        3,
        "Triples of views tried, best conditioned first, until a selection is valid",
        within=(1, 100),
    )


@dataclass(frozen=True, kw_only=True)
class VisibilityOptions(Options):
    """Visibility refinement and outlier filter (paper: Visibility refinement)."""

    max_distance_px: float = option(
        4.0,
        "Distance within which a further view's polyline is sought (d_v), in pixels",
        within=(0.1, 100),
    )
    max_error_px: float = option(
        2.0, "Largest reprojection error with the new observation, in pixels", within=(0.05, 50)
    )
    max_tangent_angle_deg: float = option(
        20.0,
        "Largest angle between the projected edge and the polyline, in degrees",
        within=(0, 90),
    )
    min_views: int = option(
        4, "Smallest number of views of a 3D edge, whatever the median", within=(2, 100)
    )


@dataclass(frozen=True, kw_only=True)
class SamplingOptions(Options):
    """Fine sampling of 3D edges to edge points."""

    spacing_px: float = option(
        2.0, "Distance between edge points, in pixels of the sharpest view", within=(0.5, 100)
    )


@dataclass(frozen=True, kw_only=True)
class BundleAdjustmentOptions(Options):
    """Poses refined on SfM points and edge points together."""

    robust_factor: float = option(
        1.5,
        "Residual from which an observation loses influence, in standard deviations",
        within=(0.1, 100),
    )
    min_gain: float = option(
        0.0, "Share of held-out points' cost that refined poses must save to be kept", within=(0, 1)
    )
    max_rounds: int = option(
        6, "Most times that the noise is measured and steps are taken", within=(1, 100)
    )
    max_steps: int = option(6, "Most steps of a round", within=(1, 100))


@dataclass(frozen=True, kw_only=True)
class MeshingOptions(Options):
    """Points and rays -> triangle mesh; every option is free of the model's unit."""

    method: str = option(
        "graphcut",
        "How free cells are told from solid ones: minimum cut, votes of rays, or votes of rays "
        "and a sweep that makes the boundary a manifold (the paper's)",
        choices=("graphcut", "carve", "manifold"),
        basic=True,
    )
    sigma_factor: float = option(
        1.0,
        "Softness of a point's depth (sigma), in lower quartiles of edge lengths",
        within=(0.01, 100),
    )
    quality_weight: float = option(
        0.1,
        "Weight of well-shaped triangles against one ray; more is smoother",
        within=(0, 1000),
        basic=True,
    )
    edge_solid_weight: float = option(
        0.7,
        "graphcut: weight of the solid behind an edge point against that behind other points; "
        "less leaves more free space behind occluding edges",
        within=(0, 1),
    )
    background_weight: float = option(
        16.0,
        "Weight of a line of sight to a plain backdrop (with masks_are_background: to what masks "
        "hide) against one to a point; 0 uses none",
        within=(0, 1000),
        basic=True,
    )
    vote_crossed: float = option(
        1.0,
        "carve, manifold: vote of a ray for each cell it crosses (the paper's w1, 1)",
        within=(0, 1000),
    )
    vote_near: float = option(
        0.0,
        "carve, manifold: vote for the neighbours of these cells (the paper's w2, 0.2)",
        within=(0, 1000),
    )
    vote_far: float = option(
        0.0,
        "carve, manifold: vote for the neighbours of those (the paper's w3, 0)",
        within=(0, 1000),
    )
    vote_behind: float = option(
        1.0,
        "carve, manifold: vote of a ray against each of the two cells behind its point, so that a "
        "few wrong rays do not open a surface that many rays see; 0, as in the paper, counts none",
        within=(0, 1000),
    )
    vote_threshold: float = option(
        2.1,
        "carve, manifold: votes that make a cell free; above 2, no two rays alone do (the paper "
        "with w2 0.2: 1)",
        within=(0.01, 1e6),
    )
    merge_factor: float = option(
        0.05,
        "Make edge points one that are closer than this, in typical distances of neighbours on an "
        "edge as the cameras see them; 0 keeps all",
        within=(0, 1),
    )
    min_segment_factor: float = option(
        0.25,
        "Split 3D edges until they are edges of the mesh, down to this length in medians of their "
        "segments; 0 splits none",
        within=(0, 100),
    )
    long_facet_factor: float = option(
        0.5,
        "Drop triangles with a longer side, in distances to the cameras; 0 keeps all",
        within=(0, 1000),
        basic=True,
    )
    min_component_faces: int = option(
        1, "Drop connected components of fewer triangles", within=(1, 1_000_000), basic=True
    )
    max_faces: int = option(
        0,
        "Simplify the mesh to this many triangles by quadric errors; 0 keeps all",
        within=(0, 100_000_000),
        basic=True,
    )


@dataclass(frozen=True, kw_only=True)
class PipelineOptions(Options):
    """Everything a run can be told: one group a stage, and what concerns the whole run."""

    detection: DetectionOptions = field(default_factory=DetectionOptions)
    edge_graph: EdgeGraphOptions = field(default_factory=EdgeGraphOptions)
    view_selection: ViewSelectionOptions = field(default_factory=ViewSelectionOptions)
    chain_depth: ChainDepthOptions = field(default_factory=ChainDepthOptions)
    tracing: TracingOptions = field(default_factory=TracingOptions)
    linking: LinkingOptions = field(default_factory=LinkingOptions)
    refinement: RefinementOptions = field(default_factory=RefinementOptions)
    matching: MatchingOptions = field(default_factory=MatchingOptions)
    correspondence: CorrespondenceOptions = field(default_factory=CorrespondenceOptions)
    following: FollowingOptions = field(default_factory=FollowingOptions)
    visibility: VisibilityOptions = field(default_factory=VisibilityOptions)
    sampling: SamplingOptions = field(default_factory=SamplingOptions)
    bundle_adjustment: BundleAdjustmentOptions = field(default_factory=BundleAdjustmentOptions)
    meshing: MeshingOptions = field(default_factory=MeshingOptions)
    use_edges: bool = option(True, "Mesh SfM points and edges; 0 meshes the SfM points alone")
    report: bool = option(True, "Write report.html, with a viewer of the result; 0 does not")
    refine_poses: bool = option(
        False, "Refine the poses on SfM points and edges, then trace again with the refined ones"
    )
    masks_are_background: bool = option(
        False,
        "What masks hide is behind all there is, as the sky is: lines of sight to it meet nothing",
    )
    output_type: str = option("BIN", "Format of the written COLMAP model", choices=("BIN", "TXT"))
    mesh_type: str = option("PLY", "Format of the written mesh", choices=("PLY", "OBJ", "GLB"))
    num_threads: int = option(-1, "Threads of work; -1 takes every core", within=(-1, 100_000))
    max_graph_memory_gb: float = option(
        4.0,
        "Memory for 2D edge graphs, in gigabytes; those beyond it wait on disk (TMPDIR)",
        within=(0.001, 100_000),
    )
    random_seed: int = option(0, "Seed of every random choice", within=(0, 4_294_967_295))

    def __post_init__(self) -> None:
        """Raise `OptionError` for a value outside its range, or options that contradict."""
        super().__post_init__()
        if self.refine_poses and not self.use_edges:
            raise OptionError("refine_poses is 1 and use_edges 0; poses are refined on edges")
        if self.masks_are_background and not self.use_edges:
            raise OptionError("masks_are_background is 1 and use_edges 0, which reads no images")


# What --quality sets; medium is the defaults.
PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "low": {
        "detection": {"min_blur_px": 0.0},
        "view_selection": {"num_neighbors": 5, "num_later_neighbors": 5, "num_observing_views": 20},
        "chain_depth": {"sample_step_px": 36},
        "tracing": {"point_spacing_px": 6},
    },
    "medium": {},
    "high": {
        "detection": {"min_blur_px": 1.2},
        "view_selection": {"num_neighbors": 16, "num_observing_views": 60},
        "chain_depth": {"sample_step_px": 8},
        "tracing": {"point_spacing_px": 3},
    },
}


def preset(quality: str) -> PipelineOptions:
    """The options of a preset.

    Args:
        quality: low, medium or high; medium is `PipelineOptions()`.

    Raises:
        OptionError: when there is no such preset.
    """
    if quality not in PRESETS:
        raise OptionError(f"quality is {quality!r}; choose one of: {', '.join(PRESETS)}")
    defaults = PipelineOptions()
    groups = {
        name: replace(getattr(defaults, name), **values)
        for name, values in PRESETS[quality].items()
    }
    return replace(defaults, **groups)
