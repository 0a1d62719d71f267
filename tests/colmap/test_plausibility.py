"""Implausible values: points are left out, cameras and poses refused."""

import numpy as np
import pycolmap
import pytest

from colmap_edges.cli.info import describe
from colmap_edges.colmap.model import load_model, model_from_reconstruction
from colmap_edges.colmap.plausibility import MAX_POINT3D_ID, within_reach
from colmap_edges.colmap.writing import write_model
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run


@pytest.fixture
def given(small):
    """The small scene's model, which may be changed, and its images."""
    return pycolmap.Reconstruction(str(small[1])), small[0]


def mesh(given, folder, **options):
    """The report of a run from a model in memory."""
    (folder / "sparse").mkdir()
    given[0].write_binary(str(folder / "sparse"))
    paths = Paths(image_path=given[1], input_path=folder / "sparse", output_path=folder / "out")
    return run("mesh", paths, PipelineOptions(num_threads=2, report=False, **options))


def counts_of(report, name):
    return next(stage["counts"] for stage in report["stages"] if stage["name"] == name)


@pytest.mark.parametrize("x", [-1e150, 1e300, 1e31, 1e20, 1e8])
def test_a_few_absurd_points_are_left_out_and_counted(given, tmp_path, x):
    reconstruction = given[0]
    moved = sorted(reconstruction.points3D)[-50:]  # the ids after which those of edges come
    for point3D_id in moved:
        reconstruction.points3D[point3D_id].xyz = np.array([x, 0, 0])
    report = mesh(given, tmp_path, use_faces=False, use_patches=False)
    count = reconstruction.num_points3D()
    assert counts_of(report, "read")["points3D_too_far"] == 50
    assert counts_of(report, "read")["points3D"] == count - 50
    assert counts_of(report, "mesh")["faces"] > 1000
    text = report["findings"][0]["text"]
    assert "SfM points at infinity" in text and text.endswith(f"50 of {count:,}")
    written = pycolmap.Reconstruction(str(tmp_path / "out" / "sparse"))
    assert written.num_points3D() == count + counts_of(report, "trace")["edge_points"]
    assert all(written.points3D[i].xyz[0] == x for i in moved)
    assert "SfM point" in "\n".join(describe(tmp_path / "out"))


@pytest.mark.parametrize("factor", [1e3, 1e5])
def test_far_points_stay_and_do_no_harm(given, tmp_path, soak, factor):
    if factor == 1e3 and not soak:
        pytest.skip("in the long version")
    reconstruction = given[0]
    for point3D_id in sorted(reconstruction.points3D)[:20]:
        reconstruction.points3D[point3D_id].xyz *= factor
    report = mesh(given, tmp_path)
    assert "points3D_too_far" not in counts_of(report, "read")
    assert counts_of(report, "trace")["edges"] > 10
    assert counts_of(report, "mesh")["faces"] > 1000


def test_all_points_at_infinity(given, tmp_path):
    for point in given[0].points3D.values():
        point.xyz = np.array([1e150, 1.0, 1.0])
    report = mesh(given, tmp_path)
    assert counts_of(report, "read")["points3D"] == 0
    assert counts_of(report, "mesh")["faces"] > 0


def test_reach_is_that_of_cameras_and_points():
    points = np.column_stack([np.linspace(1, 3, 99), np.zeros((99, 2))])
    for unit in (1e-20, 1.0, 1e20):
        far = np.vstack([points, [[1e5, 0, 0], [1e7, 0, 0], [0, -1e150 / unit, 0]]])
        for centers in (np.zeros((4, 3)), np.eye(3)):  # all in one place, and apart
            found = within_reach(unit * far, unit * centers)
            assert found.tolist() == 100 * [True] + [False, False]
    assert within_reach(np.zeros((0, 3)), np.eye(3)).tolist() == []
    assert within_reach(np.full((2, 3), 1e200), np.eye(3)).tolist() == [False, False]
    assert within_reach(np.full((2, 3), 1e20), np.zeros((0, 3))).tolist() == [True, True]


def change_camera(reconstruction, **values):
    for name, value in values.items():
        setattr(reconstruction.cameras[1], name, value)


def change_pose(reconstruction, quaternion=(0.0, 0.0, 0.0, 1.0), translation=(0.0, 0.0, 0.0)):
    pose = pycolmap.Rigid3d(pycolmap.Rotation3d(np.array(quaternion)), np.array(translation))
    reconstruction.frames[reconstruction.images[1].frame_id].rig_from_world = pose


def lens(focal=264.0, x=120.0):
    return {"params": np.array([focal, focal, x, 90.0])}


