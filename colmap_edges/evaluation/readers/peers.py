"""Readers of results of Line3D++, LIMAP and EdgeGraph3D as 3D edges (paper: table 2)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray, offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.readers.curves import Curves, load_curves
from colmap_edges.runtime.input_files import read_bytes, read_text

# Exceptions raised for damaged files.
DAMAGE = (
    ValueError,
    KeyError,
    IndexError,
    TypeError,
    AttributeError,
    OverflowError,
    RecursionError,
)


@dataclass(frozen=True, kw_only=True)
class Line:
    """One straight 3D line of another system.

    Attributes:
        segments: (S, 2, 3) its 3D segments, by their ends.
        image_ids: (O,) COLMAP ids of the images that see it.
        ends2D: (O, 2, 2) ends of the 2D segments seen there, pixels; NaN if the format holds
            none, in which case the whole line counts as seen.
    """

    segments: FloatArray
    image_ids: IntArray
    ends2D: FloatArray = field(default_factory=lambda: np.empty((0, 2, 2)))


def load(path: Path, model: Model, spacing_px: float = 4.0) -> Edges3D:
    """Read a result of another system, recognised by its path.

    Line3D++: `.txt`; LIMAP 2.0: the model folder or its `structures`; LIMAP 1.x: `alltracks.txt`,
    or the folder of it or of `track_*.txt`; EdgeGraph3D: openMVG `.json`.

    Args:
        path: File or folder of the result.
        model: The model it was made from: peers name images by its ids (openMVG: by file name).
        spacing_px: Distance between samples along lines, in pixels of the sharpest view.

    Raises:
        ColmapEdgesError: Nothing readable there, or it names images the model does not hold.
    """
    if not path.exists():
        raise ColmapEdgesError(f"{path} does not exist; give a result of a line reconstruction")
    try:
        if path.suffix == ".json":
            return read_openmvg(path, model)
        return sample_lines(read_lines(path), model, spacing_px)
    except DAMAGE as error:
        raise ColmapEdgesError(f"{path} is not a readable line reconstruction: {error}") from error


def read_lines(path: Path) -> list[Line]:
    """Read the lines of Line3D++ or LIMAP (see `load`)."""
    if path.is_dir():
        for folder in (path / "structures", path):
            if (folder / "lines3D.bin").is_file():
                return read_limap2(folder)
        tracks = sorted(path.glob("track_*.txt"), key=lambda p: (len(p.name), p.name))
        if tracks:
            return [read_limap1_track(track) for track in tracks]
        if (path / "alltracks.txt").is_file():
            return read_limap1(path / "alltracks.txt")
        raise ColmapEdgesError(
            f"{path} holds no lines: neither lines3D.bin, track_*.txt nor alltracks.txt"
        )
    if path.suffix == ".obj":
        return read_obj(path)
    first = read_text(path).split("\n", 1)[0].split()
    return read_limap1(path) if len(first) == 1 else read_line3dpp(path)


def read_curves(path: Path) -> Curves:
    """Read 3D edges as `readers.curves.load_curves` does, or the lines of Line3D++ or LIMAP.

    Raises:
        ColmapEdgesError: Nothing readable there.
    """
    if path.suffix in (".ply", ".npz"):
        return load_curves(path)
    if not path.exists():
        raise ColmapEdgesError(f"{path} does not exist; give a file of 3D edges")
    try:
        segments = np.concatenate([line.segments for line in read_lines(path)])
    except DAMAGE as error:
        raise ColmapEdgesError(f"{path} holds no readable lines: {error}") from error
    index = np.arange(2 * len(segments)).reshape(-1, 2)
    return Curves(points=segments.reshape(-1, 3), segments=index)


def read_line3dpp(path: Path) -> list[Line]:
    """Read Line3D++'s text: one 3D line a row, its 3D segments, then its 2D segments by camera."""
    lines = []
    for row in read_text(path).splitlines():
        values = np.array(row.split(), dtype=np.float64)
        if not len(values):
            continue
        count = int(values[0])
        segments = values[1 : 1 + 6 * count].reshape(count, 2, 3)
        seen = int(values[1 + 6 * count])
        residuals = values[2 + 6 * count :].reshape(seen, 6)
        ids = residuals[:, 0].astype(np.int64)
        lines.append(
            Line(segments=segments, image_ids=ids, ends2D=residuals[:, 2:].reshape(-1, 2, 2))
        )
    return lines


def read_obj(path: Path) -> list[Line]:
    """Read `l` elements of an OBJ; the format holds no visibility."""
    vertices, lines = [], []
    for row in read_text(path).splitlines():
        words = row.split()
        if words[:1] == ["v"]:
            vertices.append([float(word) for word in words[1:4]])
        elif words[:1] == ["l"]:
            ends = [int(word.split("/")[0]) for word in words[1:]]
            lines += list(pairwise(ends))
    points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    index = np.array(lines, dtype=np.int64).reshape(-1, 2)
    index = np.where(index > 0, index - 1, index + len(points))
    none = np.empty(0, dtype=np.int64)
    return [Line(segments=points[pair][None], image_ids=none) for pair in index]


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


