"""Locating and reading edge images of another detector (white on black, or the reverse)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np

from colmap_edges.core.arrays import Float32Array
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.files import CompanionFile, first_existing, path_of_image


@dataclass(frozen=True)
class EdgeMap:
    """The edge strength of each pixel of an image.

    Attributes:
        strengths: (H, W) float32 from 0 (no edge) to 1.
        is_binary: whether there are only two strengths.
    """

    strengths: Float32Array
    is_binary: bool


def path_of_edge_map(edge_path: Path, name: str) -> Path | None:
    """Path of the edge image of the image `name` of a model; None if it has none.

    Args:
        edge_path: a folder, with the edge image of a/b.jpg in a/b.jpg.png or a/b.png.
        name: the image's name in the model.

    Raises:
        ColmapEdgesError: if the name leads out of the folder.
    """
    return first_existing(edge_path, (f"{name}.png", str(PurePosixPath(name).with_suffix(".png"))))


def check_edge_maps(views: Iterable[View], image_path: Path, edge_path: Path) -> None:
    """Check that every image has an edge image, before work starts.

    Raises:
        ColmapEdgesError: naming the first image without one and the number of such images, or if
            the edge image is the photograph itself.
    """
    if not edge_path.is_dir():
        raise ColmapEdgesError(f"edge_path {edge_path} is not a folder")
    names = [view.name for view in views]
    paths = {name: path_of_edge_map(edge_path, name) for name in names}
    missing = [name for name, path in paths.items() if path is None]
    if missing:
        raise ColmapEdgesError(
            f"edge_path {edge_path} has no edge image of {len(missing)} of {len(names)} images; "
            f"name them after their images: that of {missing[0]} is {missing[0]}.png"
        )
    for name, path in paths.items():
        if path == path_of_image(image_path, name):
            raise ColmapEdgesError(
                f"edge image {path} is the photograph itself; give the folder of the edge images "
                "as edge_path"
            )


def read_edge_map(edge_path: Path | None, name: str) -> CompanionFile | None:
    """Read the edge image of an image, undecoded; None without `edge_path`.

    Raises:
        ColmapEdgesError: if it cannot be read.
    """
    if edge_path is None:
        return None
    path = path_of_edge_map(edge_path, name)
    if path is None:
        raise ColmapEdgesError(
            f"edge_path {edge_path} has no edge image of image {name}; add {name}.png"
        )
    return CompanionFile.read("edge image", path, name)


def decode_edge_map(file: CompanionFile, view: View) -> EdgeMap:
    """Decode a view's edge image; the less frequent of dark and bright pixels are edges.

    Raises:
        ColmapEdgesError: if it cannot be decoded, or its size is neither the camera's, a multiple
            of it, nor that of the downsampled image.
    """
    picture = file.decode()
    height, width = picture.shape
    scale = width / view.width
    is_too_small = width < int(min(1.0, view.scale) * view.width)
    if is_too_small or abs(height - scale * view.height) > max(1.0, scale):
        raise ColmapEdgesError(
            f"edge image {file.path} is {width}x{height}, the camera of image {view.name} "
            f"{view.width}x{view.height}; edge images need the size of their images, or that size "
            "upsampled"
        )
    darkest, brightest = picture.min(), picture.max()
    is_binary = bool(((picture == darkest) | (picture == brightest)).all())
    if np.median(picture) > (float(darkest) + float(brightest)) / 2:  # black on white
        heights = brightest - picture
    else:
        heights = picture - darkest
    largest = max(float(brightest) - float(darkest), 1.0)
    return EdgeMap(heights.astype(np.float32) / np.float32(largest), is_binary)
