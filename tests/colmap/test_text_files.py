"""Text models as other programs and editors write them; faults name the file and the line."""

import numpy as np
import pycolmap
import pytest
from text_models import CAMERA, PIXELS, POINT, POSES, write

from colmap_edges.colmap.model import load_model
from colmap_edges.errors import ColmapEdgesError


def both(poses=POSES, pixels=PIXELS):
    return [line for pair in zip(poses, pixels, strict=True) for line in pair]


@pytest.mark.parametrize("mark", [b"", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\n\n"])
def test_a_model_is_read_as_it_stands(tmp_path, mark, end):
    if end == "\n\n":  # an empty line after each
        write(tmp_path, both(), [POINT], end="\n", mark=mark)
        for name in ("cameras", "points3D"):
            path = tmp_path / f"{name}.txt"
            path.write_bytes(path.read_bytes().replace(b"\n", b"\n\n"))
    else:
        write(tmp_path, both(), [POINT], end=end, mark=mark)
    model = load_model(tmp_path)
    assert [view.name for view in model.views] == ["a.png", "b.png", "c.png"]
    assert model.point3D_ids.tolist() == [7]
    np.testing.assert_array_equal(model.track_points2D, [[320, 240], [220, 240], [120, 240]])
    assert model.points3D_rgb.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize(
    "images",
    [
        POSES,  # no empty lines
        [POSES[0], "", POSES[1], "", POSES[2]],  # the last one trimmed
        [POSES[0], "", POSES[1], POSES[2], ""],
        ["# a comment", POSES[0], "", "", POSES[1], "", "", "# and another", POSES[2], "", ""],
    ],
)
def test_empty_lines_may_be_missing(tmp_path, images):
    write(tmp_path, images)
    (tmp_path / "images.txt").write_text("\n".join(images))
    assert [view.name for view in load_model(tmp_path).views] == ["a.png", "b.png", "c.png"]


@pytest.mark.parametrize("pixels", [PIXELS, ["", "", ""], None])
def test_names_may_have_spaces(tmp_path, pixels):
    poses = [pose.replace("a.png", "my photo (1) a.png") for pose in POSES]
    poses = [pose.replace("b.png", "b  2.png") for pose in poses]
    write(
        tmp_path, both(poses, pixels) if pixels else poses, [POINT] if pixels and pixels[0] else []
    )
    names = [view.name for view in load_model(tmp_path).views]
    assert names == ["b  2.png", "c.png", "my photo (1) a.png"]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (
            {"cameras": [CAMERA[:-4]]},
            r"cameras\.txt, line 1: camera 1 has 3 parameters, but PINHOLE",
        ),
        ({"cameras": ["1 PINHOLE 640"]}, r"cameras\.txt, line 1: it has 3 values, but needs"),
        ({"cameras": [CAMERA, CAMERA]}, r"cameras\.txt, line 2: a second camera has the id 1"),
        ({"cameras": [CAMERA.replace("PINHOLE", "PHONE")]}, "'PHONE' is no camera model"),
        ({"cameras": [CAMERA.replace("640", "6x")]}, "the width is '6x', which is not an integer"),
        ({"images": both([*POSES[:2], POSES[2][:-6]])}, r"images\.txt, line 5: it has 9 values"),
        ({"images": both([*POSES[:2], POSES[1]])}, "line 5: a second image has the id 2"),
        ({"images": both([POSES[0].replace(" 1 a", " 9 a"), *POSES[1:]])}, "camera 9 is not in"),
        ({"images": both([POSES[0].replace("1 1 0", "1 x 0"), *POSES[1:]])}, "the pose is 'x'"),
        ({"images": both([POSES[0].replace("1 1 0", "1 0 0"), *POSES[1:]])}, "rotation of zeros"),
        ({"images": both([POSES[0].replace("a.p", "a\0p"), *POSES[1:]])}, "line 1: .* zero byte"),
        ({"images": both(pixels=["1 2", *PIXELS[1:]])}, "line 2: it has 2 values, but points2D"),
        ({"images": both(pixels=["1 x 7", *PIXELS[1:]])}, "line 2: the pixel of point2D 0 is 'x'"),
        ({"images": both(pixels=["1 2 y", *PIXELS[1:]])}, "the point3D id of point2D 0 is 'y'"),
        ({"images": both(pixels=["nan 2 7", *PIXELS[1:]])}, "line 2: a point2D is not finite"),
        ({"points": [POINT + " 77 5"]}, r"points3D\.txt, line 1: .* names image 77, which is not"),
        ({"points": [POINT + " 1"]}, "line 1: its track has 7 values"),
        ({"points": [POINT + " 1 x"]}, "line 1: its track has a value"),
        ({"points": [POINT + " 1 5"]}, r"names point2D 5 of image 1, which has 2 points2D"),
        ({"points": [POINT + " 1 1"]}, r"point2D 1 of image 1, which observes point3D -1 .*line 1"),
        ({"points": [POINT, POINT]}, "line 2: a second point has the id 7"),
        ({"points": [POINT.replace("5", "inf", 1)]}, "point3D 7 is not finite"),
        ({"points": ["7 0 0"]}, "line 1: it has 3 values, but needs a point's id"),
        ({"images": POSES, "points": [POINT]}, "which has 0 points2D .*point_triangulator"),
    ],
)
def test_faults_name_file_and_line(tmp_path, changed, message):
    write(tmp_path, **{"images": both(), "points": [POINT], **changed})
    with pytest.raises(ColmapEdgesError, match=message) as caught:
        load_model(tmp_path)
    assert "\n" not in str(caught.value)


def test_utf16_is_named(tmp_path):
    write(tmp_path, both(), [POINT])
    (tmp_path / "images.txt").write_text("\n".join(both()), encoding="utf-16")
    with pytest.raises(ColmapEdgesError, match=r"images\.txt is in UTF-16; save it as UTF-8"):
        load_model(tmp_path)


@pytest.mark.parametrize("name", ["rigs", "frames"])
@pytest.mark.parametrize("words", [1, 3, -1])
def test_short_lines_of_rigs_and_frames(scene, tmp_path, name, words):
    scene.reconstruction.write_text(str(tmp_path))
    path = tmp_path / f"{name}.txt"
    lines = path.read_text().splitlines()
    lines[-1] = " ".join(lines[-1].split()[:words])
    path.write_text("\n".join(lines))
    with pytest.raises(ColmapEdgesError, match=rf"{name}\.txt, line {len(lines)}: it has"):
        load_model(tmp_path)


def test_rigs_with_several_sensors_equal_pycolmaps(tmp_path):
    made = pycolmap.synthesize_dataset(rig_options())
    made.write_text(str(tmp_path))
    expected = pycolmap.Reconstruction(str(tmp_path))
    model = load_model(tmp_path)
    assert {len(rig.non_ref_sensors) for rig in model.reconstruction.rigs.values()} == {1}
    for view in model.views:
        matrix = expected.images[view.image_id].cam_from_world().matrix()
        np.testing.assert_allclose(view.rotation, matrix[:, :3], atol=1e-12)
        np.testing.assert_allclose(view.translation, matrix[:, 3], atol=1e-12)
    assert len(model.track_views) == expected.compute_num_observations()


def rig_options():
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 2, 2, 3
    options.num_points3D = 40
    return options
