"""Writing and reading of edges, nodes and curves as edges.json."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray, entries_of, offsets_of
from colmap_edges.core.checks import check_shape, checked
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D, Nodes
from colmap_edges.core.observations import Observations
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.curve_records import curve_records
from colmap_edges.runtime.input_files import DAMAGE, read_text
from colmap_edges.runtime.output import write_whole


@checked
def write_json(
    edges: Edges3D,
    curves: Curves3D,
    model: Model,
    point3D_ids: IntArray,
    residuals: FloatArray,
    path: Path,
) -> None:
    """Write edges, nodes and curves as JSON, one line each.

    Args:
        edges: the edges; an edge's id is its index.
        curves: the curves that they consist of.
        model: the model whose views the tracks refer to.
        point3D_ids: (N,) ids of the edge points in the written model.
        residuals: (T,) distances of observations from projections, pixels.
        path: file to write.

    Raises:
        ColmapEdgesError: if the file cannot be written, or arguments do not belong together.
    """
    edges.check("edges", len(model.views))
    curves.check("curves", edges)
    check_shape("point3D_ids", point3D_ids.shape, ("N",), {"N": edges.num_points})
    check_shape("residuals", residuals.shape, ("T",), {"T": len(edges.observations.views)})
    parts = {
        "edges": edge_records(edges, model, point3D_ids, residuals),
        "nodes": node_records(edges, model, point3D_ids),
        "curves": curve_records(curves, edges.edge_offsets),
    }
    encode = json.JSONEncoder(separators=(",", ":")).encode
    lists = (
        f'"{name}": [\n' + ",\n".join(map(encode, records)) + "\n]"
        for name, records in parts.items()
    )
    write_whole(path, ("{" + ",\n".join(lists) + "}\n").encode(), "edges")


def edge_records(
    edges: Edges3D,
    model: Model,
    point3D_ids: IntArray,
    residuals: FloatArray,
) -> list[dict[str, Any]]:
    """One mapping per edge: id, point3D ids, closed, length, views, residual, end nodes, sigmas."""
    image_ids = np.array([view.image_id for view in model.views], np.int64)
    lengths = edges.lengths()
    records = []
    for edge in range(edges.num_edges):
        first, last = edges.edge_offsets[edge : edge + 2]
        rows = slice(edges.observations.offsets[first], edges.observations.offsets[last])
        views = np.unique(edges.observations.views[rows])
        records.append(
            {
                "id": edge,
                "point3D_ids": point3D_ids[first:last].tolist(),
                "closed": bool(edges.closed[edge]),
                "length": float(lengths[edge]),
                "num_views": len(views),
                "image_ids": image_ids[views].tolist(),
                "residual_px": finite(residuals[rows].mean()) if len(views) else None,
                "end_nodes": edges.end_nodes[edge].tolist(),
                "sigmas": [short(sigma) for sigma in edges.sigmas[first:last].tolist()],
            }
        )
    return records


def node_records(edges: Edges3D, model: Model, point3D_ids: IntArray) -> list[dict[str, Any]]:
    """One mapping per node: id, point3D id, position, deviation, views, ends, edge through.

    An end is an edge's id with 0 for its first and 1 for its last point. The edge passing through
    is given by its id and the index of the node among its points.
    """
    nodes, node_ids = edges.nodes, edges.node_ids
    image_ids = np.array([view.image_id for view in model.views], np.int64)
    ids = np.full(len(nodes.points), -1, np.int64)
    ids[node_ids[node_ids >= 0]] = point3D_ids[node_ids >= 0]
    met = edges.end_nodes.ravel()
    order = np.argsort(met, kind="stable")
    bounds = np.searchsorted(met[order], np.arange(len(ids) + 1))
    records = []
    for node, through in enumerate(nodes.through_points.tolist()):
        ends = order[bounds[node] : bounds[node + 1]]
        rows = slice(*nodes.observations.offsets[node : node + 2])
        edge = int(np.searchsorted(edges.edge_offsets, through, "right")) - 1
        passing = [edge, through - int(edges.edge_offsets[edge])]
        records.append(
            {
                "id": node,
                "point3D_id": int(ids[node]),
                "xyz": nodes.points[node].tolist(),
                "sigma": float(nodes.sigmas[node]),
                "image_ids": np.unique(image_ids[nodes.observations.views[rows]]).tolist(),
                "ends": [[int(end) // 2, int(end) % 2] for end in ends],
                "through": passing if through >= 0 else None,
            }
        )
    return records


def finite(value: float) -> float | None:
    """`value` rounded to 1e-6; None if it is not finite."""
    return round(float(value), 6) if np.isfinite(value) else None


def short(value: float) -> float | None:
    """`value` to three digits; None if it is not finite."""
    return float(f"{value:.3g}") if np.isfinite(value) else None


def load_edges(run_path: Path, model: Model) -> Edges3D:
    """Read the edges of an output folder, their views being those of `model`.

    Args:
        run_path: Folder with edges.json and sparse/.
        model: A model with views of the same names.

    Raises:
        ColmapEdgesError: A file is missing or they do not fit together.
    """
    return edges_of_run(run_path, model, load_model(run_path / "sparse"))[0]


def edges_of_run(
    run_path: Path, model: Model, written: Model
) -> tuple[Edges3D, IntArray, list[Any] | None]:
    """The edges of an output folder, ids of their points, and the records of curves if any.

    Args:
        run_path: the folder.
        model: whose views observations are to name.
        written: the model in the folder.

    Raises:
        ColmapEdgesError: they do not fit together.
    """
    try:
        content = json.loads(read_text(run_path / "edges.json"))
        records = content["edges"]
        ids = [np.array(record["point3D_ids"], dtype=np.int64) for record in records]
        lengths = np.array([len(i) for i in ids], np.int64)
        every = np.concatenate([*ids, np.empty(0, np.int64)])
        rows = np.searchsorted(written.point3D_ids, every)
        names = {view.name: index for index, view in enumerate(model.views)}
        views = np.array([names[view.name] for view in written.views], dtype=np.int32)
        offsets, sigmas = offsets_of(lengths), sigmas_of(records, lengths)
        nodes = read_nodes(content.get("nodes", []), written, views, offsets)
        edges = Edges3D(
            points=written.points3D_xyz[rows],
            edge_offsets=offsets,
            closed=np.array([record["closed"] for record in records], dtype=bool),
            observations=tracks_of(written, rows, views),
            sigmas=sigmas,
            end_nodes=np.array([r["end_nodes"] for r in records], dtype=np.int32).reshape(-1, 2),
            colors=written.points3D_rgb[rows],
            nodes=nodes,
        )
        return edges, every, content.get("curves")
    except (OSError, *DAMAGE) as error:
        raise ColmapEdgesError(f"{run_path} holds no edges that fit its model: {error}") from error


def read_nodes(
    records: list[dict[str, Any]], written: Model, views: Int32Array, edge_offsets: IntArray
) -> Nodes:
    """The nodes of edges.json, with positions and tracks from the written model."""
    ids = np.array([record["point3D_id"] for record in records], np.int64)
    rows = np.searchsorted(written.point3D_ids, ids)
    through = [record["through"] for record in records]
    points = [edge_offsets[each[0]] + each[1] if each else -1 for each in through]
    return Nodes(
        points=written.points3D_xyz[rows],
        sigmas=np.array([record["sigma"] for record in records], np.float64),
        observations=tracks_of(written, rows, views),
        colors=written.points3D_rgb[rows],
        through_points=np.array(points, np.int64),
    )


def tracks_of(written: Model, rows: IntArray, views: Int32Array) -> Observations:
    """The tracks of some points of a model, with `views` as the index of each of its images."""
    taken = entries_of(written.track_offsets, rows)
    return Observations.of_pixels(
        offsets=offsets_of(np.diff(written.track_offsets)[rows]),
        views=views[written.track_views[taken]],
        pixels=written.track_points2D[taken],
    )


def sigmas_of(records: list[dict[str, Any]], lengths: IntArray) -> FloatArray:
    """(N,) standard deviations of the points of (E,) records; NaN if missing."""
    parts = [
        np.array(record.get("sigmas", [None] * length), np.float64)
        for record, length in zip(records, lengths.tolist(), strict=True)
    ]
    sigmas = np.concatenate([*parts, np.empty(0)])
    if len(sigmas) != lengths.sum():
        raise ValueError("an edge has deviations of another number of points")
    return sigmas
