"""The options of a whole run: one group per stage, and options of the run as a whole."""

from __future__ import annotations

from dataclasses import dataclass, field

from colmap_edges.declared_options import Options, option
from colmap_edges.errors import OptionError
from colmap_edges.options.detecting import DetectionOptions, EdgeGraphOptions
from colmap_edges.options.meshing import BundleAdjustmentOptions, MeshingOptions
from colmap_edges.options.paper import (
    CorrespondenceOptions,
    FollowingOptions,
    MatchingOptions,
    SamplingOptions,
    VisibilityOptions,
)
from colmap_edges.options.tracing import (
    ChainDepthOptions,
    CurvesOptions,
    LinkingOptions,
    RefinementOptions,
    TracingOptions,
    ViewSelectionOptions,
)


@dataclass(frozen=True, kw_only=True)
class PipelineOptions(Options):
    """All options of a run: one group per stage, and options of the run as a whole."""

    detection: DetectionOptions = field(default_factory=DetectionOptions)
    edge_graph: EdgeGraphOptions = field(default_factory=EdgeGraphOptions)
    view_selection: ViewSelectionOptions = field(default_factory=ViewSelectionOptions)
    chain_depth: ChainDepthOptions = field(default_factory=ChainDepthOptions)
    tracing: TracingOptions = field(default_factory=TracingOptions)
    linking: LinkingOptions = field(default_factory=LinkingOptions)
    refinement: RefinementOptions = field(default_factory=RefinementOptions)
    curves: CurvesOptions = field(default_factory=CurvesOptions)
    matching: MatchingOptions = field(default_factory=MatchingOptions)
    correspondence: CorrespondenceOptions = field(default_factory=CorrespondenceOptions)
    following: FollowingOptions = field(default_factory=FollowingOptions)
    visibility: VisibilityOptions = field(default_factory=VisibilityOptions)
    sampling: SamplingOptions = field(default_factory=SamplingOptions)
    bundle_adjustment: BundleAdjustmentOptions = field(default_factory=BundleAdjustmentOptions)
    meshing: MeshingOptions = field(default_factory=MeshingOptions)
    use_edges: bool = option(True, "Mesh SfM points and edges; 0 meshes SfM points only")
    use_faces: bool = option(
        True,
        "Find planar faces between edges, write faces.json, and mesh them in plain scenes",
    )
    report: bool = option(True, "Write report.html, a page with a 3D viewer")
    refine_poses: bool = option(
        False, "Refine the poses on SfM points and edges, then reconstruct the edges again"
    )
    masks_are_background: bool = option(
        False,
        "Treat masked pixels as background: their rays are free space",
    )
    output_type: str = option("BIN", "Format of the written COLMAP model", choices=("BIN", "TXT"))
    num_threads: int = option(-1, "Number of threads; -1 uses all cores", within=(-1, 100_000))
    max_graph_memory_gb: float = option(
        4.0,
        "Memory for 2D edge graphs, in gigabytes; the rest is kept on disk (TMPDIR)",
        within=(0.001, 100_000),
    )
    random_seed: int = option(0, "Seed of all random numbers", within=(0, 4_294_967_295))

    def __post_init__(self) -> None:
        """Raise `OptionError` for a value outside its range, or options that contradict."""
        super().__post_init__()
        if self.refine_poses and not self.use_edges:
            raise OptionError(
                "refine_poses is 1 and use_edges 0, but poses are refined on edges; set use_edges 1"
            )
        if self.masks_are_background and not self.use_edges:
            raise OptionError(
                "masks_are_background is 1 and use_edges 0, but masks are read only to find edges; "
                "set use_edges 1"
            )
