"""Check that the poses of a model fit its points: frames.bin may be stale, poses edited by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from colmap_edges.colmap.binary_files import IMAGE_HEAD, image_records
from colmap_edges.core.arrays import BoolArray, FloatArray, Int32Array, IntArray
from colmap_edges.core.view import View, views_with_rows
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.input_files import read_bytes


@dataclass(frozen=True, kw_only=True)
class Observed:
    """The points of a model and their observations.

    Attributes:
        xyz: (N, 3) world points.
        stated_px: (N,) their reprojection errors as stored in the model; not > 0 if unknown.
        points: (T,) index of the point of each observation.
        views: (T,) index of its view.
        points2D: (T, 2) observed image pixels.
    """

    xyz: FloatArray
    stated_px: FloatArray
    points: IntArray
    views: Int32Array
    points2D: FloatArray

    def medians(self, views: Sequence[View]) -> tuple[FloatArray, FloatArray]:
        """(V,) median reprojection errors and stated errors of the views in pixels.

        Points behind a camera count as infinite errors; NaN for views of few observations.
        """
        found = np.full((2, len(views)), np.nan)
        for index, (view, rows) in enumerate(views_with_rows(views, self.views)):
            if len(rows) >= 10:
                rows = rows[:: 1 + len(rows) // 1000]
                projected, _ = view.project(self.xyz[self.points[rows]])
                errors = np.linalg.norm(projected - self.points2D[rows], axis=1)
                found[0, index] = np.median(np.where(np.isfinite(errors), errors, np.inf))
                found[1, index] = np.median(self.stated_px[self.points[rows]])
        return found[0], found[1]

    def contradicted(self, views: Sequence[View]) -> tuple[IntArray, FloatArray]:
        """Indices of the views whose poses the points contradict, and all median errors."""
        errors, stated = self.medians(views)
        sides = np.array([max(view.width, view.height) for view in views], np.float64)
        # COLMAP's mapper drops observations beyond 4 px; models with rough poses have medians of a
        # few pixels.
        limits = np.fmax(0.02 * sides, 10 * stated)
        return np.flatnonzero(errors > limits), errors


def contradicted_views(views: Sequence[View], observed: Observed) -> IntArray:
    """Indices of the views whose poses the observed points contradict.

    Raises:
        ColmapEdgesError: if they are half of the views with points: points may be wrong.
    """
    wrong, errors = observed.contradicted(views)
    if len(wrong) and 2 * len(wrong) >= np.count_nonzero(~np.isnan(errors)):
        worst = int(wrong[np.argmax(errors[wrong])])
        raise ColmapEdgesError(
            f"the poses of {len(wrong)} of {len(views)} images do not fit the points3D of the "
            f"model: most of what image {views[worst].name} observes projects "
            f"{pixels(errors[worst])}; write poses and points3D of one model"
        )
    return wrong


def check_frames_fit(
    images_path: Path, frames: Path, views: Sequence[View], observed: Observed
) -> None:
    """Check that frames.bin holds the poses of images.bin, or those that fit the points better.

    Programs that do not know frames.bin, such as COLMAP before 3.12, change images.bin alone.

    Args:
        images_path: images.bin of the model.
        frames: the frames file of the model, for messages.
        views: the views, with the poses of frames.bin.
        observed: what they observe.

    Raises:
        ColmapEdgesError: if the poses of images.bin fit better, or the points fit neither, or
            there are no points.
    """
    others = views_of_images_file(images_path, views)
    differ = np.flatnonzero(~same_poses(views, others))
    if not len(differ):
        return
    images, rigs = (frames.with_stem(name).name for name in ("images", "rigs"))
    wrong, of_frames = observed.contradicted(views)
    wrong_in_images, of_images = observed.contradicted(others)
    first, second = of_frames[differ], of_images[differ]
    known = np.isfinite(np.fmin(first, second))
    text = f"{frames} and {images} hold different poses of {len(differ)} images"
    if not known.any() or (len(wrong) and len(wrong_in_images)):
        fit = (
            "neither poses fit the points3D"
            if known.any()
            else "there are no points3D to tell which"
        )
        raise ColmapEdgesError(
            f"{text}, and {fit}; write the model again, or delete {frames.name} and {rigs} if a "
            f"program that does not know them has changed {images}"
        )
    before, after = (float(np.median(of[known])) for of in (first, second))
    if after < before:
        raise ColmapEdgesError(
            f"{text}, and those of {images} fit the points3D: median error {after:.3g} px, not "
            f"{before:.3g} px; delete {frames.name} and {rigs}, which a program that does not know "
            "them has left behind"
        )


def views_of_images_file(path: Path, views: Sequence[View]) -> list[View]:
    """The views with the poses of images.bin."""
    data = read_bytes(path)
    heads = [IMAGE_HEAD.unpack_from(data, image.start) for image in image_records(data, path)]
    poses = {head[0]: np.array(head[1:8]) for head in heads}
    return [
        replace(view, rotation=rotation_of(pose[:4]), translation=pose[4:])
        for view in views
        for pose in [poses[view.image_id]]
    ]


def rotation_of(quaternion: FloatArray) -> FloatArray:
    """(3, 3) rotation of a quaternion w, x, y, z of any length; NaN for zeros."""
    with np.errstate(invalid="ignore"):
        w, *v = quaternion / np.linalg.norm(quaternion)
    x, y, z = v
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + 2 * w * cross + 2 * cross @ cross)


def same_poses(views: Sequence[View], others: Sequence[View]) -> BoolArray:
    """(V,) whether two poses of each view are equal up to rounding."""
    first, second = (
        np.array([np.column_stack([view.rotation, view.translation]) for view in of])
        for of in (views, others)
    )
    units = np.append(np.ones(3), np.abs(first[:, :, 3]).max())  # of rotation and translation
    return np.asarray((np.abs(first - second) <= 1e-6 * units).all(axis=(1, 2)))


def pixels(error: float) -> str:
    """An error in pixels as text."""
    return f"{error:.3g} px beside it" if np.isfinite(error) else "behind its camera"
