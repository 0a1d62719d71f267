"""Every camera model of pycolmap is supported, or refused with a one-line error."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest
import scenes
from curves import make_view

from colmap_edges.colmap.model import model_from_reconstruction
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.reconstruct import reconstruct
from colmap_edges.pipeline.run import run

MODELS = [name for name, model in pycolmap.CameraModelId.__members__.items() if int(model) >= 0]
SPHERICAL = {"EQUIRECTANGULAR"}
# Models that are others with parameters of 0 or alike: their edges alone, but in the long version.
SPECIAL = {
    *("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_DIVISION"),
    *("SIMPLE_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"),
}


def test_there_are_all():
    assert {"PINHOLE", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV"} <= set(MODELS)


@pytest.mark.parametrize("name", sorted(set(MODELS) - SPHERICAL))
def test_edges_are_found(name, tmp_path, soak):
    """Images rendered through each lens give the edges of the scene, where they are."""
    scene = scenes.make_scene(num_views=6, width=240, height=180, camera_model=name)
    images, _ = scene.write(tmp_path)
    options = PipelineOptions(num_threads=2)
    if name in SPECIAL and not soak:
        options = replace(options, use_faces=False, use_patches=False)
    found = reconstruct(scene.reconstruction, images, options)
    distances = scene.distances(found.edges.points)
    assert found.edges.num_edges > 10
    assert np.median(distances) < 0.01
    assert np.mean(distances < 0.05) > 0.9


@pytest.mark.parametrize("name", sorted(set(MODELS) - SPHERICAL))
def test_pixels_have_the_ray_that_is_seen_there_or_none(name):
    """A short focal length: corners of fisheye images look more than 90 degrees aside."""
    camera = scenes.make_camera(name, 400, 300)
    params = np.array(camera.params)
    params[camera.focal_length_idxs()] = 80.0
    camera.params = params
    view = make_view(np.eye(3), np.zeros(3), camera=camera)
    x, y = np.meshgrid(np.linspace(0, 400, 41), np.linspace(0, 300, 31))
    pixels = np.column_stack([x.ravel(), y.ravel()])
    rays = view.rays(pixels)
    seen = np.isfinite(rays).all(axis=1)
    assert seen[len(pixels) // 2]
    if name.endswith("FISHEYE"):
        assert not seen[[0, -1]].any()
    found, _ = view.project(view.center + rays[seen])
    assert np.abs(found - pixels[seen]).max() < 0.2


def test_edges_of_a_lens_that_looks_behind_itself(tmp_path):
    """What the renderer puts beyond 90 degrees is nonsense, and none of it becomes an edge."""
    camera = pycolmap.Camera.create_from_model_name(1, "FISHEYE", 75.0, 320, 240)
    scene = scenes.make_scene(num_views=6, width=320, height=240, camera_model="FISHEYE")
    scene = through(camera, scene)
    images, _ = scene.write(tmp_path)
    found = reconstruct(scene.reconstruction, images, PipelineOptions(num_threads=2))
    assert found.edges.num_edges > 3
    assert np.median(scene.distances(found.edges.points)) < 0.03


def through(camera, scene):
    """The scene as another camera sees it from the same places."""
    reconstruction = pycolmap.Reconstruction(scene.reconstruction)
    reconstruction.cameras[1].params = camera.params
    images, rays = {}, scenes.supersampled_rays(camera)
    for image in reconstruction.images.values():
        matrix = image.cam_from_world().matrix()
        pose = (matrix[:, :3], matrix[:, 3])
        images[image.name], _ = scenes.render(camera, pose, scenes.solids(), rays)
        for point in image.points2D:
            if point.has_point3D():
                xyz = reconstruction.points3D[point.point3D_id].xyz
                point.xy = scenes.project(camera, pose, xyz[None])[0]
    return replace(scene, images=images, reconstruction=reconstruction)


@pytest.mark.parametrize("name", sorted(set(MODELS) & SPHERICAL))
def test_panoramas_are_refused_before_work_starts(name, small, tmp_path):
    reconstruction = pycolmap.Reconstruction(str(small[1]))
    camera = pycolmap.Camera.create_from_model_name(1, name, 100.0, 240, 180)
    reconstruction.cameras[1].model = camera.model
    reconstruction.cameras[1].params = camera.params
    with pytest.raises(ColmapEdgesError, match=rf"view_001.png is {name}.*panorama_sfm.py"):
        model_from_reconstruction(reconstruction)
    (tmp_path / "sparse").mkdir()
    reconstruction.write_text(str(tmp_path / "sparse"))
    for command in ("detect", "mesh"):
        paths = Paths(
            image_path=small[0], input_path=tmp_path / "sparse", output_path=tmp_path / "out"
        )
        with pytest.raises(ColmapEdgesError, match="has no focal length; cut panoramas into"):
            run(command, paths, PipelineOptions())
    assert not (tmp_path / "out").exists()
