"""Reader of the edges of an output folder, or of LIMAP, with nodes, curves and faces."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.colmap.workspace import find_model, is_model
from colmap_edges.core.arrays import IntArray
from colmap_edges.core.checks import checked
from colmap_edges.core.curves3d import Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export import peers
from colmap_edges.export.curve_records import curves_of_records
from colmap_edges.export.edges_json import edges_of_run
from colmap_edges.export.faces import read_faces
from colmap_edges.runtime.input_files import DAMAGE
from colmap_edges.surfaces.faces.outlines import Face
from colmap_edges.surfaces.round_face import RoundFace

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
        round_faces: faces of revolution, likewise.
    """

    edges: Edges3D
    curves: Curves3D
    point3D_ids: IntArray
    model: Model
    faces: list[Face]
    round_faces: list[RoundFace]


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
        has_faces = (path / FACES).is_file()
        faces, round_faces = read_faces(path / FACES, model) if has_faces else ([], [])
        return WrittenEdges(
            edges=edges,
            curves=curves,
            point3D_ids=ids,
            model=model,
            faces=faces,
            round_faces=round_faces,
        )
    model = load_model(Path(model_path) if model_path else model_beside(path))
    edges = peers.load(path, model)
    unknown = np.full(edges.num_points, -1, np.int64)
    curves = fit_curves(edges)
    return WrittenEdges(
        edges=edges, curves=curves, point3D_ids=unknown, model=model, faces=[], round_faces=[]
    )


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
        f"{path} holds no edges.json; give the output folder of a run, such as WORKSPACE/edges (or "
        "model_path, the COLMAP model of LIMAP's lines)"
    )
