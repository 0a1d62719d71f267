"""Outlines of smooth bodies: contours whose depths and radii several views determine.

Outlines move over a body with the view, the more the larger its radius of curvature, so that
matching at one depth finds few of them. Here each chain without a 3D edge is matched with its
neighbours by depth and radius together (Cipolla, Blake 1992; Vaillant, Faugeras 1992).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    ByteArray,
    Float32Array,
    FloatArray,
    IntArray,
    joined_offsets,
    joined_tables,
    offsets_of,
    owners_of,
    ranks_of,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.outlines import Outlines
from colmap_edges.core.seen_points import MIN_COSINE
from colmap_edges.core.view import in_images, lift, rows_by_view, views_with_rows
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges3d.chains.depths import matching, sample_chains
from colmap_edges.edges3d.chains.occlusion import find_hidden
from colmap_edges.edges3d.chains.tracing_input import TracingInput
from colmap_edges.edges3d.chains.view_selection import DepthRange, Neighborhood
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import ChainDepthOptions, PipelineOptions
from colmap_edges.runtime.executors import Call, Workers, run_all

STEP_PX = 8  # between samples, so that several of a run agree on a radius
MIN_SAMPLES = 5  # of a run; 97 of 100 such runs lie on the surface, of runs of four 93
MIN_SUPPORTS = 3.5  # mean number of neighbours of a run's samples; depth and radius take two
MAX_CHANGE = 0.2  # of the radius between two samples, relative; that of wrong matches is random
MIN_SIGNIFICANCE = 3.0  # mean of a run's radii over their standard deviations for 1 px
SIGMA_PX = 0.5  # standard deviation of a point across the surface, pixels of the given images
# Views that see a point of an outline, the most frontal ones: two at least decide whether a mesh
# lacks it.
MIN_SEEING, NUM_SEEING = 2, 3


@dataclass(frozen=True, kw_only=True)
class Envelopes:
    """Points on outlines of smooth bodies, in CSR arrays.

    Attributes:
        points: (N, 3) world points at which viewing rays touch the body.
        normals: (N, 3) unit normals of the surface, out of the body.
        views: (N,) views whose rays these are.
        colors: (N, 3) uint8 RGB.
        lengths: (E,) numbers of consecutive points on one outline.
    """

    points: FloatArray
    normals: FloatArray
    views: IntArray
    colors: ByteArray
    lengths: IntArray


def find_envelopes(
    given: TracingInput, near: Neighborhood, options: ChainDepthOptions, workers: Workers
) -> Envelopes:
    """Find the outlines on the chains of every view.

    Args:
        given: the views with the parts of their graphs that have no 3D edge.
        near: the neighbours and the depth ranges of the views.
        options: agreement of views and continuity along chains.
        workers: executor of the work on views.
    """

    def calls() -> Iterator[Call]:
        for view in range(given.num_views):
            part = given.part(view, given.neighbors[view], workers)
            yield envelopes_of, (part, view, near.ranges[view], options)

    found: list[Envelopes] = run_all(workers.images, calls(), check=workers.check)
    return joined_tables(found)


def envelopes_of(
    given: TracingInput,
    view: int,
    depth_range: DepthRange,
    options: ChainDepthOptions,
) -> Envelopes:
    """Find the outlines on the chains of a view."""
    graph, own = given.graph(view), given.views[view]
    samples, offsets = samples_on_long_chains(graph)
    matched = matching(given, view, samples, offsets, depth_range, options)
    columns, supports = _kernels.envelopes(**matched, num_threads=1)
    inverse_depths, radii, sigmas = columns[:3]
    runs = find_runs(radii, sigmas, *supports)
    rows = np.flatnonzero(runs >= 0)
    places, lengths = samples[rows], np.unique(runs[rows], return_counts=True)[1]
    undistorted = graph.undistorted[places].astype(np.float64)
    tangents = _kernels.chain_points(given.index(view), places.astype(np.float64))[1]
    normals = normals_of(own.focal_px, undistorted, tangents, graph.normals[places], radii[rows])
    return Envelopes(
        points=lift(own, undistorted, inverse_depths[rows]),
        normals=normals @ own.rotation,
        views=np.full(len(rows), view),
        colors=graph.colors[places],
        lengths=lengths,
    )


def samples_on_long_chains(graph: EdgeGraph) -> tuple[IntArray, IntArray]:
    """Indices of samples, and their offsets by chain, on chains that are long enough for a run."""
    samples, offsets = sample_chains(graph, STEP_PX)
    counts = np.diff(offsets)
    long = counts >= MIN_SAMPLES
    return samples[np.repeat(long, counts)], offsets_of(counts[long])


def find_runs(
    radii: FloatArray, sigmas: FloatArray, num_supports: IntArray, goes_on: IntArray
) -> IntArray:
    """(S,) number of the run of each sample, ascending; -1 for none.

    Args:
        radii: (S,) radii of consecutive samples on chains; 0 for none.
        sigmas: (S,) their standard deviations for 1 px.
        num_supports: (S,) numbers of neighbours that agree.
        goes_on: (S,) whether a sample continues the outline of the previous one on its chain.
    """
    same = np.zeros(len(radii), bool)
    change = np.abs(np.diff(radii))
    size = np.maximum(np.abs(radii[1:]), np.abs(radii[:-1]))
    same[1:] = (goes_on[1:] > 0) & (change <= MAX_CHANGE * size)
    runs = np.cumsum(~same) - 1
    counts = np.bincount(runs)
    significance = np.abs(radii) / np.where(sigmas > 0, sigmas, np.inf)
    mean_supports, mean_significance = (
        np.bincount(runs, of) / np.maximum(counts, 1) for of in (num_supports, significance)
    )
    kept = (counts >= MIN_SAMPLES) & (mean_supports >= MIN_SUPPORTS)
    kept &= mean_significance >= MIN_SIGNIFICANCE
    return np.where(kept[runs], runs, -1)


def normals_of(
    focal_px: float,
    undistorted: FloatArray,
    tangents: FloatArray,
    brighter: Float32Array,
    radii: FloatArray,
) -> FloatArray:
    """(N, 3) unit normals out of the body, in the camera's frame.

    The surface's tangent plane contains the viewing ray and the outline's tangent.

    Args:
        focal_px: focal length.
        undistorted: (N, 2) pixels.
        tangents: (N, 2) tangents of the chains.
        brighter: (N, 2) normals of the chains, towards the bright side.
        radii: (N,) signed radii, positive if the bright side is outside the body.
    """
    rays = np.column_stack([undistorted / focal_px, np.ones(len(undistorted))])
    normals = np.cross(rays, np.column_stack([tangents, np.zeros(len(tangents))]))
    to_bright = np.sign((normals[:, :2] * brighter).sum(axis=1))
    normals *= (to_bright * np.sign(radii) / np.linalg.norm(normals, axis=1))[:, None]
    return normals


def seen_outlines(
    found: Envelopes,
    edges: Edges3D,
    model: Model,
    observing_views: Sequence[IntArray],
    options: PipelineOptions,
    num_threads: int,
) -> Outlines:
    """The points of outlines that at least two views see frontally, with these views.

    Args:
        found: the outlines.
        edges: the 3D edges; they and SfM points occlude outlines.
        model: the views and the SfM points.
        observing_views: per view those that may see its outlines.
        options: radius in which points are compared for occlusion.
        num_threads: threads to use; the result does not depend on it.
    """
    owners, views = seeing(found, edges, model, observing_views, options, num_threads)
    counts = np.bincount(owners, minlength=len(found.points))
    kept = counts >= MIN_SEEING
    sigmas = np.zeros(len(found.points))
    for view, rows in views_with_rows(model.views, found.views):
        depths = view.cam_from_world(found.points[rows])[:, 2]
        sigmas[rows] = SIGMA_PX * view.scale / view.focal_px * depths
    return Outlines(
        points=found.points[kept],
        normals=found.normals[kept],
        sigmas=sigmas[kept],
        colors=found.colors[kept],
        track_offsets=offsets_of(counts[kept]),
        track_views=views[kept[owners]].astype(np.int32),
    )


def seeing(
    found: Envelopes,
    edges: Edges3D,
    model: Model,
    observing_views: Sequence[IntArray],
    options: PipelineOptions,
    num_threads: int,
) -> tuple[IntArray, IntArray]:
    """Points of outlines, and views that see each from the most frontal side, not occluded."""
    parts = [np.zeros((0, 3))]
    for view, rows in enumerate(rows_by_view(found.views, len(model.views))):
        if not len(rows):
            continue
        # Frontal views share few points with the one that touches the body, but with views between.
        near = observing_views[view]
        others = np.unique(np.concatenate([near, *(observing_views[other] for other in near)]))
        away = model.camera_centers[others] - found.points[rows, None]
        cosines = np.einsum("nvk,nk->nv", away, found.normals[rows])
        cosines /= np.linalg.norm(away, axis=2)
        inside = in_images([model.views[other] for other in others.tolist()], found.points[rows])
        points, places = np.nonzero((cosines > MIN_COSINE) & inside.T)
        parts.append(np.column_stack([rows[points], others[places], cosines[points, places]]))
    points, views = np.concatenate(parts)[:, :2].T.astype(np.int64)
    cosines = np.concatenate(parts)[:, 2]
    hidden = find_hidden(
        with_edges(model, edges),
        found.points,
        np.zeros(len(found.points)),
        owners_of(offsets_of(found.lengths)),
        points,
        views.astype(np.int32),
        options.tracing.occlusion_radius_px,
        num_threads,
    )
    points, views, cosines = points[~hidden], views[~hidden], cosines[~hidden]
    order = np.lexsort((-cosines, points))
    points, views = points[order], views[order]
    ranks = ranks_of(np.bincount(points, minlength=len(found.points)))
    return points[ranks < NUM_SEEING], views[ranks < NUM_SEEING]


def with_edges(model: Model, edges: Edges3D) -> Model:
    """The model with the points of edges among its points, as far as occlusion needs it."""
    return replace(
        model,
        points3D_xyz=np.concatenate([model.points3D_xyz, edges.points]),
        track_offsets=joined_offsets([model.track_offsets, edges.observations.offsets]),
        track_views=np.concatenate([model.track_views, edges.observations.views]),
    )
