"""Reader of the edges of an output folder, or of LIMAP, with nodes, curves and faces."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.colmap.workspace import find_model, is_model
from colmap_edges.core.arrays import FloatArray, Int32Array, IntArray, entries_of, offsets_of
from colmap_edges.core.checks import checked
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D, Nodes
from colmap_edges.core.observations import Observations
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.readers import peers
from colmap_edges.evaluation.readers.peers import DAMAGE
from colmap_edges.export.curve_records import curves_of_records
from colmap_edges.export.faces import read_faces
from colmap_edges.runtime.input_files import read_text
from colmap_edges.surfaces.faces.outlines import Face

FACES = "faces.json"


@dataclass(frozen=True, kw_only=True)
class WrittenEdges:
    """The result of `read_edges`.

    Attributes:
        edges: the edges, with tracks and nodes; observations have views and pixels.
        curves: the lines, arcs, circles, ellipses and splines that they consist of.
        point3D_ids: (N,) int64 ids of the edge points in the model; -1 for LIMAP's lines.
        model: the model with the edge points, to whose views observations refer by index.
        faces: planar faces between the edges, unless `use_faces` was 0.
    """

    edges: Edges3D
    curves: Curves3D
    point3D_ids: IntArray
    model: Model
    faces: list[Face]


@checked
def read_edges(path: Path | str, model_path: Path | str | None = None) -> WrittenEdges:
    """Read back the edges of an output folder, or the lines of LIMAP.

    Args:
        path: an output folder of `reconstruct` or `mesh`; or LIMAP's output: the folder that holds
            `structures`, that folder, `alltracks.txt`, or the folder of it or of `track_*.txt`.
        model_path: COLMAP model that LIMAP's lines were made from; not needed when it lies in the
            folder or in `sparse` there.

    Returns:
        Points, tracks, nodes, curves, faces. Curves of early outputs and of LIMAP are
            fitted when read.

    Raises:
        ColmapEdgesError: there are no edges, or files are missing or inconsistent.
    """
    path = Path(path)
    if (path / "edges.json").is_file():
        model = load_model(path / "sparse")
        edges, ids, records = edges_of_run(path, model, model)
        try:
            curves = curves_of_records(records, edges.edge_offsets) if records is not None else None
        except (AssertionError, *DAMAGE) as error:
            raise ColmapEdgesError(f"{path} holds invalid curves: {error}") from error
        curves = fit_curves(edges) if curves is None else curves
        faces = read_faces(path / FACES, model) if (path / FACES).is_file() else []
        return WrittenEdges(edges=edges, curves=curves, point3D_ids=ids, model=model, faces=faces)
    model = load_model(Path(model_path) if model_path else model_beside(path))
    edges = peers.load(path, model)
    unknown = np.full(edges.num_points, -1, np.int64)
    curves = fit_curves(edges)
    return WrittenEdges(edges=edges, curves=curves, point3D_ids=unknown, model=model, faces=[])


def model_beside(path: Path) -> Path:
    """The model in the folder of LIMAP's lines, or in its parent.

    Raises:
        ColmapEdgesError: there is none.
    """
    for folder in (path, path / "sparse", path.parent, path.parent / "sparse"):
        if is_model(folder):
            return folder
    if (path / "sparse").is_dir():
        return find_model(path)
    raise ColmapEdgesError(
        f"{path} holds no edges.json, and no COLMAP model for lines of LIMAP; give model_path"
    )


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
