"""COLMAP models in and out, as arrays."""

from __future__ import annotations

import copy
import re
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from numpy.typing import NDArray

from colmap_edges.array_types import BoolArray, ByteArray, FloatArray, Int32Array, IntArray
from colmap_edges.colmap_files import (
    NO_POINT3D,
    POINT2D,
    ModelPoints,
    NewPoints,
    append_points,
    check_are_files,
    check_model_files,
    check_text_files,
    is_binary,
    read_points,
)
from colmap_edges.csr import offsets_of, order_of, owners_of
from colmap_edges.edges import Edges3D
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.plausibility import check_camera, check_ids, check_pose, within_reach

PINHOLES = ("PINHOLE", "SIMPLE_PINHOLE")
MAX_LENS_ERROR_PX = 0.1  # of a pixel that is undistorted and distorted again


@dataclass(frozen=True, kw_only=True)
class View:
    """One posed image: COLMAP's image, its camera and its pose.

    Pixels of a view come in two kinds: those of the image as it is (`points2D`, distorted,
    COLMAP's origin) and *ideal* ones: what a pinhole camera of focal length `focal_px` with the
    principal point at (0, 0) would see, of the image enlarged `scale` times. Geometry works in
    ideal pixels.
    """

    image_id: int
    name: str
    width: int
    height: int
    camera: Any  # pycolmap.Camera
    rotation: FloatArray  # (3, 3) of cam_from_world
    translation: FloatArray  # (3,) of cam_from_world
    scale: float = 1.0  # how many times the image is enlarged before its edges are detected

    @cached_property
    def focal_px(self) -> float:
        """Mean focal length in pixels of the enlarged image."""
        return self.scale * float(self.camera.mean_focal_length())

    @cached_property
    def center(self) -> FloatArray:
        """(3,) projection centre in world coordinates."""
        center: FloatArray = -self.rotation.T @ self.translation
        return center

    def ideal_from_image(self, points2D: FloatArray) -> FloatArray:
        """Undistort (N, 2) image pixels to ideal pixels; NaN where the camera model cannot.

        That is where its distortion has no inverse, or looks more than 90 degrees aside.
        """
        points2D = np.ascontiguousarray(points2D, np.float64)
        ideal = np.asarray(self.camera.cam_from_img(points2D)).reshape(-1, 2) * self.focal_px
        if self.camera.model.name not in PINHOLES:  # COLMAP gives some pixels rays of others
            off = np.abs(self.image_from_ideal(ideal) - points2D).max(axis=1, initial=0)
            ideal[~(off < MAX_LENS_ERROR_PX)] = np.nan
        return ideal

    def image_from_ideal(self, ideal: FloatArray) -> FloatArray:
        """Distort (N, 2) ideal pixels to image pixels; the inverse of `ideal_from_image`."""
        rays = np.column_stack([np.asarray(ideal) / self.focal_px, np.ones(len(ideal))])
        return np.asarray(self.camera.img_from_cam(rays)).reshape(-1, 2)

    def rays(self, pixels: FloatArray) -> FloatArray:
        """World directions (N, 3) through (N, 2) image pixels, one unit deep; NaN as above."""
        ideal = self.ideal_from_image(pixels) / self.focal_px
        directions: FloatArray = np.column_stack([ideal, np.ones(len(ideal))]) @ self.rotation
        return directions

    def cam_from_world(self, points: FloatArray) -> FloatArray:
        """(N, 3) world points in camera coordinates; z is the depth."""
        return points @ self.rotation.T + self.translation

    def project_ideal(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2) ideal pixels and (N,) depths of (N, 3) world points; NaN pixels behind."""
        local = self.cam_from_world(points)
        depths = local[:, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            ideal = self.focal_px * local[:, :2] / np.where(depths > 0, depths, np.nan)[:, None]
        return ideal, depths

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(N, 2) image pixels (COLMAP's origin) and (N,) depths of (N, 3) world points."""
        ideal, depths = self.project_ideal(points)
        return self.image_from_ideal(ideal), depths

    def holds(self, pixels: FloatArray, depths: FloatArray) -> BoolArray:
        """(N,) whether what projects to (N, 2) image pixels at (N,) depths is in the image."""
        inside = (pixels >= 0).all(axis=1) & (pixels < (self.width, self.height)).all(axis=1)
        held: BoolArray = inside & (depths > 0)
        return held


