"""3D lines in LIMAP's formats: curves written as the folder `structures`, and lines read."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import colmap_edges
from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, IntArray
from colmap_edges.core.checks import checked
from colmap_edges.core.curves3d import LINE, Curves3D
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import unit
from colmap_edges.export.lines import Line
from colmap_edges.runtime.input_files import read_bytes, read_text
from colmap_edges.runtime.output import new_folder, write_whole
from colmap_edges.runtime.ownership import PROGRAM, STRUCTURES


@checked
def write_structures(
    edges: Edges3D, curves: Curves3D, model: Model, folder: Path, *, overwrite: bool = False
) -> int:
    """Write LIMAP 2.0's `structures`: lines with 2D segments; bent curves as chords.

    Lines observed by fewer than two views are left out. The folder appears complete, or not at all.
    A record in it names its files, so that only those are ever replaced.

    Args:
        edges: the edges.
        curves: the curves that they consist of.
        model: the model whose views observations refer to; LIMAP needs it next to the folder.
        folder: output folder, made here.
        overwrite: replace an earlier output of this function.

    Returns:
        The number of lines.

    Raises:
        ColmapEdgesError: if the folder cannot be made or must not be replaced.
    """
    edges.check("edges", len(model.views))
    curves.check("curves", edges)
    lines = [line for line in straight_lines(edges, curves, model) if len(line.image_ids) > 1]
    detections: dict[int, list[bytes]] = {view.image_id: [] for view in model.views}
    content = [struct.pack("<Q", len(lines))]
    for index, line in enumerate(lines):
        content.append(struct.pack("<Q6dQ", index, *line.segments.ravel(), len(line.image_ids)))
        for image_id, ends in zip(line.image_ids.tolist(), line.ends2D, strict=True):
            content.append(struct.pack("<2I", image_id, len(detections[image_id])))
            # LIMAP's score of 2D segments of detectors without scores is 1.
            detections[image_id].append(struct.pack("<5dQ", *ends.ravel(), 1.0, index))
        content.append(struct.pack("<d", line.sigma if np.isfinite(line.sigma) else 0.0))
    files = {"lines3D.bin": b"".join(content)}
    content = [struct.pack("<Q", len(detections))]
    for image_id, found in detections.items():
        num_points = model.reconstruction.images[image_id].num_points2D()
        content += [struct.pack("<2IQ", image_id, num_points, len(found)), *found]
        content.append(struct.pack("<2Q", 0, 0))  # no groups and no links
    files["structures2d.bin"] = b"".join(content)
    for name in ("groups3D.bin", "wireframe3D.bin"):  # required by LIMAP
        files[name] = struct.pack("<Q", 0)
    record: dict[str, Any] = {"versions": {PROGRAM: colmap_edges.__version__}}
    record["files"] = {name: len(data) for name, data in files.items()}
    files[STRUCTURES.record] = f"{json.dumps(record, indent=2)}\n".encode()
    with new_folder(folder, STRUCTURES, overwrite) as new:
        for name, data in files.items():
            write_whole(new / name, data, "lines")
    return len(lines)


def straight_lines(edges: Edges3D, curves: Curves3D, model: Model) -> list[Line]:
    """Lines, and chords of all other curves."""
    image_ids = np.array([view.image_id for view in model.views], np.int64)
    found = []
    for curve in range(curves.num_curves):
        first, end = curves.ranges[curve].tolist()
        count = min(chords_of(curves, curve), max(1, (end - first) // 2))
        places = np.linspace(0, 1, count + 1)
        points = curves.at(np.full(count + 1, curve), places)
        start = int(edges.edge_offsets[curves.edges[curve]])
        size = int(edges.edge_offsets[curves.edges[curve] + 1]) - start
        rows = start + (np.arange(first, end) - start) % size
        parts = np.minimum((np.linspace(0, 1, len(rows)) * count).astype(np.int64), count - 1)
        for part in range(count):
            chosen = rows[parts == part]
            views, ends2D = observed_segments(edges, chosen)
            sigma = float(np.median(edges.sigmas[chosen])) if len(chosen) else np.nan
            ends = points[None, part : part + 2]
            found.append(
                Line(segments=ends, image_ids=image_ids[views], ends2D=ends2D, sigma=sigma)
            )
    return found


def chords_of(curves: Curves3D, curve: int) -> int:
    """Number of chords of a curve: one per 10 degrees of its turn."""
    if curves.kinds[curve] == LINE:
        return 1
    points = curves.at(np.full(65, curve), np.linspace(0, 1, 65))
    steps = unit(np.diff(points, axis=0))
    cosines = np.clip(np.einsum("ij,ij->i", steps[1:], steps[:-1]), -1, 1)
    turn = np.degrees(np.arccos(cosines).sum())
    return max(1, int(np.ceil(turn / 10.0)))


def observed_segments(edges: Edges3D, rows: IntArray) -> tuple[IntArray, FloatArray]:
    """Views that observe at least two of (n,) edge points, with the first and last pixel."""
    observations = edges.observations.select(rows)
    views = observations.views
    order = np.argsort(views, kind="stable")
    present, firsts, counts = np.unique(views[order], return_index=True, return_counts=True)
    several = counts > 1
    first, last = order[firsts[several]], order[(firsts + counts - 1)[several]]
    segments = np.stack([observations.pixels[first], observations.pixels[last]], axis=1)
    return present[several].astype(np.int64), segments


def read_limap1(path: Path) -> list[Line]:
    """Read LIMAP 1.x's `alltracks.txt`: id and counts, two ends, image ids, line ids a track."""
    rows = [row.split() for row in read_text(path).splitlines() if row.strip()]
    count = int(rows[0][0])
    lines = []
    for track in range(count):
        _, start, end, images, _ = rows[1 + 5 * track : 6 + 5 * track]
        lines.append(_line([*start, *end], [int(word) for word in images]))
    return lines