def sample_lines(lines: Iterable[Line], model: Model, spacing_px: float = 4.0) -> Edges3D:
    """Points along every 3D segment, observed where their projections are on the 2D segment.

    A view does not observe points more than two pixels beyond the ends of its 2D segment. Points
    observed by fewer than two views are dropped; each remaining unbroken run becomes an edge.
    """
    views = {view.image_id: index for index, view in enumerate(model.views)}
    edges: list[_Run] = []
    for line in lines:
        missing = set(line.image_ids.tolist()) - set(views)
        if missing:
            raise ColmapEdgesError(
                f"a line is observed in image {min(missing)}, which is not in the model"
            )
        indices = np.array([views[i] for i in line.image_ids.tolist()], dtype=np.int32)
        for ends in line.segments:
            edges += _sample_segment(ends, indices, line.ends2D, model.views, spacing_px)
    return _as_edges(edges)


@dataclass(frozen=True)
class _Run:
    points: FloatArray  # (N, 3)
    seen: BoolArray  # (N, V)
    views: Int32Array  # (V,)
    pixels: FloatArray  # (N, V, 2)


def _sample_segment(
    ends: FloatArray,
    indices: Int32Array,
    ends2D: FloatArray,
    views: Sequence[View],
    spacing_px: float,
) -> list[_Run]:
    if not len(indices):
        return []
    projected = np.array([views[index].project(ends)[0] for index in indices])
    lengths = np.linalg.norm(projected[:, 1] - projected[:, 0], axis=1)
    if not np.isfinite(lengths).any():
        return []
    count = int(np.ceil(np.nanmax(lengths) / spacing_px)) + 1
    points = ends[0] + np.linspace(0, 1, max(count, 2))[:, None] * (ends[1] - ends[0])
    unique, columns = np.unique(indices, return_inverse=True)
    pixels = np.stack([views[index].project(points)[0] for index in unique], axis=1)
    seen = np.zeros((len(points), len(unique)), dtype=bool)
    for column, end2D in zip(columns, ends2D, strict=True):
        seen[:, column] |= _on_segment(pixels[:, column], end2D)
    kept = seen.sum(axis=1) >= 2
    breaks = np.flatnonzero(np.diff(np.concatenate([[False], kept, [False]]).astype(int)))
    runs = [slice(a, b) for a, b in breaks.reshape(-1, 2) if b - a >= 2]
    return [_Run(points[run], seen[run], unique, pixels[run]) for run in runs]


def _on_segment(pixels: FloatArray, ends: FloatArray, margin_px: float = 2.0) -> BoolArray:
    known = np.asarray(np.isfinite(pixels).all(axis=1))
    length = np.linalg.norm(ends[1] - ends[0])
    if not np.isfinite(length) or length == 0:
        return known
    along = (pixels - ends[0]) @ (ends[1] - ends[0]) / length
    return np.asarray(known & (along >= -margin_px) & (along <= length + margin_px))


def _as_edges(runs: list[_Run]) -> Edges3D:
    if not runs:
        return Edges3D.none()
    views = [np.broadcast_to(run.views, run.seen.shape)[run.seen] for run in runs]
    observations = Observations.of_pixels(
        offsets=offsets_of(np.concatenate([run.seen.sum(axis=1) for run in runs])),
        views=np.concatenate(views),
        pixels=np.concatenate([run.pixels[run.seen] for run in runs]),
    )
    lengths = np.array([len(run.points) for run in runs], np.int64)
    return Edges3D.of_polylines(np.concatenate([r.points for r in runs]), lengths, observations)


def read_openmvg(path: Path, model: Model) -> Edges3D:
    """Read the points of an openMVG `sfm_data` JSON (EdgeGraph3D's output), each as an edge.

    EdgeGraph3D appends its edge points to the SfM points without marking them: give a file without
    the SfM points, or mesh without the model's own points.
    """
    data = json.loads(read_text(path))
    names = {Path(view.name).stem: index for index, view in enumerate(model.views)}
    views = {}
    for entry in data["views"]:
        name = entry["value"]["ptr_wrapper"]["data"]["filename"]
        if Path(name).stem not in names:
            raise ColmapEdgesError(f"{path} is of image {name}, which is not in the model")
        views[int(entry["key"])] = names[Path(name).stem]
    points, counts, seen, pixels = [], [], [], []
    for entry in data["structure"]:
        observed = {int(o["key"]): o["value"]["x"] for o in entry["value"]["observations"]}
        points.append(entry["value"]["X"])
        counts.append(len(observed))
        seen += [views[key] for key in observed]
        pixels += list(observed.values())
    observations = Observations.of_pixels(
        offsets=offsets_of(np.array(counts, np.int64)),
        views=np.array(seen, np.int32),
        pixels=np.array(pixels, np.float64).reshape(-1, 2),
    )
    xyz = np.array(points, np.float64).reshape(-1, 3)
    return Edges3D.of_polylines(xyz, np.ones(len(xyz), np.int64), observations)
