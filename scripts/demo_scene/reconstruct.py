"""The sparse model: COLMAP's own SfM on the rendered images, moved into the true frame."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pycolmap

from demo_scene.cameras import Intrinsics, TrueCamera

SEED = 1
CAMERA_MODEL = "SIMPLE_RADIAL"
PEAK_THRESHOLD = 0.0025  # below COLMAP's 0.0067, since the blotches are too faint to be edges


def reconstruct(
    images: Path,
    cameras: list[TrueCamera],
    intrinsics: Intrinsics,
    database: Path | None = None,
) -> pycolmap.Reconstruction:
    """Return COLMAP's model of the images, aligned by a similarity to the true centres.

    Existing contents of `database` are reused.
    """
    pycolmap.set_random_seed(SEED)
    with tempfile.TemporaryDirectory() as temporary:
        database = database or Path(temporary) / "database.db"
        match(database, images, [camera.name for camera in cameras], intrinsics)
        model = map_incrementally(database, images, Path(temporary))
    if model.num_reg_images() != len(cameras):
        raise RuntimeError(f"only {model.num_reg_images()} of {len(cameras)} images registered")
    align(model, cameras)
    return model


def match(database: Path, images: Path, names: list[str], intrinsics: Intrinsics) -> None:
    """Extract SIFT features and match all pairs of images, on one thread to be repeatable."""
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = CAMERA_MODEL
    reader.camera_params = ",".join(map(str, (intrinsics.focal, *intrinsics.centre, 0)))
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.num_threads, extraction.use_gpu = 1, False
    extraction.sift.peak_threshold = PEAK_THRESHOLD
    extraction.sift.estimate_affine_shape = True
    extraction.sift.domain_size_pooling = True
    pycolmap.extract_features(
        database,
        images,
        image_names=names,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
    )
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads, matching.use_gpu = 1, False
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = SEED
    pycolmap.match_exhaustive(
        database, matching_options=matching, verification_options=verification
    )


def map_incrementally(database: Path, images: Path, output: Path) -> pycolmap.Reconstruction:
    """Run COLMAP's incremental mapper and return its largest model."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.random_seed = SEED
    options.mapper.random_seed = SEED
    options.triangulation.random_seed = SEED
    models = pycolmap.incremental_mapping(database, images, output, options)
    return max(models.values(), key=lambda model: model.num_reg_images())


def align(model: pycolmap.Reconstruction, cameras: list[TrueCamera]) -> None:
    """Move the model by the similarity that fits its camera centres to the true ones best."""
    estimated = {i.name: i.projection_center() for i in model.images.values()}
    source = np.array([estimated[camera.name] for camera in cameras])
    target = np.array([camera.centre() for camera in cameras])
    similarity = pycolmap.estimate_sim3d(source, target)
    if similarity is None:
        raise RuntimeError("no similarity fits the camera centres to the true ones")
    model.transform(similarity)


def summary(
    model: pycolmap.Reconstruction, cameras: list[TrueCamera], intrinsics: Intrinsics
) -> str:
    """Describe the size of the model and how far it lies from the truth."""
    truth = {camera.name: camera for camera in cameras}
    offset, shift = [], []
    points = np.array([p.xyz for p in model.points3D.values()])
    for image in model.images.values():
        true = truth[image.name]
        offset.append(np.linalg.norm(image.projection_center() - true.centre()))
        local = points @ true.cam_from_world[:, :3].T + true.cam_from_world[:, 3]
        expected = intrinsics.focal * local[:, :2] / local[:, 2:] + intrinsics.centre
        found = model.cameras[image.camera_id].img_from_cam(image.cam_from_world() * points)
        shift.append(np.linalg.norm(found - expected, axis=1))
    camera = next(iter(model.cameras.values()))
    return (
        f"{model.num_reg_images()} images, {model.num_points3D()} points, "
        f"reprojection error {model.compute_mean_reprojection_error():.3f} px, "
        f"mean track {model.compute_mean_track_length():.1f}\n"
        f"{camera.model_name} {np.array2string(camera.params, precision=5)}\n"
        f"camera centres off by {np.sqrt(np.mean(np.square(offset))):.5f} m (rms), "
        f"points projected by true and found cameras differ by "
        f"{np.sqrt(np.mean(np.square(shift))):.3f} px (rms)"
    )
