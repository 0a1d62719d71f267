"""COLMAP's workspace folders: where the images and the sparse model are."""

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


def find_model(workspace: Path) -> Path:
    """The sparse model of a workspace: in sparse/0, or in sparse as undistortion writes it.

    Raises:
        ColmapEdgesError: when there is none.
    """
    sparse = workspace / "sparse"
    for folder in (sparse / "0", sparse):
        if any((folder / name).is_file() for name in MODEL_FILES):
            others = [path.name for path in sparse.glob("[1-9]*") if path.is_dir()]
            if others:
                logger.warning("%s is used; sparse has %d more models", folder, len(others))
            return folder
    raise ColmapEdgesError(
        f"workspace {workspace} has no model in sparse/0 or sparse; run `colmap mapper` first, "
        "or give --input_path"
    )
