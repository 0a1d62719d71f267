"""The recipe for panoramas: pycolmap renders perspective images of a rig, then edges are traced."""

import cv2
import numpy as np
import pycolmap
import pytest
import scenes

import colmap_edges

panorama = pytest.importorskip("pycolmap.panorama", reason="pycolmap cuts no panoramas")
pytest.importorskip("PIL", reason="pycolmap.panorama needs pillow")
pytestmark = pytest.mark.pipeline

NUM_PANORAMAS, WIDTH, FINER = 7, 2000, 2
NEARER = 0.6  # of the distance at which the scene's cameras stand
OPTIONS = panorama.PanoRenderOptions(
    num_steps_yaw=4, pitches_deg=(0.0,), hfov_deg=90.0, vfov_deg=90.0
)


def upright_poses():
    """cam_from_world of panoramas around the scene, axes downwards and away from the scene."""
    for rotation, translation in scenes.poses(NUM_PANORAMAS):
        center = -NEARER * rotation.T @ translation
        forward = np.array([-center[0], -center[1], 0.0]) / np.hypot(*center[:2])
        down = np.array([0, 0, -1.0])
        # What is ahead is in the panorama's middle; the scene stands 60 degrees to the left.
        turn = cv2.Rodrigues(np.deg2rad(60) * down)[0]
        forward = turn @ forward
        upright = np.stack([np.cross(down, forward), down, forward])
        yield upright, -upright @ center