@dataclass(frozen=True, kw_only=True)
class Model:
    """A sparse model as arrays: posed views sorted by name, points, and tracks as CSR.

    Attributes:
        views: posed views, sorted by name.
        points3D_xyz: (N, 3) float64, world units.
        point3D_ids: (N,) int64, COLMAP's ids, ascending.
        points3D_rgb: (N, 3) uint8.
        track_offsets: (N + 1,) int64; observations of point i are track_offsets[i]:[i + 1].
        track_views: (T,) int32 indices into `views`.
        track_points2D: (T, 2) float64 observed image pixels, COLMAP's origin.
        unposed_names: images of the model that have no pose.
        reconstruction: the pycolmap.Reconstruction it was made from; never written to.
        far_point3D_ids: (F,) int64 ids of its points at infinity, which are left out here.
    """

    views: tuple[View, ...]
    points3D_xyz: FloatArray
    point3D_ids: IntArray
    points3D_rgb: ByteArray
    track_offsets: IntArray
    track_views: Int32Array
    track_points2D: FloatArray
    unposed_names: tuple[str, ...]
    reconstruction: Any
    far_point3D_ids: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def scale(self) -> float:
        """How many times its images are enlarged before their edges are detected; the most."""
        return max(view.scale for view in self.views)

    def at_scale(self, scale: float) -> Model:
        """The same model with every view enlarged `scale` times."""
        return replace(self, views=tuple(replace(view, scale=scale) for view in self.views))

    def selected(self, points: BoolArray, observations: BoolArray) -> Model:
        """The model of some of the (N,) points and (T,) observations; these are of such points."""
        lengths = np.bincount(self.track_points[observations], minlength=len(points))
        return replace(
            self,
            points3D_xyz=self.points3D_xyz[points],
            point3D_ids=self.point3D_ids[points],
            points3D_rgb=self.points3D_rgb[points],
            track_offsets=offsets_of(lengths[points]),
            track_views=self.track_views[observations],
            track_points2D=self.track_points2D[observations],
        )

    @cached_property
    def track_points(self) -> IntArray:
        """(T,) point of each observation."""
        return owners_of(self.track_offsets)

    @cached_property
    def camera_centers(self) -> FloatArray:
        """(V, 3) projection centres of the views."""
        return np.array([view.center for view in self.views]).reshape(-1, 3)


def load_model(path: Path | str) -> Model:
    """Read a COLMAP model folder (bin or txt, any version pycolmap reads).

    Raises:
        ColmapEdgesError: when the folder holds no readable model.
    """
    path = Path(path)
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value  # the error says it all
    try:
        check_are_files(path)
        check_model_files(path, camera_parameter_counts())
        reconstruction = pycolmap.Reconstruction(str(path))
        points = read_points(path) if is_binary(path) else None
    except (ValueError, IndexError, RuntimeError, OSError) as error:
        reason = " ".join(str(error).split())
        raise ColmapEdgesError(
            f"no readable COLMAP model in {path} ({reason}); "
            "give the folder that holds cameras, images and points3D (.bin or .txt)"
        ) from error
    finally:
        pycolmap.logging.minloglevel = level
    return model_from_reconstruction(reconstruction, points)


def camera_parameter_counts() -> dict[int, int]:
    """Number of parameters of every camera model, by COLMAP's id of the model."""
    models = [m for m in pycolmap.CameraModelId.__members__.values() if int(m) >= 0]
    cameras = (pycolmap.Camera.create_from_model_id(0, m, 1.0, 2, 2) for m in models)
    return {int(m): len(c.params) for m, c in zip(models, cameras, strict=True)}


