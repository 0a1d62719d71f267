"""Figures of the meshes and edges of a run against the truth of its scene."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from colmap_edges.colmap.model import load_model
from colmap_edges.core.view import View
from colmap_edges.evaluation.metrics import clouds, depth
from colmap_edges.evaluation.metrics.curves import sample
from colmap_edges.evaluation.metrics.edge_graphs import times_found
from colmap_edges.evaluation.metrics.raycasting import RayCaster, load_mesh
from colmap_edges.evaluation.readers.arrays import read_arrays
from colmap_edges.evaluation.readers.curves import Curves, load_curves

MESHES = ("sfm", "edges", "faces", "patches")
STEPS = ("sfm", "reconstruct", "edges", "faces", "patches")
NUM_VIEWS = 6
STRIDE = 4  # pixels between rays
THRESHOLD = 0.005  # of edges, of the longest side of the true curves' box
MIN_VIEWS = 3  # that see a true curve which can be reconstructed


@dataclass(frozen=True, kw_only=True)
class TruthOfView:
    """The true depths and normals of a view, at the pixels of the given camera.

    Attributes:
        reference: Depths and normals; its view is the given one.
        sky: (N, 2) pixels at which there is no surface.
    """

    reference: depth.ReferenceDepth
    sky: Any


def judge(scene: Path, run: Path) -> dict[str, Any]:
    """Figures of a run.

    Returns:
        `meshes` by `MESHES` (errors in shares of depth, see `mesh_figures`), `edges` (None without
        true curves), and `seconds` of CPU time of edges and faces with their mesh.
    """
    found = read_arrays(run)
    truths = list(truth_of(scene))
    seconds = dict(zip(STEPS, found["seconds"], strict=True))
    return {
        "meshes": {name: mesh_figures(caster_of(found, name), truths) for name in MESHES},
        "edges": edge_figures(found_curves(found), scene / "curves.npz"),
        "seconds": float(seconds["reconstruct"] + seconds["patches"]),
    }


def caster_of(found: dict[str, Any], name: str) -> RayCaster:
    """The mesh of a run for ray casting."""
    return RayCaster(found[f"{name}_vertices"].astype(np.float64), found[f"{name}_faces"])


def found_curves(found: dict[str, Any]) -> Curves:
    """The edges of a run."""
    return Curves(points=found["edge_points"], segments=found["edge_segments"])


def truth_of(
    scene: Path, num_views: int = NUM_VIEWS, stride: int = STRIDE
) -> Iterator[TruthOfView]:
    """The truth in some views of a scene, evenly chosen by name, at every `stride`-th pixel."""
    surface = load_mesh(scene / "surface.ply")
    caster = RayCaster(surface.vertices, surface.faces)
    given = load_model(scene / "sparse").views
    cameras = json.loads((scene / "true_cameras.json").read_text(encoding="utf-8"))
    chosen = np.linspace(0, len(given) - 1, min(num_views, len(given))).round().astype(int)
    for view in (given[index] for index in chosen):
        first = stride // 2
        rows, columns = np.mgrid[first : view.height : stride, first : view.width : stride]
        pixels = np.dstack([columns, rows]).astype(np.float64) + 0.5
        true = true_view(view, cameras)
        hits = caster.hits(true.center, true.rays(pixels.reshape(-1, 2)))
        reference = depth.ReferenceDepth(
            view=view,
            depth=np.nan_to_num(hits.t).astype(np.float32).reshape(rows.shape),
            scale=1 / stride,
            pixels=pixels,
            surface_normals=hits.normals.reshape(*rows.shape, 3),
        )
        yield TruthOfView(reference=reference, sky=pixels[~reference.known])


def true_view(view: View, cameras: dict[str, Any]) -> View:
    """The view with its true camera and pose, of true_cameras.json."""
    size = {name: cameras[name] for name in ("model", "width", "height", "params")}
    pose = np.array(cameras["cam_from_world"][view.name])
    return replace(
        view, camera=pycolmap.Camera(**size), rotation=pose[:, :3], translation=pose[:, 3]
    )


def mesh_figures(caster: RayCaster, truths: list[TruthOfView]) -> dict[str, Any]:
    """Figures of `depth.pool`, with errors in shares of depth; and of the sky.

    `sky_covered` is the share of the pixels without surface at which there is a mesh, None if
    there are none.
    """
    results = [relative(depth.depth_errors(caster, truth.reference)) for truth in truths]
    covered = [caster.depth_at(truth.reference.view, truth.sky) for truth in truths]
    hit = np.isfinite(np.concatenate(covered))
    sky = float(hit.mean()) if len(hit) else None
    return depth.pool(results) | {"sky_covered": sky}


def relative(errors: depth.DepthErrors) -> depth.DepthErrors:
    """The errors in shares of the reference's depth."""
    known = errors.known
    scale = np.where(known, errors.reference, np.nan)
    return replace(errors, errors=errors.errors / scale, reference=known.astype(np.float32))


def edge_figures(found: Curves, curves_path: Path) -> dict[str, Any] | None:
    """Precision, recall, F and times found of edges; None without a true curve.

    An edge may lie on any true curve; a true curve is to be found if at least three views see it.
    """
    true = load_curves(curves_path)
    if not len(true.segments):
        return None
    visible = read_arrays(curves_path).get("visible")
    seen = true
    if visible is not None:
        chosen = true.segments[visible.sum(axis=1) >= min(MIN_VIEWS, visible.shape[1])]
        seen = replace(true, segments=chosen)
    size = float(np.ptp(true.points[true.segments.ravel()], axis=0).max())
    limit = THRESHOLD * size
    edges, curves = sample(found, limit / 5), sample(true, limit / 5)
    wanted = sample(seen, limit / 5) if len(seen.segments) else curves[:0]
    to_true, to_found = (clouds.cloud_to_cloud(*p) for p in ((edges, curves), (wanted, edges)))
    score = clouds.scores(to_true, to_found, [limit])[0]
    times = times_found(found, true, [THRESHOLD], size)[0]["times"] if len(edges) else None
    return {name: score[name] for name in ("precision", "recall", "f_score")} | {"times": times}
