#!/usr/bin/env python3
"""Triangulate lines with LIMAP 2.0 on a COLMAP model, for comparison.

Needs a separate environment: pip install pylimap==2.0.0 (brings OpenCV and pycolmap). Segments
are OpenCV's LSD, the longest of each image; each line is paired with every line of the views that
share most SfM points; everything else is LIMAP's default. Distorted images are undistorted first,
as LIMAP requires.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np
import pycolmap


def detect(path: Path, count: int) -> np.ndarray:
    """(N, 4) ends of the longest segments of an image, COLMAP's pixels."""
    gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    found = cv2.createLineSegmentDetector().detect(gray)[0]
    segments = np.zeros((0, 4)) if found is None else found.reshape(-1, 4).astype(float)
    lengths = np.hypot(segments[:, 2] - segments[:, 0], segments[:, 3] - segments[:, 1])
    return segments[np.argsort(-lengths)[:count]] + 0.5


def neighbors(reconstruction: pycolmap.Reconstruction, count: int) -> dict[int, list[int]]:
    """Views that share most points; the nearer one if equal."""
    images = reconstruction.images
    seen = {
        i: {p.point3D_id for p in image.points2D if p.has_point3D()} for i, image in images.items()
    }
    centers = {i: image.projection_center() for i, image in images.items()}
    return {
        i: sorted(
            (j for j in images if j != i),
            key=lambda j: (-len(seen[i] & seen[j]), np.linalg.norm(centers[i] - centers[j])),
        )[:count]
        for i in images
    }


def undistorted(image_path: Path, input_path: Path, folder: Path) -> tuple[Path, Path]:
    """Images and model without distortion: the given ones, or new ones in `folder`."""
    cameras = pycolmap.Reconstruction(input_path).cameras.values()
    if all(camera.is_undistorted() for camera in cameras):
        return image_path, input_path
    pycolmap.undistort_images(folder, input_path, image_path)
    return folder / "images", folder / "sparse"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--image_path", type=Path, required=True)
    parser.add_argument("--input_path", type=Path, required=True)
    parser.add_argument("--output_path", type=Path, required=True)
    parser.add_argument("--max_segments", type=int, default=1500)
    parser.add_argument("--num_neighbors", type=int, default=6)
    arguments = parser.parse_args()

    import limap.geometry
    import limap.scene
    import limap.sfm

    arguments.output_path.mkdir(parents=True, exist_ok=True)
    image_path, input_path = undistorted(
        arguments.image_path, arguments.input_path, arguments.output_path / "undistorted"
    )
    reconstruction = pycolmap.Reconstruction(input_path)
    database_path = arguments.output_path / "structures.db"
    limap.scene.create_structure_db(database_path)
    lines = {
        i: [
            limap.geometry.Line2d(ends[:2], ends[2:])
            for ends in detect(image_path / image.name, arguments.max_segments)
        ]
        for i, image in reconstruction.images.items()
    }
    with limap.scene.StructureDatabase.open(database_path) as database:
        limap.scene.initialize_structures_from_reconstruction(database, reconstruction)
        limap.scene.import_line_detections(database, lines)
    result = limap.sfm.pipelines.global_line_triangulation(
        reconstruction,
        database_path,
        limap.sfm.GlobalLineTriangulationOptions(),
        neighbors(reconstruction, arguments.num_neighbors),
    )
    result.write(arguments.output_path)
    print(result)


if __name__ == "__main__":
    main()
