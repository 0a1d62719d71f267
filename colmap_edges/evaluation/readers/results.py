"""The edges of an output folder, read back."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.core.arrays import Int32Array, IntArray, entries_of, offsets_of
from colmap_edges.core.edges3d import Edges3D, Nodes
from colmap_edges.core.observations import Observations
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.readers.peers import DAMAGE
from colmap_edges.runtime.input_files import read_text


def load_edges(run_path: Path, model: Model) -> Edges3D:
    """Read the edges of an output folder, their views being those of `model`.

    Args:
        run_path: Folder with edges.json and sparse/.
        model: A model with views of the same names.

    Raises:
        ColmapEdgesError: A file is missing or they do not fit together.
    """
    path = run_path / "edges.json"
    try:
        document = json.loads(read_text(path))
        records = document["edges"]
        written = load_model(run_path / "sparse")
        ids = [np.array(record["point3D_ids"], dtype=np.int64) for record in records]
        rows = np.searchsorted(written.point3D_ids, np.concatenate([*ids, np.empty(0, np.int64)]))
        names = {view.name: index for index, view in enumerate(model.views)}
        views = np.array([names[view.name] for view in written.views], dtype=np.int32)
        offsets = offsets_of(np.array([len(i) for i in ids], np.int64))
        nodes = read_nodes(document.get("nodes", []), written, views, offsets)
    except (OSError, *DAMAGE) as error:
        raise ColmapEdgesError(f"{run_path} holds no edges that fit its model: {error}") from error
    return Edges3D(
        points=written.points3D_xyz[rows],
        edge_offsets=offsets,
        closed=np.array([record["closed"] for record in records], dtype=bool),
        observations=tracks_of(written, rows, views),
        sigmas=np.full(len(rows), np.nan),
        end_nodes=np.array([r["end_nodes"] for r in records], dtype=np.int32).reshape(-1, 2),
        colors=written.points3D_rgb[rows],
        nodes=nodes,
    )


def read_nodes(
    records: list[dict[str, Any]], written: Model, views: Int32Array, edge_offsets: IntArray
) -> Nodes:
    """The nodes of edges.json, with what the written model tells of them."""
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
    """The tracks of some points of a model, by views that are called so."""
    taken = entries_of(written.track_offsets, rows)
    return Observations.of_pixels(
        offsets=offsets_of(np.diff(written.track_offsets)[rows]),
        views=views[written.track_views[taken]],
        pixels=written.track_points2D[taken],
    )
