"""Edge images of another detector: where they are, reading them; white on black, or the reverse."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import cv2
import numpy as np

from colmap_edges.core.arrays import ByteArray, Float32Array
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError, ImageError
from colmap_edges.images.files import GRAY, first_there, path_of_image, read_bytes


@dataclass(frozen=True)
class EdgeMapFile:
    """The edge image of a photograph, as it is read.

    Attributes:
        path: where it is.
        data: (B,) uint8 the file's bytes.
    """

    path: Path
    data: ByteArray


@dataclass(frozen=True)
class EdgeMap:
    """How strong an edge a detector sees in each pixel of an image.

    Attributes:
        strengths: (H, W) float32, 0 where there is none, at most 1.
        is_binary: whether the detector says no more than where edges are.
    """

    strengths: Float32Array
    is_binary: bool


def path_of_edge_map(edge_path: Path, name: str) -> Path | None:
    """Path of the edge image of the image `name` of a model, none where it has none.

    Args:
        edge_path: a folder, with the edge image of a/b.jpg in a/b.jpg.png or a/b.png.
        name: the image's name in the model.

    Raises:
        ColmapEdgesError: when the name leads out of the folder.
    """
    return first_there(edge_path, (f"{name}.png", str(PurePosixPath(name).with_suffix(".png"))))


def check_edge_maps(views: Iterable[View], image_path: Path, edge_path: Path) -> None:
    """Check that every image has an edge image, before work starts.

    Raises:
        ColmapEdgesError: naming the first that has none and how many have none; or when the edge
            image found is the photograph.
    """
    if not edge_path.is_dir():
        raise ColmapEdgesError(f"edge_path {edge_path} is no folder")
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


def read_edge_map(edge_path: Path | None, name: str) -> EdgeMapFile | None:
    """Read the edge image of an image as it is; none where no edge images are given.

    Raises:
        ColmapEdgesError: when it cannot be read.
    """
    if edge_path is None:
        return None
    path = path_of_edge_map(edge_path, name)
    if path is None:
        raise ColmapEdgesError(f"edge_path {edge_path} has no edge image of image {name}")
    try:
        return EdgeMapFile(path, read_bytes(path))
    except ImageError as error:
        raise unreadable_edge_map(path, name) from error


def unreadable_edge_map(path: Path, name: str) -> ColmapEdgesError:
    """Make the error for an edge image that is no picture: no `ImageError`, which skips it."""
    return ColmapEdgesError(f"cannot read edge image {path} of image {name}; replace it")


def decode_edge_map(file: EdgeMapFile, view: View) -> EdgeMap:
    """Decode a view's edge image; the rarer of dark and bright are its edges.

    Raises:
        ColmapEdgesError: when that cannot be done, or it is not of its camera's size, an
            enlargement of it, or as small as the view's image is worked on.
    """
    picture = cv2.imdecode(file.data, GRAY) if len(file.data) else None
    if picture is None or picture.dtype.kind != "u":  # not even whole numbers
        raise unreadable_edge_map(file.path, view.name)
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
