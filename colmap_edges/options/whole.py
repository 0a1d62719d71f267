"""The options of a whole run: one group per stage, and options of the run as a whole."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.declared_options import Options, group, option
from colmap_edges.errors import OptionError
from colmap_edges.options.detecting import DetectionOptions, EdgeGraphOptions
from colmap_edges.options.meshing import BundleAdjustmentOptions, DenseOptions, MeshingOptions
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
    """All options of a run: one group per stage, and options of the run as a whole.

    Each field names the stage that it belongs to: detect, trace, refine, write or mesh.
    """

    detection: DetectionOptions = group(DetectionOptions, "detect")
    edge_graph: EdgeGraphOptions = group(EdgeGraphOptions, "detect")
    view_selection: ViewSelectionOptions = group(ViewSelectionOptions, "trace")
    chain_depth: ChainDepthOptions = group(ChainDepthOptions, "trace")
    tracing: TracingOptions = group(TracingOptions, "trace")
    linking: LinkingOptions = group(LinkingOptions, "trace")
    refinement: RefinementOptions = group(RefinementOptions, "trace")
    curves: CurvesOptions = group(CurvesOptions, "write")
    matching: MatchingOptions = group(MatchingOptions, "trace")
    correspondence: CorrespondenceOptions = group(CorrespondenceOptions, "trace")
    following: FollowingOptions = group(FollowingOptions, "trace")
    visibility: VisibilityOptions = group(VisibilityOptions, "trace")
    sampling: SamplingOptions = group(SamplingOptions, "trace")
    bundle_adjustment: BundleAdjustmentOptions = group(BundleAdjustmentOptions, "trace")
    meshing: MeshingOptions = group(MeshingOptions, "mesh")
    dense: DenseOptions = group(DenseOptions, "mesh")
    use_edges: bool = option(True, "Mesh points and edges; 0 meshes points only", stage="mesh")
    use_faces: bool = option(
        True,
        "Find planar faces between edges, and mesh them in plain scenes",
        stage="mesh",
    )
    use_sky: bool = option(
        True,
        "Find the sky or a far backdrop in images without a plain one; its rays keep the mesh open",
        stage="mesh",
    )
    use_patches: bool = option(
        True, "Mesh points found where images have texture, too", stage="mesh"
    )
    write_patches: bool = option(
        False, "Write points found where images have texture, too", stage="write"
    )
    refine_mesh: bool = option(
        True,
        "Smooth the mesh between edges and replace thin triangles, within the noise of its points",
        stage="mesh",
    )
    mesh_type: str = option(
        "PLY", "Format of the written mesh", choices=("PLY", "OBJ", "GLB"), stage="mesh"
    )
    texture_size: int = option(
        8192,
        "Largest side of the texture of OBJ and GLB meshes, pixels; 0 writes none",
        within=(0, 32_768),
        stage="mesh",
    )
    report: bool = option(True, "Write report.html, a page with a 3D viewer", stage="write")
    refine_poses: bool = option(
        True,
        "Refine poses and SIMPLE_RADIAL lenses, if held-out points fit better for it",
        stage="trace",
    )
    masks_are_background: bool = option(
        False, "Treat masked pixels as background: their rays are free space", stage="mesh"
    )
    output_type: str = option(
        "BIN", "Format of the written COLMAP model", choices=("BIN", "TXT"), stage="write"
    )
    num_threads: int = option(
        -1, "Number of threads; -1 uses all cores", within=(-1, 100_000), stage="detect"
    )
    max_graph_memory_gb: float = option(
        4.0,
        "Memory for 2D edge graphs, in gigabytes; the rest is kept on disk (TMPDIR)",
        within=(0.001, 100_000),
        stage="detect",
    )
    random_seed: int = option(
        0, "Seed of all random numbers", within=(0, 4_294_967_295), stage="trace"
    )

    def __post_init__(self) -> None:
        """Raise `OptionError` for a value outside its range, or options that contradict."""
        super().__post_init__()
        if self.masks_are_background and not self.use_edges:
            raise OptionError(
                "masks_are_background is 1 and use_edges 0, but masks are read only to find edges; "
                "set use_edges 1"
            )
