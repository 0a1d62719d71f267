"""The similarity transform that turns a run upright, scales it and puts its ground at zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.similarity import Similarity, to_z_up
from colmap_edges.core.upright import upward
from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.export.units import METRES
from colmap_edges.export.upright import direction
from colmap_edges.export.written import WrittenEdges
from colmap_edges.runtime.input_files import DAMAGE, read_json
from colmap_edges.surfaces.faces.outlines import Face
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.surfaces.round_face import moved_round

RECORD = "alignment.json"


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """The frame that a user asks for; what is None stays as it is.

    Attributes:
        up: axis of the model that points up, a key of `units.AXES`, or "auto".
        scale: factor of all lengths.
        edge_length: number of an edge, and the length that it gets.
        unit: unit of the new coordinates, a key of `METRES`.
        ground: whether the largest horizontal face gets to z = 0.
    """

    up: str | None = None
    scale: float | None = None
    edge_length: tuple[int, float] | None = None
    unit: str | None = None
    ground: bool = False

    @property
    def moves(self) -> bool:
        """Whether anything but the unit's name is asked for."""
        given = (self.up, self.scale, self.edge_length, self.unit)
        return self.ground or any(value is not None for value in given)


@dataclass(frozen=True, kw_only=True)
class Alignment:
    """A new frame and how it stands in the world.

    Attributes:
        aligned_from_model: transform from the frame of the run.
        up: (3,) upward direction in the new frame.
        unit: unit of its coordinates, a key of `METRES`, or empty if it is unknown.
    """

    aligned_from_model: Similarity
    up: FloatArray
    unit: str = ""


def alignment_of(written: WrittenEdges, wanted: Wanted, unit: str = "") -> Alignment:
    """The transform that gives a run the frame that is asked for.

    Args:
        written: the run.
        wanted: the frame.
        unit: the unit of the run's coordinates, if it is known.

    Raises:
        ColmapEdgesError: if there is no such edge or no ground.
    """
    scale = scale_of(written, wanted, unit)
    up, is_given = None, wanted.up not in (None, "auto")
    up = direction(wanted.up) if is_given else None
    if up is None:
        up = upward(written.model.views, written.curves)
    ground = ground_of(written.faces, up) if wanted.ground else None
    if ground and not is_given:
        up = ground.normal
    rotation, translation = np.eye(3), np.zeros(3)
    if wanted.up is not None or wanted.ground:
        rotation, up = to_z_up(up), np.array([0.0, 0.0, 1.0])
    if ground:
        height = float((rotation @ ground.outline.T)[2].mean()) if is_given else ground.offset
        translation = np.array([0.0, 0.0, -scale * height])
    moved = Similarity(scale=scale, rotation=rotation, translation=translation)
    kept = "" if wanted.scale is not None else unit
    return Alignment(aligned_from_model=moved, up=up, unit=wanted.unit or kept)


def scale_of(written: WrittenEdges, wanted: Wanted, unit: str) -> float:
    """The factor of all lengths.

    Raises:
        ColmapEdgesError: if there is no edge of that number, or it has no length.
    """
    if wanted.scale is not None and wanted.edge_length is not None:
        raise OptionError("scale and edge_length are both given; give one of them")
    if wanted.edge_length is not None:
        edge, length = wanted.edge_length
        lengths = written.edges.lengths()
        if not edge < len(lengths) or not lengths[edge] > 0:
            raise ColmapEdgesError(
                f"edge_length names edge {edge}, but there are edges 0 to {len(lengths) - 1}; "
                "report.html shows their numbers"
            )
        return length / float(lengths[edge])
    if wanted.scale is not None:
        return wanted.scale
    return METRES[unit] / METRES[wanted.unit] if unit and wanted.unit else 1.0


def ground_of(faces: Sequence[Face], up: FloatArray) -> Face:
    """The largest face of the plane with most area of faces that are level and seen from above.

    Raises:
        ColmapEdgesError: if there is none.
    """
    level = [face for face in faces if face.normal @ up > np.cos(np.radians(10.0))]
    if not level:
        raise ColmapEdgesError(
            "ground needs a horizontal face, and the output folder has none; run mesh with "
            "--use_faces 1, or name the upward axis by --up"
        )
    areas: dict[int, float] = {}
    for face in level:
        areas[face.plane] = areas.get(face.plane, 0.0) + face.area
    return max(level, key=lambda face: (areas[face.plane], face.area))


def aligned(written: WrittenEdges, moved: Similarity) -> WrittenEdges:
    """Edges, curves and faces in a new frame; the model stays as it is."""
    return replace(
        written,
        edges=moved.edges(written.edges),
        curves=moved.curves(written.curves),
        faces=[moved_face(face, moved) for face in written.faces],
        round_faces=[moved_round(face, moved) for face in written.round_faces],
    )


def moved_face(face: Face, moved: Similarity) -> Face:
    """A face in a new frame."""
    normal = moved.rotation @ face.normal
    return replace(
        face,
        normal=normal,
        offset=moved.scale * face.offset + float(normal @ moved.translation),
        area=moved.scale**2 * face.area,
        outline=moved.points(face.outline),
        holes=tuple(moved.points(hole) for hole in face.holes),
    )


def moved_mesh(mesh: Mesh, moved: Similarity) -> Mesh:
    """A mesh in a new frame."""
    return replace(mesh, vertices=moved.points(mesh.vertices))


def alignment_record(alignment: Alignment, earlier: dict[str, Any]) -> dict[str, Any]:
    """The content of alignment.json.

    Args:
        alignment: the alignment.
        earlier: that of the run, if it was aligned before.
    """
    moved = alignment.aligned_from_model
    if earlier:
        moved = moved.after(similarity_of(earlier))
    return {
        "unit": alignment.unit,
        "scale": moved.scale,
        "rotation": moved.rotation.tolist(),
        "translation": moved.translation.tolist(),
    }


def similarity_of(record: dict[str, Any]) -> Similarity:
    """The transform of alignment.json."""
    return Similarity(
        scale=float(record["scale"]),
        rotation=np.array(record["rotation"], float).reshape(3, 3),
        translation=np.array(record["translation"], float).reshape(3),
    )


def read_alignment(folder: Path) -> dict[str, Any]:
    """The content of a run's alignment.json; empty if it was never aligned.

    Raises:
        ColmapEdgesError: if the file is damaged.
    """
    path = folder / RECORD
    if not path.is_file():
        return {}
    record = read_json(path)
    try:
        similarity_of(record)
        if record["unit"] not in ("", *METRES):
            raise ValueError(f"unknown unit {record['unit']!r}")
    except DAMAGE as error:
        raise ColmapEdgesError(f"{path} is damaged: {error}; align again") from error
    return record
