"""Where a run reads and writes, checked before work starts."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.runtime.output import check_output_path


@dataclass(frozen=True, kw_only=True)
class Paths:
    """Where a run reads and writes, absolute.

    Attributes:
        image_path: folder of the images; a mesh without edges needs none.
        input_path: folder of the COLMAP model.
        output_path: folder to make.
        mask_path: folder of masks named as COLMAP's are, or one mask of all images.
        edge_path: folder of edge images of another detector, in place of EdgeDrawing's edges.
        cache_path: folder of results that later runs find again; none are kept without it.
    """

    image_path: Path | None = None
    input_path: Path
    output_path: Path
    mask_path: Path | None = None
    edge_path: Path | None = None
    cache_path: Path | None = None

    @property
    def inputs(self) -> list[Path]:
        """The paths that no output may be in."""
        given = (
            self.image_path,
            self.input_path,
            self.mask_path,
            self.edge_path,
            self.cache_path,
        )
        return [path for path in given if path is not None]


def absolute(paths: Paths) -> Paths:
    """The same paths from the root on; a link at the output, which is not followed, stays."""
    resolved = {name: path and Path(os.path.realpath(path)) for name, path in vars(paths).items()}
    output = paths.output_path
    if os.path.islink(output):  # noqa: PTH114 - False where one may not look
        resolved["output_path"] = Path(os.path.realpath(output.parent), output.name)
    return Paths(**resolved)


def check_paths(paths: Paths, overwrite: bool) -> None:
    """Check that the inputs are folders and the output can be made."""
    for name in ("image_path", "input_path"):
        path = getattr(paths, name)
        if path and not path.is_dir():
            raise ColmapEdgesError(f"{name} {path} is no folder")
    check_output_path(paths.output_path, paths.inputs, overwrite)


def image_folder(paths: Paths) -> Path:
    """The folder of the images.

    Raises:
        OptionError: when it is not given.
    """
    if paths.image_path is None:
        raise OptionError("image_path is not given; only a mesh without edges needs no images")
    return paths.image_path