def render_panorama(pose, bodies):
    """(H, W) uint8 equirectangular image by ray casting: yaw to the right, pitch downwards."""
    shape = (WIDTH // 2 * FINER, WIDTH * FINER)
    yaw = ((np.arange(shape[1]) + 0.5) / shape[1] * 2 - 1) * np.pi
    pitch = ((np.arange(shape[0]) + 0.5) / shape[0] - 0.5) * np.pi
    image, center = np.full(shape, scenes.BACKGROUND, np.uint8), -pose[0].T @ pose[1]
    sight = pose[0] @ (-center / np.linalg.norm(center))
    ahead = np.cos(pitch)[:, None] * np.cos(yaw - np.arctan2(sight[0], sight[2])) > 0.75
    rows, columns = np.nonzero(ahead)  # 41 degrees about the scene's middle; the rest is background
    rays = (
        np.stack(
            [
                np.cos(pitch[rows]) * np.sin(yaw[columns]),
                np.sin(pitch[rows]),
                np.cos(pitch[rows]) * np.cos(yaw[columns]),
            ],
            axis=1,
        )
        @ pose[0]
    )
    grays, depths = np.full(len(rays), scenes.BACKGROUND, np.uint8), np.full(len(rays), np.inf)
    for face in (face for body in bodies for face in body):
        offset = face.normal @ (face.corners[0] - center)
        if offset >= 0:
            continue  # seen from behind
        depth = offset / np.minimum(rays @ face.normal, -1e-12)
        hit = np.flatnonzero(depth < depths)
        points = center + depth[hit, None] * rays[hit]
        inside = np.ones(len(hit), bool)
        for a, b in zip(face.corners, np.roll(face.corners, -1, axis=0), strict=True):
            outward = np.cross(b - a, face.normal)
            inside &= points @ outward <= a @ outward
        hit, points = hit[inside], points[inside]
        grays[hit], depths[hit] = face.gray, depth[hit]
        for circle, gray in face.discs:
            middle = circle.mean(axis=0)
            radius = np.linalg.norm(circle[0] - middle)
            grays[hit[np.linalg.norm(points - middle, axis=1) <= radius]] = gray
    image[rows, columns] = grays
    blocks = image.reshape(shape[0] // FINER, FINER, shape[1] // FINER, FINER)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def add_rig(reconstruction, rig_config):
    """The rig of the virtual cameras, its first one the reference; ids of its cameras."""
    rig = pycolmap.Rig()
    rig.rig_id = 1
    for number, virtual in enumerate(rig_config.cameras, 1):
        camera = pycolmap.Camera(virtual.camera.todict())
        camera.camera_id = number
        reconstruction.add_camera(camera)
        if virtual.ref_sensor:
            rig.add_ref_sensor(camera.sensor_id)
        else:
            rig.add_sensor(camera.sensor_id, virtual.cam_from_rig)
    reconstruction.add_rig(rig)


def add_frames(reconstruction, processor, names, poses):
    """One frame a panorama with all its images; image ids with the pose of their cameras."""
    posed = {}
    for frame_id, (name, (rotation, translation)) in enumerate(zip(names, poses, strict=True), 1):
        frame = pycolmap.Frame()
        frame.frame_id, frame.rig_id = frame_id, 1
        images = []
        for number, virtual in enumerate(processor.rig_config.cameras):
            image_id = (frame_id - 1) * len(processor.rig_config.cameras) + number + 1
            image = pycolmap.Image(virtual.image_prefix + name, [], number + 1, image_id)
            image.frame_id = frame_id
            frame.add_data_id(image.data_id)
            images.append(image)
            turn = processor.cams_from_pano_rotation[number]
            posed[image_id] = (turn @ rotation, turn @ translation)
        frame.rig_from_world = pycolmap.Rigid3d(np.column_stack(posed[images[0].image_id]))
        reconstruction.add_frame(frame)
        for image in images:
            reconstruction.add_image(image)
        reconstruction.register_frame(frame_id)
    return posed


def add_points(reconstruction, posed):
    """SfM points at corners and on faces, in the images before which nothing else is."""
    rng = np.random.default_rng(0)
    faces = [face for body in scenes.solids() for face in body]
    for face in faces:
        for point in scenes.sfm_points(face, rng, per_edge=3, inside=20):
            seen = []
            for image_id, (rotation, translation) in posed.items():
                center = -rotation.T @ translation
                local = rotation @ point + translation
                if face.normal @ (center - point) <= 0.05 or local[2] < 0.1:
                    continue
                camera = reconstruction.images[image_id].camera
                pixel = np.asarray(camera.img_from_cam(local[None]))[0]
                if (pixel > 2).all() and (pixel < [camera.width - 2, camera.height - 2]).all():
                    seen.append((image_id, pixel + rng.normal(0, 0.2, 2)))
            if len(seen) >= 2:
                scenes.add_point(reconstruction, point, seen)


def test_edges_on_panoramas(tmp_path):
    poses = list(upright_poses())
    names = [f"{i:02d}.png" for i in range(len(poses))]
    (tmp_path / "panoramas").mkdir()
    for name, pose in zip(names, poses, strict=True):
        image = cv2.cvtColor(render_panorama(pose, scenes.solids()), cv2.COLOR_GRAY2BGR)
        cv2.imwrite(str(tmp_path / "panoramas" / name), image)
    processor = panorama.render_perspective_images(
        names, tmp_path / "panoramas", tmp_path / "images", tmp_path / "masks", OPTIONS, False
    )
    reconstruction = pycolmap.Reconstruction()
    add_rig(reconstruction, processor.rig_config)
    add_points(reconstruction, add_frames(reconstruction, processor, names, poses))
    reconstruction.write_binary(str(tmp_path))
    found = colmap_edges.reconstruct(tmp_path, tmp_path / "images", scenes.EDGES_ALONE)
    truth = scenes.Scene(scenes.true_curves(scenes.solids()), None, None, {}, None)
    distances = truth.distances(found.edges.points)
    lengths = np.linalg.norm(np.diff(found.edges.points[found.edges.segments], axis=1), axis=2)
    assert np.median(distances) < 0.005
    assert (distances < 0.02).mean() > 0.95
    assert lengths.sum() > 12
    assert found.reconstruction.rigs[1].num_sensors() == 4