def model_from_reconstruction(reconstruction: Any, points: ModelPoints | None = None) -> Model:
    """Take a pycolmap.Reconstruction apart into arrays; it is kept, not changed.

    Args:
        reconstruction: the model.
        points: its points, where they are at hand.

    Raises:
        ColmapEdgesError: when a pose, camera or point is none, or parts do not fit together. Points
            at infinity are left out.
    """
    try:
        images = sorted(reconstruction.images.values(), key=lambda image: image.name)
    except UnicodeDecodeError as error:
        raise ColmapEdgesError(
            f"the name of an image of the model is not UTF-8 ({error.object!r}); rename the image"
        ) from error
    posed = [image for image in images if image.has_pose]
    for image in posed:
        check_camera(image.camera, image.name)
        check_pose(image.cam_from_world(), image.name)
    views = tuple(view_from_image(image) for image in posed)
    points = points or points_of(reconstruction)
    check_ids(points.points3D["id"])
    ids = points.points3D["id"].astype(np.int64)
    observed = [points.points2D[image.image_id] for image in posed]
    offsets, track_views, track_points2D = tracks_by_point(observed, ids)
    model = Model(
        views=views,
        points3D_xyz=points.points3D["xyz"].astype(np.float64),
        point3D_ids=ids,
        points3D_rgb=points.points3D["rgb"].astype(np.uint8),
        track_offsets=offsets,
        track_views=track_views,
        track_points2D=track_points2D,
        unposed_names=tuple(image.name for image in images if not image.has_pose),
        reconstruction=reconstruction,
    )
    check_values(model)
    return without_far_points(model)


def points_of(reconstruction: Any) -> ModelPoints:
    """The points of a reconstruction; by way of files, which is the fastest."""
    with tempfile.TemporaryDirectory() as folder:
        reconstruction.write_binary(folder)
        try:
            return read_points(Path(folder))
        except (ColmapEdgesError, OSError) as error:  # pycolmap is silent on a full disk
            raise ColmapEdgesError(
                f"cannot write the model's points to {Path(folder).parent}: the disk is full "
                f"({error}); free space there or set TMPDIR to another folder"
            ) from error


def check_values(model: Model) -> None:
    """Check that points are numbers, their ids leave room for more, and names of images differ.

    Raises:
        ColmapEdgesError: naming the first that is not.
    """
    for view, following in pairwise(model.views):
        if view.name == following.name:
            raise ColmapEdgesError(f"two images of the model are named {view.name}; rename one")
    if not np.isfinite(model.track_points2D).all():
        raise ColmapEdgesError("a point2D of the model that observes a point3D is not finite")
    bad = model.point3D_ids[~np.isfinite(model.points3D_xyz).all(axis=1)]
    if len(bad):
        raise ColmapEdgesError(f"point3D {bad[0]} of the model is not finite; delete it")


def without_far_points(model: Model) -> Model:
    """The model without points at infinity, which tell nothing; their ids are kept.

    Written models have all points that were given.
    """
    near = within_reach(model.points3D_xyz, model.camera_centers)
    if near.all():
        return model
    rest = model.selected(near, near[model.track_points])
    return replace(rest, far_point3D_ids=model.point3D_ids[~near])


def view_from_image(image: Any, scale: float = 1.0) -> View:
    """Make a `View` of a posed pycolmap image, enlarged `scale` times."""
    matrix = image.cam_from_world().matrix()
    return View(
        image_id=image.image_id,
        name=image.name,
        width=image.camera.width,
        height=image.camera.height,
        camera=copy.copy(image.camera),  # the original dies with the reconstruction
        rotation=np.array(matrix[:, :3]),
        translation=np.array(matrix[:, 3]),
        scale=scale,
    )


