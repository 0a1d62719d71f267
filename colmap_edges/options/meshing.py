"""Options and constants of pose refinement and meshing."""

from __future__ import annotations

from dataclasses import dataclass

from colmap_edges.declared_options import Options, option


@dataclass(frozen=True, kw_only=True)
class BundleAdjustmentOptions(Options):
    """Joint refinement of poses, SfM points and edge points."""

    # Scale of the Cauchy loss of residuals, in standard deviations of an observation (near the
    # 1.345 of Huber's estimator).
    robust_factor: float = 1.5
    # Observations of each frame by the points that are held out in turn, and by those that poses
    # are adjusted to. Points are chosen by chance (set by trial: more change nothing but the time).
    tested_observations: int = 500
    adjusted_observations: int = 2000
    # Number of parts in which points are held out.
    num_folds: int = 5
    # Minimum relative decrease of the cost of held-out points for which refined poses are kept, of
    # one part where it is clear, else the median of all: less changes no result, but takes time
    # (set by trial: true poses have at most 0.004, most poses that are off by 0.1 to 0.5 px 0.08 to
    # 0.7).
    min_gain: float = 0.05
    # Strength of the initial poses: number of points that each shows in its place (set by trial).
    prior_observations: float = 30.0
    # Maximum number of rounds; each estimates the noise, then minimises the cost (set by trial).
    max_rounds: int = 6
    # Maximum number of Gauss-Newton steps per round (set by trial).
    max_steps: int = 6


@dataclass(frozen=True, kw_only=True)
class DenseOptions(Options):
    """Use of a dense point cloud by the mesher."""

    max_proj_dist: float = option(
        6.0,
        "Keep one point of a dense cloud per cube of this size in the images, in pixels; 0 keeps "
        "all",
        within=(0, 1000),
    )
    edge_dist: float = option(
        16.0,
        "Leave out points of a dense cloud within this distance of 3D edges, in pixels: dense "
        "stereo smears edges over half its window",
        within=(0, 1000),
    )


@dataclass(frozen=True, kw_only=True)
class MeshingOptions(Options):
    """Meshing of points and viewing rays; no option depends on the model's unit."""

    method: str = option(
        "graphcut",
        "How cells are labelled free or solid: minimum cut; votes of viewing rays; or votes and "
        "a repair to a manifold boundary (for --method paper)",
        choices=("graphcut", "carve", "manifold"),
        basic=True,
    )
    # Standard deviation of a point's depth (sigma), in lower quartiles of the triangulation's edge
    # lengths (set by trial (docs/experiments.md)).
    sigma_factor: float = 1.0
    quality_weight: float = option(
        0.1,
        "Weight of the triangle quality term relative to one ray; larger values smooth the mesh",
        within=(0, 1000),
        basic=True,
    )
    # graphcut: weight of the solid cell behind an edge point, relative to other points; smaller
    # values leave more free space behind occluding edges (set by trial (docs/experiments.md)).
    edge_solid_weight: float = 0.7
    background_weight: float = option(
        16.0,
        "Weight of a background ray (plain backdrop, sky, or masked pixels with "
        "masks_are_background) relative to a ray to a point; 0 disables them",
        within=(0, 1000),
    )
    # carve, manifold: vote of a ray for the cells it crosses (w1) (the paper).
    vote_crossed: float = 1.0
    # carve, manifold: vote of a ray for the neighbours of these cells (w2) (set by trial; the paper
    # has 0.2).
    vote_near: float = 0.0
    # carve, manifold: vote of a ray for the neighbours of those neighbours (w3) (the paper).
    vote_far: float = 0.0
    # carve, manifold: vote of a ray against the two cells behind its point; protects surfaces from
    # single wrong rays (equal to that for a crossed cell; 0 in the paper).
    vote_behind: float = 1.0
    vote_threshold: float = option(
        2.1,
        "carve, manifold: minimum sum of votes for a free cell; above 2, two rays do not suffice",
        within=(0.01, 1e6),
    )
    # Distance below which edge points are merged, relative to the typical spacing of edge points as
    # the cameras see them; 0 merges none (set by trial (docs/experiments.md)).
    merge_factor: float = 0.05
    # Minimum length to which segments of 3D edges are split to become edges of the mesh, in median
    # segment lengths; 0 splits none (set by trial (docs/experiments.md)).
    min_segment_factor: float = 0.25
    long_facet_factor: float = option(
        0.5,
        "Drop triangles with a side longer than this, relative to their distance to the cameras; "
        "0 keeps all",
        within=(0, 1000),
        basic=True,
    )
    min_component_faces: int = option(
        1, "Drop connected components of fewer triangles", within=(1, 1_000_000), basic=True
    )
    max_faces: int = option(
        0,
        "Simplify the mesh to this number of triangles, and keep its creases; 0 keeps all",
        within=(0, 100_000_000),
        basic=True,
    )
