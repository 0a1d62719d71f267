#!/usr/bin/env python3
"""Write edge images (PNG, white on black) of a detector, for --edge_path.

EdgeDrawing's edge images, including faint straight edges, have the working scale of a run of
colmap-edges, at which images may be upsampled; Canny's have the size of the images.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import click
import cv2
import numpy as np

from colmap_edges.colmap.model import load_model
from colmap_edges.edges2d.detection import own_pixel_chains, resized
from colmap_edges.edges2d.working_scale import at_working_scale
from colmap_edges.errors import exit_on_error
from colmap_edges.images.files import (
    check_images_exist,
    encoded,
    gray_of,
    path_of_image,
    read_image,
)
from colmap_edges.options import DetectionOptions
from colmap_edges.runtime.output import write_whole

Detector = Callable[[np.ndarray, float], np.ndarray]


def own_edges(gray: np.ndarray, scale: float) -> np.ndarray:
    """The pixels of a run's own chains in the upsampled image."""
    upsampled = resized(gray, scale)
    pixels, _ = own_pixel_chains(gray, upsampled, scale, DetectionOptions())
    edges = np.zeros(upsampled.shape, np.uint8)
    columns, rows = np.rint(pixels).astype(int).clip(0, np.array(edges.shape[::-1]) - 1).T
    edges[rows, columns] = 255
    return edges


def canny(low: float, high: float) -> Detector:
    """Canny's edges, with thresholds in intensity levels per pixel, after a blur of 1 px."""
    sobel = 8  # scale of Sobel's filter relative to the gradient

    def detect(gray: np.ndarray, _scale: float) -> np.ndarray:
        blurred = cv2.GaussianBlur(gray, (0, 0), 1.0)
        return cv2.Canny(blurred, sobel * low, sobel * high, L2gradient=True)

    return detect


@click.command(help=__doc__)
@click.option("--image_path", type=Path, required=True, help="Folder of the images.")
@click.option("--input_path", type=Path, required=True, help="Folder of the COLMAP model.")
@click.option("--output_path", type=Path, required=True, help="Folder for the edge images.")
@click.option(
    "--detector",
    type=click.Choice(["edgedrawing", "canny"]),
    default="edgedrawing",
    show_default=True,
)
@click.option(
    "--min_blur_px",
    default=DetectionOptions().min_blur_px,
    show_default=True,
    help="EdgeDrawing's: --Detection.min_blur_px of the run, which is 0 with --method paper.",
)
@click.option(
    "--low", default=3.0, show_default=True, help="Canny's lower threshold, levels per px."
)
@click.option("--high", default=6.0, show_default=True, help="Canny's upper threshold.")
@exit_on_error()
def main(
    image_path: Path,
    input_path: Path,
    output_path: Path,
    detector: str,
    min_blur_px: float,
    low: float,
    high: float,
) -> None:
    model = load_model(input_path)
    check_images_exist(model.views, image_path)
    detect: Detector = canny(low, high)
    if detector == "edgedrawing":
        options = DetectionOptions(min_blur_px=min_blur_px)
        detect, model = own_edges, at_working_scale(model, image_path, options)
    for view in model.views:
        edges = detect(gray_of(read_image(view, image_path)), view.scale)
        path = path_of_image(output_path, f"{view.name}.png")
        path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(path, encoded(".png", edges), "edge image")
    click.echo(f"{len(model.views)} edge images in {output_path}")


if __name__ == "__main__":
    main()
