"""Input and output paths of a run, checked before work starts."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.runtime.output import check_apart, check_output_path


@dataclass(frozen=True, kw_only=True)
class Paths:
    """Absolute input and output paths of a run.

    Attributes:
        image_path: folder of the images; not needed for a mesh without edges.
        input_path: folder of the COLMAP model; the Python functions need none.
        output_path: output folder; the Python functions need none.
        mask_path: folder of masks named as in COLMAP, or one mask for all images; or None.
        edge_path: folder of edge images of another detector, used instead of EdgeDrawing; or None.
        cache_path: folder of cached results for later runs; or None.
        dense_path: COLMAP's dense workspace with fused.ply, which is meshed; or None.
        points: PLY file of a dense cloud, which is meshed; or None.
        visibility: COLMAP's visibility of these points (fused.ply.vis); or None.
    """

    image_path: Path | None = None
    input_path: Path = Path()
    output_path: Path = Path()
    mask_path: Path | None = None
    edge_path: Path | None = None
    cache_path: Path | None = None
    dense_path: Path | None = None
    points: Path | None = None
    visibility: Path | None = None

    @property
    def inputs(self) -> list[Path]:
        """The input paths, which must not contain the output."""
        return self.sources + ([self.cache_path] if self.cache_path else [])

    @property
    def sources(self) -> list[Path]:
        """The input paths that are only read, which must not contain the cache."""
        given = (self.image_path, self.input_path, self.mask_path, self.edge_path)
        clouds = (self.dense_path, self.points, self.visibility)
        return [path for path in (*given, *clouds) if path is not None]


def absolute(paths: Paths) -> Paths:
    """The paths made absolute; a link at the output is not resolved."""
    resolved = {name: path and Path(os.path.realpath(path)) for name, path in vars(paths).items()}
    output = paths.output_path
    if os.path.islink(output):  # noqa: PTH114 - False without permission
        resolved["output_path"] = Path(os.path.realpath(output.parent), output.name)
    return Paths(**resolved)


def check_paths(paths: Paths, overwrite: bool) -> None:
    """Check that the inputs are folders and that the output can be written."""
    for name in ("image_path", "input_path", "dense_path"):
        path = getattr(paths, name)
        if path and not path.is_dir():
            raise ColmapEdgesError(f"{name} {path} is not a folder; give an existing folder")
    for name in ("points", "visibility"):
        path = getattr(paths, name)
        if path and not path.is_file():
            raise ColmapEdgesError(f"{name} {path} is not a file; give an existing file")
    if paths.dense_path and (paths.points or paths.visibility):
        raise OptionError("dense_path and points are both given; give one of them")
    if paths.visibility and not paths.points:
        raise OptionError("visibility is given without points; give the cloud, too")
    if paths.cache_path:
        check_apart("cache_path", paths.cache_path, paths.sources)
    check_output_path(paths.output_path, paths.inputs, overwrite)


def image_folder(paths: Paths) -> Path:
    """The folder of the images.

    Raises:
        OptionError: if it is not given.
    """
    if paths.image_path is None:
        raise OptionError(
            "image_path is not given; give it (only a mesh without edges needs no images)"
        )
    return paths.image_path
