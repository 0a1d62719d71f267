"""Reading of COLMAP models into arrays, with validation."""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from colmap_edges.colmap.binary_files import (
    MODEL_NAMES,
    ModelPoints,
    check_are_files,
    is_binary,
    read_checked,
    read_points,
)
from colmap_edges.colmap.plausibility import (
    check_camera,
    check_ids,
    check_lens,
    check_pose,
    within_reach,
)
from colmap_edges.colmap.pose_check import Observed, check_frames_fit, contradicted_views
from colmap_edges.colmap.text_files import is_text, write_as_binary
from colmap_edges.colmap.tracks import places_among, tracks_by_point
from colmap_edges.colmap.workspace import is_model, numbered_models
from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    offsets_of,
    owners_of,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View, track_residuals
from colmap_edges.errors import ColmapEdgesError, check_type


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
        unposed_names: names of images without pose.
        reconstruction: the pycolmap.Reconstruction that it was made from; never modified.
        far_point3D_ids: (F,) int64 ids of points at infinity, which are left out here.
        contradicted_names: names of images whose poses the points contradict, left out here.
        copies: pairs of a name of an image that is left out here, as a copy of a view, and the
            name of that view.
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
    contradicted_names: tuple[str, ...] = ()
    copies: tuple[tuple[str, str], ...] = ()

    @property
    def scale(self) -> float:
        """The largest upsampling factor of its images for detection; below 1 if downsampled."""
        return max(view.scale for view in self.views)

    def at_scale(self, scale: float) -> Model:
        """The same model with every view upsampled `scale` times."""
        return replace(self, views=tuple(replace(view, scale=scale) for view in self.views))

    def selected(self, points: BoolArray, observations: BoolArray | None = None) -> Model:
        """The model with masked (N,) points and (T,) observations; by default theirs.

        Observations must belong to kept points; `reconstruction` stays whole.
        """
        if observations is None:
            observations = points[self.track_points]
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

    def without_views(self, left_out: IntArray) -> Model:
        """The model without (m,) views, by index, and their observations; points all stay."""
        kept = np.setdiff1d(np.arange(len(self.views)), left_out)
        numbers = np.full(len(self.views), -1, np.int32)
        numbers[kept] = np.arange(len(kept))
        observations = numbers[self.track_views] >= 0
        model = self.selected(np.ones(len(self.point3D_ids), bool), observations)
        views = tuple(self.views[index] for index in kept)
        return replace(model, views=views, track_views=numbers[model.track_views])

    def with_reconstruction(self, changed: Any) -> Model:
        """The model with the cameras and poses of a changed copy of `reconstruction`."""
        pairs = ((changed.images[view.image_id], view.scale) for view in self.views)
        views = tuple(view_from_image(image, scale) for image, scale in pairs)
        return replace(self, views=views, reconstruction=changed)

    @cached_property
    def track_points(self) -> IntArray:
        """(T,) point index of each observation."""
        return owners_of(self.track_offsets)

    @cached_property
    def camera_centers(self) -> FloatArray:
        """(V, 3) projection centres of the views."""
        return np.array([view.center for view in self.views]).reshape(-1, 3)


def load_model(path: Path | str) -> Model:
    """Read a COLMAP model folder (bin or txt, any version pycolmap reads).

    Raises:
        ColmapEdgesError: if the folder holds no readable model.
    """
    path = Path(path)
    with as_binary(path) as folder:
        reconstruction, points = read_files(path, folder)
        model, observed = model_and_observed(reconstruction, points)
        if model.views and (folder / "frames.bin").is_file():
            frames = path / ("frames.bin" if folder == path else "frames.txt")
            check_frames_fit(folder / "images.bin", frames, model.views, observed)
    return without_contradicted(model, observed)


def read_files(path: Path, folder: Path) -> tuple[Any, ModelPoints | None]:
    """Read the model at `path`, whose binary files are in `folder`, and its points.

    Raises:
        ColmapEdgesError: if the folder holds no readable model.
    """
    if not is_binary(folder):
        suffix = "bin" if (path / "cameras.bin").is_file() else "txt"
        names = [f"{name}.{suffix}" for name in MODEL_NAMES[:3]]
        missing = [name for name in names if not (path / name).is_file()]
        what = f"no {', '.join(missing)}" if len(missing) < 3 else "none of its files"
        raise ColmapEdgesError(
            f"no readable COLMAP model in {path} ({what}); {where_model_is(path)}"
        )
    level = pycolmap.logging.minloglevel
    pycolmap.logging.minloglevel = pycolmap.logging.FATAL.value  # our error contains the reason
    try:
        points = read_checked(folder, camera_parameter_counts())
        return pycolmap.Reconstruction(str(folder)), points
    except (ValueError, IndexError, RuntimeError, OSError) as error:
        reason = " ".join(str(error).split())
        raise ColmapEdgesError(
            f"no readable COLMAP model in {path} ({reason}): its files do not belong together; "
            "write the model again"
        ) from error
    finally:
        pycolmap.logging.minloglevel = level