REFUSED = {
    "no pixels": (change_camera, {"width": 0, "height": 0}, "size 0x0"),
    "no width": (change_camera, {"width": 0}, "size 0x180"),
    "all pixels": (change_camera, {"height": 2**63}, "size 240x9223372036854775808"),
    "endless focal length": (change_camera, lens(1e300), r"has implausible parameters"),
    "telescope": (change_camera, lens(1e9), "has implausible parameters"),
    "no focal length": (change_camera, lens(1e-300), "has implausible parameters"),
    "principal point": (change_camera, lens(x=1e300), "has implausible parameters"),
    "far": (
        change_pose,
        {"translation": (0, 1e300, 0)},
        "view_001.png has the implausible translation",
    ),
    "far, too": (
        change_pose,
        {"translation": (-1e31, 0, 0)},
        "view_001.png has the implausible translation",
    ),
    "no rotation": (change_pose, {"quaternion": (0, 0, 0, 0)}, "rotation of image view_001.png"),
    "hardly any": (
        change_pose,
        {"quaternion": (0, 1e-200, 0, 0)},
        "rotation of image view_001.png",
    ),
    "too much": (change_pose, {"quaternion": (0, 1e300, 0, 0)}, "view_001.png"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_absurd_cameras_and_poses_are_refused_in_one_line(given, case):
    change, values, message = REFUSED[case]
    change(given[0], **values)
    with pytest.raises(ColmapEdgesError, match=message) as caught:
        model_from_reconstruction(given[0])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("quaternion", ["0 0 0 0", "1e300 0 0 1e300", "1e-200 0 0 1e-200"])
def test_invalid_rotations_in_files(given, tmp_path, quaternion, text):
    """COLMAP normalizes them while it reads, to none at all."""
    given[0].write_text(str(tmp_path))
    path = tmp_path / "frames.txt"
    lines = path.read_text().splitlines()
    row = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    words = lines[row].split()
    lines[row] = " ".join([*words[:2], *quaternion.split(), *words[6:]])
    path.write_text("\n".join(lines) + "\n")
    if not text:
        (tmp_path / "bin").mkdir()
        patch_quaternion(given[0], tmp_path / "bin", [float(word) for word in quaternion.split()])
    with pytest.raises(ColmapEdgesError, match=r"rotation|is not finite"):
        load_model(tmp_path if text else tmp_path / "bin")


def patch_quaternion(reconstruction, folder, quaternion):
    """Write a binary model whose first frame has this rotation."""
    reconstruction.write_binary(str(folder))
    data = bytearray((folder / "frames.bin").read_bytes())
    data[16:48] = np.array(quaternion).tobytes()
    (folder / "frames.bin").write_bytes(data)


@pytest.mark.parametrize("value", [1e-9, 1e9, 1e25])
def test_any_unit_of_length_will_do(given, tmp_path, soak, value):
    if value == 1e9 and not soak:
        pytest.skip("in the long version")
    given[0].transform(pycolmap.Sim3d(value, pycolmap.Rotation3d(), np.zeros(3)))
    report = mesh(given, tmp_path)
    assert counts_of(report, "trace")["edges"] > 10
    assert counts_of(report, "mesh")["faces"] > 1000


@pytest.mark.parametrize("translation", [1e10, 1e15, 1e29])
def test_one_camera_that_is_lost_does_not_break_the_run(given, tmp_path, soak, translation):
    """Points next to its plane have pixels anywhere, which once took all memory."""
    if translation == 1e15 and not soak:
        pytest.skip("in the long version")
    change_pose(given[0], translation=(translation, 0.0, 0.0))
    report = mesh(given, tmp_path)
    assert counts_of(report, "trace")["edges"] > 5


@pytest.mark.parametrize("point3D_id", [MAX_POINT3D_ID + 1, 2**63 - 2, 2**63, 2**64 - 2])
def test_ids_that_leave_no_room_for_more_are_refused(given, tmp_path, point3D_id):
    reconstruction = given[0]
    add_point(reconstruction, point3D_id)
    with pytest.raises(ColmapEdgesError, match=f"point3D {point3D_id} .* leaves no ids"):
        model_from_reconstruction(reconstruction)
    reconstruction.write_binary(str(tmp_path))
    with pytest.raises(ColmapEdgesError, match=f"point3D {point3D_id} .* leaves no ids"):
        load_model(tmp_path)


def test_the_largest_id_can_be_written_and_read_again(given, tmp_path, scene_edges):
    add_point(given[0], MAX_POINT3D_ID)
    model = model_from_reconstruction(given[0])
    (tmp_path / "a").mkdir()
    write_model(model, Edges3D.none(), tmp_path / "a")
    assert load_model(tmp_path / "a").point3D_ids[-1] == MAX_POINT3D_ID


def add_point(reconstruction, point3D_id):
    """Add a point that two images observe, under an id."""
    point = pycolmap.Point3D()
    point.xyz = np.zeros(3)
    for image_id in (1, 2):
        image = reconstruction.images[image_id]
        point.track.add_element(image_id, len(image.points2D))
        image.points2D.append(pycolmap.Point2D(np.array([50.0, 50.0])))
    reconstruction.add_point3D_with_id(point3D_id, point)


@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("FOV", [264, 264, 120, 90, 3.2]),  # mirrored at its axis
        ("FOV", [264, 264, 120, 90, 7.0]),
        ("SIMPLE_RADIAL", [264, 120, 90, 1e9]),  # no pixel has a ray
    ],
)
def test_lenses_that_cannot_be_undone_are_refused(given, model, params):
    given[0].cameras[1].model = getattr(pycolmap.CameraModelId, model)
    given[0].cameras[1].params = params
    with pytest.raises(ColmapEdgesError, match=rf"image view_001.png, {model} .*cannot be undone"):
        model_from_reconstruction(given[0])
