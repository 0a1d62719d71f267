"""Planar faces as a file: faces.json."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from colmap_edges.colmap.model import Model
from colmap_edges.runtime.output import write_whole
from colmap_edges.surfaces.faces.outlines import Face


def write_faces(faces: Sequence[Face], model: Model, path: Path) -> None:
    """Write faces as JSON: the whole file or none.

    Raises:
        ColmapEdgesError: when the file cannot be written.
    """
    records = {"faces": [record_of(face, model) for face in faces]}
    write_whole(path, json.dumps(records, allow_nan=False).encode(), "faces")


def record_of(face: Face, model: Model) -> dict[str, Any]:
    """What faces.json tells of a face; its views by COLMAP's ids."""
    return {
        "plane": face.plane,
        "normal": [float(x) for x in face.normal],
        "offset": face.offset,
        "area": face.area,
        "image_ids": [model.views[view].image_id for view in face.views.tolist()],
        "outline": face.outline.tolist(),
        "holes": [hole.tolist() for hole in face.holes],
    }