def where_model_is(path: Path) -> str:
    """The remedy for a folder without a readable model: models may be below or above it."""
    below = [path / "sparse", *numbered_models(path), *numbered_models(path / "sparse")]
    found = [str(folder) for folder in (*below, path.parent) if is_model(folder)]
    if found and not is_model(path):
        return f"there is one in {' and '.join(found)}"
    return "give the folder that holds cameras, images and points3D (.bin or .txt)"


@contextmanager
def as_binary(path: Path) -> Iterator[Path]:
    """Yield the folder of a model's binary files: `path`, or temporary copies of text files.

    Raises:
        ColmapEdgesError: if a file is a pipe or device, a text file is damaged, or the copies
            cannot be written.
    """
    try:
        check_are_files(path)
    except OSError as error:
        raise ColmapEdgesError(f"no readable COLMAP model in {path} ({error})") from error
    if is_binary(path) or not is_text(path):
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        write_as_binary(path, Path(folder), camera_models())
        yield Path(folder)


def camera_models() -> dict[str, tuple[int, int]]:
    """Id and number of parameters of each of COLMAP's camera models, by its name."""
    models = [m for m in pycolmap.CameraModelId.__members__.values() if int(m) >= 0]
    cameras = (pycolmap.Camera.create_from_model_id(0, m, 1.0, 2, 2) for m in models)
    return {m.name: (int(m), len(c.params)) for m, c in zip(models, cameras, strict=True)}


def camera_parameter_counts() -> dict[int, int]:
    """Number of parameters of each camera model, by COLMAP's model id."""
    return dict(camera_models().values())


def model_from_reconstruction(reconstruction: Any) -> Model:
    """Convert a pycolmap.Reconstruction to arrays; it is kept unchanged.

    Args:
        reconstruction: the model.

    Returns:
        The model without points at infinity, and without views that the points contradict.

    Raises:
        ColmapEdgesError: if a pose, camera or point is invalid, or parts are inconsistent, such as
            poses and points.
    """
    return without_contradicted(*model_and_observed(reconstruction, None))


def model_and_observed(reconstruction: Any, points: ModelPoints | None) -> tuple[Model, Observed]:
    """Convert a pycolmap.Reconstruction to arrays, without points at infinity.

    Returns:
        The model, and what its views observe, for checks of the poses.

    Raises:
        ColmapEdgesError: if a pose, camera or point is invalid, or parts are inconsistent.
    """
    check_type("reconstruction", reconstruction, (pycolmap.Reconstruction,), "the model's folder")
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
    for view in {view.camera.camera_id: view for view in reversed(views)}.values():
        check_lens(view)
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
    model = without_far_points(model)
    return model, Observed(
        xyz=model.points3D_xyz,
        stated_px=points.points3D["error"][places_among(ids, model.point3D_ids)],
        points=model.track_points,
        views=model.track_views,
        points2D=model.track_points2D,
    )


def points_of(reconstruction: Any) -> ModelPoints:
    """The points of a reconstruction, through temporary files, which is fastest."""
    with tempfile.TemporaryDirectory() as folder:
        reconstruction.write_binary(folder)
        try:
            return read_points(Path(folder))
        except (ColmapEdgesError, OSError) as error:  # pycolmap does not report a full disk
            raise ColmapEdgesError(
                f"cannot write the model's points to {Path(folder).parent}: the disk is full "
                f"({error}); free space there or set TMPDIR to another folder"
            ) from error


def check_values(model: Model) -> None:
    """Check that points are finite, ids leave room for more, and image names are unique.

    Raises:
        ColmapEdgesError: naming the first violation.
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
    """The model without points at infinity, whose depth is undefined; their ids are recorded.

    Written models contain them.
    """
    near = within_reach(model.points3D_xyz, model.camera_centers)
    if near.all():
        return model
    return replace(model.selected(near), far_point3D_ids=model.point3D_ids[~near])


def without_contradicted(model: Model, observed: Observed) -> Model:
    """The model without views whose poses the points contradict; their names are recorded.

    Raises:
        ColmapEdgesError: if they are too many.
    """
    wrong = contradicted_views(model.views, observed)
    if not len(wrong):
        return model
    names = tuple(model.views[index].name for index in wrong)
    return replace(model.without_views(wrong), contradicted_names=names)


def view_from_image(image: Any, scale: float = 1.0) -> View:
    """Make a `View` of a posed pycolmap image, upsampled `scale` times."""
    matrix = image.cam_from_world().matrix()
    return View(
        image_id=image.image_id,
        name=image.name,
        width=image.camera.width,
        height=image.camera.height,
        camera=copy.copy(image.camera),  # the original is freed with the reconstruction
        rotation=np.array(matrix[:, :3]),
        translation=np.array(matrix[:, 3]),
        scale=scale,
    )


def observation_residuals(model: Model, edges: Edges3D) -> FloatArray:
    """(T,) reprojection errors of the observations of edge points, in pixels.

    NaN for points behind the camera.
    """
    points = edges.points[edges.observations.points]
    return track_residuals(model.views, points, edges.observations.views, edges.observations.pixels)


def frames_of_views(model: Model) -> IntArray:
    """(V,) COLMAP's frame id of each view's image."""
    images = model.reconstruction.images
    return np.array([images[view.image_id].frame_id for view in model.views], np.int64)
