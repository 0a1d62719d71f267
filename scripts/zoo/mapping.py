"""The sparse model: COLMAP's own SfM on the rendered images, moved into the true frame."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from zoo.camera import Rig

SEED = 1


def reconstruct(images: Path, output: Path, rig: Rig) -> str:
    """Write COLMAP's model of the images, aligned by a similarity to the true centres.

    Returns:
        Its size, and how far it lies from the truth.

    Raises:
        RuntimeError: Not all images are registered.
    """
    pycolmap.set_random_seed(SEED)
    with tempfile.TemporaryDirectory() as temporary:
        database = Path(temporary) / "database.db"
        match(database, images, rig)
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads = 1
        options.random_seed = options.mapper.random_seed = SEED
        options.triangulation.random_seed = SEED
        models = pycolmap.incremental_mapping(database, images, Path(temporary), options)
    model = max(models.values(), key=lambda model: model.num_reg_images())
    if model.num_reg_images() != len(rig.views):
        raise RuntimeError(f"only {model.num_reg_images()} of {len(rig.views)} images registered")
    centres = {image.name: image.projection_center() for image in model.images.values()}
    source = np.array([centres[view.name] for view in rig.views])
    similarity = pycolmap.estimate_sim3d(source, np.array([view.centre() for view in rig.views]))
    if similarity is None:
        raise RuntimeError("no similarity fits the camera centres to the true ones")
    model.transform(similarity)
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir()
    model.write_binary(output)
    return summary(model, rig)


def match(database: Path, images: Path, rig: Rig) -> None:
    """Extract SIFT features and match all pairs of images, on one thread to be repeatable."""
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model = "SIMPLE_RADIAL"
    reader.camera_params = ",".join(map(str, [*rig.camera.params[1:], 0]))
    extraction: Any = pycolmap.FeatureExtractionOptions()
    extraction.num_threads, extraction.use_gpu = 1, False
    # Below COLMAP's 0.0067, since the blotches are too faint to be edges.
    extraction.sift.peak_threshold = 0.0025
    extraction.sift.estimate_affine_shape = True
    extraction.sift.domain_size_pooling = True
    pycolmap.extract_features(
        database,
        images,
        image_names=[view.name for view in rig.views],
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


def summary(model: pycolmap.Reconstruction, rig: Rig) -> str:
    """Describe the size of the model and how far it lies from the truth."""
    truth = {view.name: view for view in rig.views}
    points = np.array([point.xyz for point in model.points3D.values()])
    offset, shift = [], []
    for image in model.images.values():
        true = truth[image.name]
        offset.append(np.linalg.norm(image.projection_center() - true.centre()))
        found = model.cameras[image.camera_id].img_from_cam(image.cam_from_world() * points)
        shift.append(found - rig.camera.img_from_cam(true.local(points)))
    found_camera = next(iter(model.cameras.values()))
    return (
        f"{model.num_reg_images()} images, {model.num_points3D()} points, "
        f"reprojection error {model.compute_mean_reprojection_error():.3f} px, "
        f"mean track {model.compute_mean_track_length():.1f}\n"
        f"{found_camera.model_name} {np.array2string(found_camera.params, precision=5)}\n"
        f"camera centres off by {np.sqrt(np.mean(np.square(offset))):.5f} m (rms), "
        f"points projected by true and found cameras differ by "
        f"{np.sqrt(np.mean(np.sum(np.square(shift), axis=2))):.3f} px (rms)"
    )