def read_limap1_track(path: Path) -> Line:
    """Read one `track_N.txt` of LIMAP 1.x."""
    rows = [row.split() for row in read_text(path).splitlines()]
    count = int(rows[1][0])
    images = [int(word) for word in rows[2][1:]]
    if rows[2][0] != "image_id_list" or len(images) != count:
        raise ValueError("no image_id_list of the stated length")
    ends = None
    if len(rows) > 4 and rows[4][:1] == ["line2d_list"]:
        ends = np.array(rows[5 : 5 + count], dtype=np.float64).reshape(-1, 2, 2)
    return _line(rows[0], images, ends)


def _line(ends: Sequence[Any], image_ids: list[int], ends2D: FloatArray | None = None) -> Line:
    return Line(
        segments=np.array(ends, dtype=np.float64).reshape(1, 2, 3),
        image_ids=np.array(image_ids, dtype=np.int64),
        ends2D=np.full((len(image_ids), 2, 2), np.nan) if ends2D is None else ends2D,
    )


def read_limap2(folder: Path) -> list[Line]:
    """Read `lines3D.bin` of LIMAP 2.0, and the 2D segments of `structures2d.bin` when there."""
    reader = _Reader(read_bytes(folder / "lines3D.bin"))
    rows = []
    for _ in range(reader.count()):
        reader.count()  # id of the line
        ends = reader.array("<f8", 6)
        track = reader.array("<u4", 2 * reader.count()).reshape(-1, 2).astype(np.int64)
        reader.array("<f8", 1)  # uncertainty
        rows.append((ends, track))
    detections = {}
    if (folder / "structures2d.bin").is_file():
        detections = read_limap2_detections(folder / "structures2d.bin")
    lines = []
    for ends, track in rows:
        ends2D = np.full((len(track), 2, 2), np.nan)
        for row, (image_id, line2D) in enumerate(track.tolist()):
            if image_id in detections:
                ends2D[row] = detections[image_id][line2D]
        lines.append(_line(ends.tolist(), track[:, 0].tolist(), ends2D))
    return lines


def read_limap2_detections(path: Path) -> dict[int, FloatArray]:
    """2D segments (L, 2, 2) by image id, of LIMAP 2.0's `structures2d.bin`."""
    reader = _Reader(read_bytes(path))
    segment = np.dtype([("ends", "<f8", (2, 2)), ("score", "<f8"), ("line", "<u8")])
    detections = {}
    for _ in range(reader.count()):
        image_id = int(reader.array("<u4", 2)[0])  # the second is the number of points
        detections[image_id] = reader.array(segment, reader.count())["ends"].astype(np.float64)
        for _ in range(reader.count()):  # groups of points and lines: type, two lists, id
            reader.array("<i4", 1)
            for _ in range(2):
                reader.array(np.dtype([("index", "<u4"), ("weight", "<f8")]), reader.count())
            reader.count()
        reader.array(np.dtype([("ends", "<u4", 2), ("weight", "<f8")]), reader.count())
    return detections


class _Reader:
    """Little-endian values one after the other; ValueError at the end of the data."""

    def __init__(self, content: bytes) -> None:
        self._content, self._position = content, 0

    def array(self, dtype: Any, count: int) -> NDArray[Any]:
        size = np.dtype(dtype).itemsize * count
        if self._position + size > len(self._content):
            raise ValueError("the file is cut short")
        values = np.frombuffer(self._content, dtype, count, self._position)
        self._position += size
        return values

    def count(self) -> int:
        return int(self.array("<u8", 1)[0])