def tracks_by_point(
    points2D: Sequence[NDArray[np.void]], point3D_ids: IntArray
) -> tuple[IntArray, Int32Array, FloatArray]:
    """CSR of the observations of each point: offsets (N + 1,), views (T,), pixels (T, 2).

    Args:
        points2D: `POINT2D` records of each view.
        point3D_ids: (N,) ascending.

    Raises:
        ColmapEdgesError: when a view observes a point that is not among them.
    """
    observed = [of_view[of_view["point3D_id"] != NO_POINT3D] for of_view in points2D]
    every = np.concatenate([np.zeros(0, POINT2D), *observed])
    ids = every["point3D_id"].astype(np.int64)
    points = np.searchsorted(point3D_ids, ids)
    known = np.append(point3D_ids, -1)[points] == ids
    if not known.all():
        raise ColmapEdgesError(
            f"the images of the model observe point3D {ids[~known][0]}, which it does "
            "not have; its images and points3D files do not belong together"
        )
    order = np.argsort(points, kind="stable")
    offsets = offsets_of(np.bincount(points, minlength=len(point3D_ids)))
    views = np.repeat(np.arange(len(observed), dtype=np.int32), [len(rows) for rows in observed])
    return offsets, views[order], every["xy"][order]


def rows_by_view(track_views: NDArray[np.integer[Any]], num_views: int) -> list[IntArray]:
    """Of each view the rows, ascending, of the (T,) views of observations that are its own."""
    order = order_of(track_views, num_views)
    return np.split(order, np.cumsum(np.bincount(track_views, minlength=num_views))[:-1])


def views_with_rows(
    views: Sequence[View], track_views: NDArray[np.integer[Any]]
) -> Iterator[tuple[View, IntArray]]:
    """Each view with the rows, ascending, of the (T,) views of observations that are its own."""
    return zip(views, rows_by_view(track_views, len(views)), strict=True)


def observation_residuals(model: Model, edges: Edges3D) -> FloatArray:
    """Distances (T,) in pixels of each observation from the projection of its edge point.

    NaN where the point lies behind the camera.
    """
    points = edges.points[edges.track_points]
    return track_residuals(model.views, points, edges.track_views, edges.track_points2D)


def track_residuals(
    views: Sequence[View],
    points: FloatArray,
    track_views: NDArray[np.integer[Any]],
    track_points2D: FloatArray,
) -> FloatArray:
    """Distances (T,) in pixels of (T, 2) observations from projections of (T, 3) world points.

    NaN where the point lies behind the camera.
    """
    residuals = np.full(len(track_views), np.nan)
    for view, rows in views_with_rows(views, track_views):
        projected, _ = view.project(points[rows])
        residuals[rows] = np.linalg.norm(projected - track_points2D[rows], axis=1)
    return residuals


def frames_of_views(model: Model) -> IntArray:
    """(V,) COLMAP's id of the frame that each view's image belongs to."""
    images = model.reconstruction.images
    return np.array([images[view.image_id].frame_id for view in model.views], np.int64)


def moved_model(model: Model, motions: FloatArray, points3D_xyz: FloatArray) -> Model:
    """A model with other poses and points, on a copy of the reconstruction.

    Args:
        model: the model to start from; it is not changed.
        motions: (F, 3, 4) motion of the world before each frame's pose, frames by ascending id.
        points3D_xyz: (N, 3) the points, as they lie after the motions.
    """
    moved = pycolmap.Reconstruction(model.reconstruction)
    for frame_id, motion in zip(np.unique(frames_of_views(model)), motions, strict=True):
        frame = moved.frames[frame_id]
        frame.rig_from_world = frame.rig_from_world * pycolmap.Rigid3d(motion)
    for point3D_id, xyz in zip(model.point3D_ids, points3D_xyz, strict=True):
        moved.points3D[point3D_id].xyz = xyz
    moved.update_point_3d_errors()
    images = [moved.images[view.image_id] for view in model.views]
    return replace(
        model,
        views=tuple(view_from_image(i, v.scale) for i, v in zip(images, model.views, strict=True)),
        points3D_xyz=points3D_xyz,
        reconstruction=moved,
    )


