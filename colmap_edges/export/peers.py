"""Readers of results of Line3D++, LIMAP and EdgeGraph3D as 3D edges (paper: table 2)."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.limap import read_limap1, read_limap1_track, read_limap2
from colmap_edges.export.lines import Line, sample_lines
from colmap_edges.runtime.input_files import DAMAGE, read_text


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
            f"{path} holds no edges.json and no lines of LIMAP; give the output folder of a run, "
            "such as WORKSPACE/edges"
        )
    if path.suffix == ".obj":
        return read_obj(path)
    first = read_text(path).split("\n", 1)[0].split()
    return read_limap1(path) if len(first) == 1 else read_line3dpp(path)


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
