"""Writing and reading of planar and round faces as faces.json."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import DAMAGE, read_text
from colmap_edges.runtime.output import write_whole
from colmap_edges.surfaces.faces.outlines import Face
from colmap_edges.surfaces.round_face import KINDS, RoundFace


def write_faces(
    faces: Sequence[Face],
    model: Model,
    path: Path,
    *,
    in_mesh: bool = False,
    round_faces: Sequence[RoundFace] = (),
) -> None:
    """Write faces as JSON, atomically.

    Args:
        faces: the faces.
        model: whose views they are seen in.
        path: the file.
        in_mesh: whether points on them were added to the mesh.
        round_faces: faces of revolution.

    Raises:
        ColmapEdgesError: if the file cannot be written.
    """
    records = {
        "faces": [record_of(face, model) | {"in_mesh": in_mesh} for face in faces],
        "round_faces": [record_of_round(face, model) for face in round_faces],
    }
    write_whole(path, json.dumps(records, allow_nan=False).encode(), "faces")


def record_of(face: Face, model: Model) -> dict[str, Any]:
    """The entry of a face in faces.json, with COLMAP's image ids."""
    return {
        "plane": face.plane,
        "normal": [float(x) for x in face.normal],
        "offset": face.offset,
        "area": face.area,
        "image_ids": [model.views[view].image_id for view in face.views.tolist()],
        "outline": face.outline.tolist(),
        "holes": [hole.tolist() for hole in face.holes],
    }


def record_of_round(face: RoundFace, model: Model) -> dict[str, Any]:
    """The entry of a face of revolution in faces.json, with COLMAP's image ids."""
    return {
        "kind": face.kind,
        "point": face.point.tolist(),
        "direction": face.direction.tolist(),
        "profile": face.profile.tolist(),
        "image_ids": [model.views[view].image_id for view in face.views.tolist()],
    }


def read_faces(path: Path, model: Model) -> tuple[list[Face], list[RoundFace]]:
    """Read faces.json.

    Args:
        path: the file.
        model: whose views the faces' views are, by their image_id.

    Raises:
        ColmapEdgesError: it cannot be read, is damaged, or names images that the model has not.
    """
    indices = {view.image_id: index for index, view in enumerate(model.views)}
    try:
        records = json.loads(read_text(path))
        faces = [face_of(record, indices) for record in records["faces"]]
        # Files of earlier versions have none.
        return faces, [round_of(record, indices) for record in records.get("round_faces", [])]
    except (OSError, *DAMAGE) as error:
        raise ColmapEdgesError(f"{path} holds no faces of its model: {error}") from error


def face_of(record: dict[str, Any], indices: dict[int, int]) -> Face:
    """The face of a record of faces.json; `indices` maps image ids to views."""
    return Face(
        plane=int(record["plane"]),
        normal=np.array(record["normal"], np.float64).reshape(3),
        offset=float(record["offset"]),
        area=float(record["area"]),
        views=np.array([indices[image_id] for image_id in record["image_ids"]], np.int64),
        outline=np.array(record["outline"], np.float64).reshape(-1, 3),
        holes=tuple(np.array(hole, np.float64).reshape(-1, 3) for hole in record["holes"]),
    )


def round_of(record: dict[str, Any], indices: dict[int, int]) -> RoundFace:
    """The face of revolution of a record of faces.json; `indices` maps image ids to views."""
    return RoundFace(
        kind=KINDS[KINDS.index(record["kind"])],
        point=np.array(record["point"], np.float64).reshape(3),
        direction=np.array(record["direction"], np.float64).reshape(3),
        profile=np.array(record["profile"], np.float64).reshape(-1, 2),
        views=np.array([indices[image_id] for image_id in record["image_ids"]], np.int64),
    )
