"""Locations of images and sparse model in COLMAP's workspace folders."""

from __future__ import annotations

import struct
from pathlib import Path

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import open_file


def find_images(workspace: Path) -> Path:
    """The folder of the images in a workspace.

    Raises:
        ColmapEdgesError: when there is none.
    """
    images = workspace / "images"
    if not images.is_dir():
        raise ColmapEdgesError(f"workspace {workspace} has no folder images; give --image_path")
    return images


def is_model(folder: Path) -> bool:
    """Whether a folder holds a COLMAP model's files."""
    return any((folder / name).is_file() for name in ("cameras.bin", "cameras.txt"))


def find_model(workspace: Path) -> Path:
    """The sparse model of a workspace with the most images.

    Of equal ones, that in sparse/0, or in sparse (as written by undistortion), or else the first of
    the other models in sparse.

    Raises:
        ColmapEdgesError: when there is none.
    """
    sparse = workspace / "sparse"
    models = numbered_models(sparse)
    if is_model(sparse):
        models.insert(1 if sparse / "0" in models else 0, sparse)
    if not models and (numbered_models(workspace) or is_model(workspace)):
        raise ColmapEdgesError(
            f"workspace {workspace} is a folder of models; give the folder above it, which holds "
            "images and sparse, or --image_path and --input_path"
        )
    if not models:
        raise ColmapEdgesError(
            f"workspace {workspace} has no model in sparse/0 or sparse; run `colmap mapper` first, "
            "or give --input_path"
        )
    return max(models, key=num_images) if len(models) > 1 else models[0]


def numbered_models(folder: Path) -> list[Path]:
    """The models that `colmap mapper` has written to a folder, by number."""
    found = [path for path in folder.glob("*") if path.name.isdecimal() and is_model(path)]
    return sorted(found, key=lambda path: int(path.name))


def other_models(model: Path) -> dict[str, int]:
    """Numbers of images of the other models beside that of a folder, by the folders' names."""
    if not model.name.isdecimal():
        return {}
    others = [path for path in numbered_models(model.parent) if path.name != model.name]
    return {path.name: num_images(path) for path in others}


def num_images(model: Path) -> int:
    """Number of images of the model in a folder; 0 if it cannot be read."""
    from colmap_edges.colmap.binary_files import COUNT  # heavy imports, after parsing flags
    from colmap_edges.colmap.text_files import is_pose
    from colmap_edges.colmap.text_lines import lines_of

    try:
        if (model / "images.bin").is_file():
            with open_file(model / "images.bin") as file:
                return int(COUNT.unpack(file.read(COUNT.size))[0])
        return sum(is_pose(line.words) for line in lines_of(model / "images.txt"))
    except (ColmapEdgesError, OSError, struct.error):
        return 0
