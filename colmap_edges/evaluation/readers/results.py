"""The edges of an output folder, read back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from colmap_edges.colmap.model import Model, load_model
from colmap_edges.core.arrays import entries_of, offsets_of
from colmap_edges.core.edges3d import Edges3D
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
        records = json.loads(read_text(path))["edges"]
        written = load_model(run_path / "sparse")
        ids = [np.array(record["point3D_ids"], dtype=np.int64) for record in records]
        rows = np.searchsorted(written.point3D_ids, np.concatenate([*ids, np.empty(0, np.int64)]))
        names = {view.name: index for index, view in enumerate(model.views)}
        views = np.array([names[view.name] for view in written.views], dtype=np.int32)
        counts = np.diff(written.track_offsets)[rows]
    except (OSError, *DAMAGE) as error:
        raise ColmapEdgesError(f"{run_path} holds no edges that fit its model: {error}") from error
    taken = entries_of(written.track_offsets, rows)
    return Edges3D(
        points=written.points3D_xyz[rows],
        edge_offsets=offsets_of(np.array([len(i) for i in ids], np.int64)),
        closed=np.array([record["closed"] for record in records], dtype=bool),
        observations=Observations.of_pixels(
            offsets=offsets_of(counts),
            views=views[written.track_views[taken]],
            pixels=written.track_points2D[taken],
        ),
        sigmas=np.full(len(rows), np.nan),
        end_nodes=np.array([r["end_nodes"] for r in records], dtype=np.int32).reshape(-1, 2),
        colors=written.points3D_rgb[rows],
    )