def write_model(
    model: Model,
    edges: Edges3D,
    path: Path | str,
    output_type: str = "BIN",
    residuals: FloatArray | None = None,
) -> IntArray:
    """Write the model plus the edge points as points3D with tracks.

    Cameras, poses and SfM points are written as they are; each observation of an edge point is
    appended to its image's points2D, so that old indices stay.

    Args:
        model: the input model; it is not changed.
        edges: the edge points and their tracks.
        path: folder to write to; made when missing.
        output_type: BIN or TXT.
        residuals: (T,) those of `observation_residuals`, where they are known already.

    Returns:
        (N,) ids of the edge points in the written model.
    """
    path = Path(path)
    path.mkdir(exist_ok=True)
    points = new_points(model, edges, residuals)
    try:
        if output_type == "BIN":
            model.reconstruction.write_binary(str(path))
            check_model_files(path, camera_parameter_counts())
            append_points(path, points)
        else:
            write_text(with_points(model.reconstruction, points), path)
    except ColmapEdgesError as error:  # pycolmap is silent on a full disk
        raise ColmapEdgesError(f"cannot write to {path}: the disk is full ({error})") from error
    return points.ids


def check_text_names(model: Model) -> None:
    """Check that the names of all images can stand in a text model, where a space ends them.

    Raises:
        ColmapEdgesError: naming the first that cannot.
    """
    names = (view.name for view in model.views)
    bad = next((name for name in names if re.search(r"[ \t\n\v\f\r]", name)), None)
    if bad is not None:
        raise ColmapEdgesError(
            f"image name {bad!r} has a space or line break, which no text model can hold; "
            "rename the image or write a binary model (--output_type BIN)"
        )


def write_text(reconstruction: Any, path: Path) -> None:
    """Write a text model and check that all of it was written."""
    reconstruction.write_text(str(path))
    names = {"cameras": "cameras", "images": "reg_images", "points3D": "points3D"}
    names |= {name: name for name in ("rigs", "frames") if (path / f"{name}.txt").is_file()}
    counts = {name: getattr(reconstruction, f"num_{known}")() for name, known in names.items()}
    check_text_files(path, counts)


def extend_reconstruction(
    model: Model,
    edges: Edges3D,
    residuals: FloatArray | None = None,
) -> tuple[Any, IntArray]:
    """Make a new pycolmap.Reconstruction of the model plus edge points, as `write_model` does.

    Returns:
        The reconstruction and the (N,) ids of the edge points in it.
    """
    points = new_points(model, edges, residuals)
    return with_points(model.reconstruction, points), points.ids


def with_points(reconstruction: Any, points: NewPoints) -> Any:
    """A copy of `reconstruction` with `points`; by way of files, which is the fastest."""
    with tempfile.TemporaryDirectory() as folder:
        reconstruction.write_binary(folder)
        check_model_files(Path(folder), camera_parameter_counts())
        append_points(Path(folder), points)
        return pycolmap.Reconstruction(folder)


def new_points(
    model: Model,
    edges: Edges3D,
    residuals: FloatArray | None,
) -> NewPoints:
    """Edge points as COLMAP's points3D with ids after the model's and reprojection errors."""
    if residuals is None:
        residuals = observation_residuals(model, edges)
    lengths = np.diff(edges.track_offsets)
    sums = np.bincount(edges.track_points, residuals, edges.num_points)
    image_ids = np.array([view.image_id for view in model.views], np.int64)
    known = (model.point3D_ids, model.far_point3D_ids)
    first_id = 1 + int(max(ids.max(initial=0) for ids in known))
    return NewPoints(
        ids=first_id + np.arange(edges.num_points, dtype=np.int64),
        xyz=edges.points,
        rgb=edges.colors,
        errors=sums / np.maximum(lengths, 1),
        track_offsets=edges.track_offsets,
        track_image_ids=image_ids[edges.track_views],
        track_points2D=edges.track_points2D,
    )


def with_edge_points(model: Model, edges: Edges3D, point3D_ids: IntArray) -> Model:
    """The model as arrays with the edge points after its own; `reconstruction` stays as it was."""
    offsets = model.track_offsets[-1] + edges.track_offsets[1:]
    return replace(
        model,
        points3D_xyz=np.concatenate([model.points3D_xyz, edges.points]),
        point3D_ids=np.concatenate([model.point3D_ids, point3D_ids]),
        points3D_rgb=np.concatenate([model.points3D_rgb, edges.colors]),
        track_offsets=np.concatenate([model.track_offsets, offsets]),
        track_views=np.concatenate([model.track_views, edges.track_views]),
        track_points2D=np.concatenate([model.track_points2D, edges.track_points2D]),
    )
