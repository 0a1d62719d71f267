"""Options and constants of what uses 3D edges: refinement of poses, and the mesh."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.declared_options import Options, constant, option

TRIED = "set by trial (docs/experiments.md)"


@dataclass(frozen=True, kw_only=True)
class BundleAdjustmentOptions(Options):
    """Poses refined on SfM points and edge points together."""

    robust_factor: float = constant(
        1.5,
        "Residual from which an observation loses influence, in standard deviations",
        "near the 1.345 of Huber's estimator",
        within=(0.1, 100),
    )
    min_gain: float = constant(
        0.0,
        "Share of held-out points' cost that refined poses must save to be kept",
        "any gain on held-out points counts",
        within=(0, 1),
    )
    sample_step_ratio: float = constant(
        0.8,
        "Step between samples of chains whose edges poses are refined on, in sample_step_points",
        "set by trial: more edges",
        within=(0.01, 1),
    )
    max_rounds: int = constant(
        6,
        "Most times that the noise is measured and steps are taken",
        "set by trial",
        within=(1, 100),
    )
    max_steps: int = constant(6, "Most steps of a round", "set by trial", within=(1, 100))


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
    sigma_factor: float = constant(
        1.0,
        "Softness of a point's depth (sigma), in lower quartiles of edge lengths",
        TRIED,
        within=(0.01, 100),
    )
    quality_weight: float = option(
        0.1,
        "Weight of well-shaped triangles against one ray; more is smoother",
        within=(0, 1000),
        basic=True,
    )
    edge_solid_weight: float = constant(
        0.7,
        "graphcut: weight of the solid behind an edge point against that behind other points; "
        "less leaves more free space behind occluding edges",
        TRIED,
        within=(0, 1),
    )
    background_weight: float = option(
        16.0,
        "Weight of a ray to the background (a plain backdrop, or masked pixels with "
        "masks_are_background) against a ray to a point; 0 disables",
        within=(0, 1000),
    )
    vote_crossed: float = constant(
        1.0,
        "carve, manifold: vote of a ray for each cell it crosses (w1)",
        "the paper",
        within=(0, 1000),
    )
    vote_near: float = constant(
        0.0,
        "carve, manifold: vote for the neighbours of these cells (w2)",
        "set by trial; the paper has 0.2",
        within=(0, 1000),
    )
    vote_far: float = constant(
        0.0,
        "carve, manifold: vote for the neighbours of those (w3)",
        "the paper",
        within=(0, 1000),
    )
    vote_behind: float = constant(
        1.0,
        "carve, manifold: vote of a ray against each of the two cells behind its point, so that a "
        "few wrong rays do not open a surface that many rays see",
        "as much as for a crossed cell; the paper counts none, 0",
        within=(0, 1000),
    )
    vote_threshold: float = option(
        2.1,
        "carve, manifold: votes that make a cell free; above 2, no two rays alone do",
        within=(0.01, 1e6),
    )
    merge_factor: float = constant(
        0.05,
        "Make edge points one that are closer than this, in typical distances of neighbours on an "
        "edge as the cameras see them; 0 keeps all",
        TRIED,
        within=(0, 1),
    )
    min_segment_factor: float = constant(
        0.25,
        "Split 3D edges until they are edges of the mesh, down to this length in medians of their "
        "segments; 0 splits none",
        TRIED,
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
