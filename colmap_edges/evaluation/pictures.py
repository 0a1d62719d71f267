"""Error maps and overlays as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray, Picture
from colmap_edges.evaluation.metrics.depth import DepthErrors, ReferenceDepth
from colmap_edges.evaluation.metrics.edges import view_window_errors
from colmap_edges.images.files import encoded, gray_of, read_image
from colmap_edges.runtime.output import write_whole

MAGENTA = (255, 0, 255)


def error_map(result: DepthErrors, largest: float, title: str) -> Picture:
    """Picture of |e| from 0 to `largest` (world units), with a colour bar below.

    Dark grey: no reference; magenta: no mesh.
    """
    known = np.isfinite(result.errors)
    level = np.clip(np.abs(np.where(known, result.errors, 0)) / largest, 0, 1) * 255
    picture = cv2.applyColorMap(level.astype(np.uint8), cv2.COLORMAP_TURBO)
    picture[~known] = MAGENTA
    picture[result.reference <= 0] = (48, 48, 48)
    bar = np.tile(np.linspace(0, 255, picture.shape[1]).astype(np.uint8), (16, 1))
    legend = np.full((36, picture.shape[1], 3), 255, dtype=np.uint8)
    for text, x in ((f"0   {title}", 4), (f"{largest:.3g}", picture.shape[1] - 90)):
        cv2.putText(legend, text, (x, 25), cv2.FONT_HERSHEY_SIMPLEX, 0.6, (0, 0, 0), 1)
    coloured = cv2.applyColorMap(bar, cv2.COLORMAP_TURBO)
    return np.vstack([picture, coloured, legend]).astype(np.uint8)


def write_error_maps(folder: Path, results: Sequence[DepthErrors]) -> None:
    """Write one error map per view into `folder`.

    All span 0 to 1 % of the median reference depth, so that different meshes can be compared.
    """
    known = [result.reference[result.reference > 0] for result in results]
    depths = np.concatenate(known) if known else np.empty(0)
    largest = 0.01 * float(np.median(depths)) if len(depths) else 1.0
    folder.mkdir(parents=True, exist_ok=True)
    for result in results:
        title = f"|depth error| {result.name}, magenta: no mesh, grey: no reference"
        write_png(folder / file_name("depth", result.name), error_map(result, largest, title))


def write_edge_overlays(
    folder: Path, points: Model, references: Sequence[ReferenceDepth], image_path: Path
) -> None:
    """Write the faint image of each reference's view with the points of `points` it observes.

    Colours are relative depth errors from 0 to 1 %; magenta: no reference.
    """
    names = [view.name for view in points.views]
    observed = points.track_points
    folder.mkdir(parents=True, exist_ok=True)
    for reference in references:
        seen = observed[points.track_views == names.index(reference.view.name)]
        xyz = points.points3D_xyz[seen]
        errors = view_window_errors(xyz, reference)
        picture = faint(read_image(reference.view, image_path))
        picture = draw_points(picture, reference.view.project(xyz)[0], errors, 0.01)
        write_png(folder / file_name("edges", reference.view.name), picture)


def faint(image: Picture) -> Picture:
    """The image (H, W, 3) in light grey, for coloured points to stand out."""
    return np.asarray(cv2.cvtColor(gray_of(image) // 2 + 110, cv2.COLOR_GRAY2BGR), np.uint8)


def file_name(prefix: str, view_name: str) -> str:
    """Name of the picture of a view."""
    return f"{prefix}_{Path(view_name).with_suffix('').as_posix().replace('/', '_')}.png"


def draw_points(image: Picture, pixels: FloatArray, values: FloatArray, largest: float) -> Picture:
    """Draw `pixels` (N, 2, COLMAP's coordinates), coloured by `values` (N,) from 0 to `largest`.

    Infinite values are magenta. The larger the image, the larger the dots.
    """
    canvas = image.copy()
    if not len(pixels):
        return canvas
    known = np.isfinite(values)
    level = (np.clip(np.where(known, values, 0) / largest, 0, 1) * 255).astype(np.uint8)
    colours = cv2.applyColorMap(level.reshape(-1, 1), cv2.COLORMAP_TURBO).reshape(-1, 3)
    colours[~known] = MAGENTA
    radius = max(1, round(max(image.shape) / 1000))
    for (x, y), colour in zip(np.floor(pixels).astype(int), colours, strict=True):
        cv2.circle(canvas, (int(x), int(y)), radius, colour.tolist(), -1)
    return canvas


def write_png(path: Path, picture: NDArray[Any]) -> None:
    """Write a BGR picture.

    Raises:
        ColmapEdgesError: The file cannot be written.
    """
    write_whole(path, encoded(".png", picture), "picture")
