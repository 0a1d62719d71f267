"""Locations of images and sparse model in COLMAP's workspace folders."""

from __future__ import annotations

import logging
from pathlib import Path

from colmap_edges.errors import ColmapEdgesError

logger = logging.getLogger(__name__)

MODEL_FILES = ("cameras.bin", "cameras.txt")


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
    return any((folder / name).is_file() for name in MODEL_FILES)


def find_model(workspace: Path) -> Path:
    """The sparse model of a workspace.

    The model in sparse/0, or in sparse (as written by undistortion), or else the first of the other
    models in sparse.

    Raises:
        ColmapEdgesError: when there is none.
    """
    sparse = workspace / "sparse"
    numbered = [path for path in sparse.glob("*") if path.name.isdecimal() and is_model(path)]
    numbered.sort(key=lambda path: int(path.name))
    first = sparse / "0"
    models = ([sparse] if is_model(sparse) else []) + numbered
    if first in models:
        models.insert(0, models.pop(models.index(first)))
    if not models:
        raise ColmapEdgesError(
            f"workspace {workspace} has no model in sparse/0 or sparse; run `colmap mapper` first, "
            "or give --input_path"
        )
    others = ", ".join(path.name for path in models[1:] if path != sparse)
    if others:
        logger.warning("%s is used; more models are in %s: %s", models[0], sparse, others)
    return models[0]
