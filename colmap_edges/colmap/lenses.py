"""Bundle adjustment by pycolmap, with a second coefficient of radial distortion for cameras."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pycolmap

from colmap_edges.colmap.model import Model, frames_of_views
from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.polylines import lengths_of
from colmap_edges.core.view import View

# Relative decrease of the cost at which bundle adjustment ends; later steps change coefficients by
# less than a hundredth.
TOLERANCE = 1e-4


def has_one_coefficient(view: View) -> bool:
    """Whether the distortion of a view's camera has one coefficient, as COLMAP's default has."""
    return bool(view.camera.model == pycolmap.CameraModelId.SIMPLE_RADIAL)


def adjusted(model: Model, *, second: bool) -> Model:
    """The model with poses, points and SIMPLE_RADIAL cameras adjusted together.

    Other cameras stay, and so do sensors in their rigs. Coordinates drift; see
    `motions_between`.

    Args:
        model: posed views and points; not changed.
        second: whether the cameras become RADIAL ones.
    """
    found = reconstruction_of(model)
    config = pycolmap.BundleAdjustmentConfig()
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    for view in model.views:
        config.add_image(view.image_id)
        camera = found.cameras[view.camera.camera_id]
        if not has_one_coefficient(view):
            config.set_constant_cam_intrinsics(camera.camera_id)
        elif second:
            camera.model, camera.params = pycolmap.CameraModelId.RADIAL, [*view.camera.params, 0.0]
    options = pycolmap.BundleAdjustmentOptions(print_summary=False, refine_sensor_from_rig=False)
    options.ceres.use_gpu = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.solver_options.num_threads = 1  # more would add in another order each time
    options.ceres.solver_options.function_tolerance = TOLERANCE
    pycolmap.create_default_bundle_adjuster(options, config, found).solve()
    points = np.array([found.points3D[i].xyz for i in model.point3D_ids.tolist()])
    return replace(model.with_reconstruction(found), points3D_xyz=points)


def reconstruction_of(model: Model) -> Any:
    """A copy of the reconstruction with a model's points and what its views observe of them.

    Bundle adjustment would hold points that other images observe.
    """
    found = pycolmap.Reconstruction(model.reconstruction)
    for point3D_id in set(found.points3D) - set(model.point3D_ids.tolist()):
        found.delete_point3D(point3D_id)
    views = {view.image_id for view in model.views}
    for image in found.images.values():
        if image.image_id not in views:
            for index in image.get_observation_point2D_idxs():
                found.delete_observation(image.image_id, index)
    return found


def with_lenses_of(model: Model, other: Model) -> Model:
    """The model with the cameras of another one of the same views."""
    changed = pycolmap.Reconstruction(model.reconstruction)
    for view in other.views:
        take_lens(changed.cameras[view.camera.camera_id], view.camera)
    for copy, original in model.copies:
        pair = (changed.find_image_with_name(name).camera for name in (copy, original))
        take_lens(*pair)
    return model.with_reconstruction(changed)


def take_lens(camera: Any, like: Any) -> None:
    """Give a camera the model and the parameters of another one."""
    camera.model, camera.params = like.model, like.params


def motions_between(model: Model, other: Model) -> FloatArray:
    """(F, 3, 4) motions of the model's frames, by ascending id, to the poses of an adjusted one.

    The adjusted model, with the same points, is turned, moved and scaled first, so that the half of
    the points that then move least, relative to their distances from the cameras, stay in the mean.
    Rigs of several sensors keep their scale.
    """
    before, after = model.points3D_xyz, other.points3D_xyz
    away = lengths_of(before - model.camera_centers.mean(axis=0))
    used = np.ones(len(before), bool)
    for _ in range(2):
        similarity = pycolmap.estimate_sim3d(after[used], before[used]) or pycolmap.Sim3d()
        moved = after @ similarity.matrix()[:, :3].T + similarity.matrix()[:, 3]
        off = lengths_of(moved - before) / away
        used = off <= np.median(off)
    turn = similarity.rotation.matrix()
    several = any(rig.num_sensors() > 1 for rig in model.reconstruction.rigs.values())
    scale = 1.0 if several else similarity.scale
    shift = before[used].mean(axis=0) - scale * turn @ after[used].mean(axis=0)
    frames = np.unique(frames_of_views(model)).tolist()
    old, new = (
        np.array([of.reconstruction.frames[frame].rig_from_world.matrix() for frame in frames])
        for of in (model, other)
    )
    turned = new[:, :, :3] @ turn.T
    shifted = scale * new[:, :, 3] - turned @ shift
    back = old[:, :, :3].transpose(0, 2, 1)
    shifted = np.einsum("fij,fj->fi", back, shifted - old[:, :, 3])
    return np.concatenate([back @ turned, shifted[:, :, None]], axis=2)
