"""DTU in MVSNet's layout, tested on the miniature."""

import shutil

import miniature
import numpy as np
import pytest

from colmap_edges.colmap.model import model_from_reconstruction
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.layouts import dtu, mvsnet
from colmap_edges.evaluation.layouts.scans import scan_scene
from colmap_edges.evaluation.triangulation import triangulate


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = miniature.write_mvsnet(tmp_path_factory.mktemp("mvsnet"))
    shutil.move(root / "official", root.parent / "official")
    return root


@pytest.fixture(scope="module")
def model(root, tmp_path_factory):
    folder, images = mvsnet.posed_images(root, 6)
    return model_from_reconstruction(triangulate(images, folder, tmp_path_factory.mktemp("sparse")))


def test_layouts_are_distinguished(root):
    assert mvsnet.is_layout(root)
    assert not mvsnet.is_layout(root.parent / "official")
    assert not mvsnet.is_layout(root / "Rectified")
    assert dtu.scan_numbers(root) == [6]


def test_cameras_of_the_crops_are_enlarged_to_their_pixels(root):
    folder, images = mvsnet.posed_images(root, 6, positions=dtu.parse_positions("2,5"))
    assert folder == root / "Rectified" / "scan6_train"
    assert [image.name for image in images] == ["rect_002_3_r5000.png", "rect_005_3_r5000.png"]
    for image, index in zip(images, (1, 4), strict=True):
        rotation, translation = miniature.poses()[index]
        np.testing.assert_allclose(image.calibration, miniature.CALIBRATION, atol=1e-9)
        np.testing.assert_allclose(image.rotation, rotation, atol=1e-12)
        np.testing.assert_allclose(image.translation, translation, atol=1e-9)


@pytest.mark.parametrize("name", ["Rectified", "Rectified_raw"])
def test_images_of_full_size_come_first_with_their_own_cameras(root, tmp_path, name):
    shutil.copytree(root, tmp_path / "dtu")
    shutil.copytree(root / "Rectified" / "scan6_train", tmp_path / "dtu" / name / "scan6")
    folder, images = mvsnet.posed_images(tmp_path / "dtu", 6)
    assert folder == tmp_path / "dtu" / name / "scan6"
    np.testing.assert_allclose(images[0].calibration, miniature.CALIBRATION, atol=1e-9)


def test_depth_maps_fit_the_images(root, model):
    references = mvsnet.reference_of(root, 6, model).depths
    assert [reference.view.name for reference in references] == [v.name for v in model.views]
    for reference, (rotation, translation) in zip(references, miniature.poses(), strict=True):
        assert reference.scale == 0.25
        camera = np.diag([0.25, 0.25, 1]) @ miniature.CALIBRATION
        truth = miniature.true_depth(rotation, translation, camera)
        np.testing.assert_array_equal(reference.depth[:, 20:], truth[:, 20:])
        assert not reference.depth[:, :20].any()  # marked as background


def test_reference_is_the_depth_maps_or_the_official_data(root, model):
    reference = scan_scene(root, 6).load_reference(model)
    assert len(reference.depths) == 6
    assert reference.points is None
    assert reference.notes == []
    official = scan_scene(root, 6, reference_root=root.parent / "official")
    reference = official.load_reference(model)
    assert len(reference.points) == len(miniature.surface_points())
    assert reference.dtu.mask is not None


def test_without_depth_maps_a_note_says_so(root, model, tmp_path):
    shutil.copytree(root, tmp_path / "dtu", ignore=shutil.ignore_patterns("Depths"))
    reference = scan_scene(tmp_path / "dtu", 6).load_reference(model)
    assert reference.notes == ["This scan has neither Points nor Depths: no errors are measured."]


@pytest.mark.parametrize(
    ("relative", "content", "message"),
    [
        ("Cameras/train/00000002_cam.txt", None, "00000002_cam.txt is missing"),
        ("Cameras/train/00000000_cam.txt", b"extrinsic 1 2 3", "not a camera of MVSNet's"),
        ("Cameras/train/00000000_cam.txt", b"", "not a camera of MVSNet's"),
        ("Depths/scan6_train/depth_map_0001.pfm", b"PF\n2 2\n-1\n", "not a grayscale PFM"),
        ("Depths/scan6_train/depth_map_0001.pfm", b"Pf\n99 99\n-1\n1234", "not a grayscale PFM"),
        ("Depths/scan6_train/depth_map_0001.pfm", b"Pf\n-1 1\n-1\n1234", "size is -1 x 1"),
        (
            "Depths/scan6_train/depth_map_0001.pfm",
            b"Pf\n1 1\n-1\n1234",
            "another size than its depth map",
        ),
    ],
)
def test_damaged_files_are_named(root, model, tmp_path, relative, content, message):
    shutil.copytree(root, tmp_path / "dtu")
    path = tmp_path / "dtu" / relative
    path.unlink() if content is None else path.write_bytes(content)
    with pytest.raises(ColmapEdgesError, match=message):
        scan_scene(tmp_path / "dtu", 6).load_reference(model)


def test_cameras_of_other_images_are_refused(root, tmp_path):
    """Some releases hold cameras that are of the crops themselves."""
    shutil.copytree(root, tmp_path / "dtu")
    for path in (tmp_path / "dtu" / "Cameras").glob("*_cam.txt"):
        shutil.copy(path, tmp_path / "dtu" / "Cameras" / "train" / path.name)
    with pytest.raises(ColmapEdgesError, match="not for images of 320 x 240 pixels"):
        mvsnet.posed_images(tmp_path / "dtu", 6)


def test_pfm_of_either_byte_order_begins_with_the_last_row(tmp_path):
    for order, scale in (("<f4", b"-1.0"), (">f4", b"1.0")):
        values = np.array([(3, 4, 5), (0, 1, 2)], dtype=order)
        (tmp_path / "a.pfm").write_bytes(b"Pf\n3 2\n" + scale + b"\n" + values.tobytes())
        found = mvsnet.read_pfm(tmp_path / "a.pfm")
        np.testing.assert_array_equal(found, [(0, 1, 2), (3, 4, 5)])
