import json
from dataclasses import replace
from pathlib import Path

import miniature
import numpy as np
import pycolmap
import pytest

from colmap_edges.colmap.model import model_from_reconstruction
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.layouts import strecha
from colmap_edges.evaluation.readers.curves import read_curves
from colmap_edges.export import peers

LIMAP = Path(__file__).parent / "data" / "limap"


@pytest.fixture(scope="module")
def model():
    """The miniature's six cameras with image ids 11 to 16 and no point."""
    reconstruction = pycolmap.Reconstruction()
    k = miniature.CALIBRATION
    params = [k[0, 0], k[1, 1], k[0, 2], k[1, 2]]
    camera = pycolmap.Camera(model="PINHOLE", width=320, height=240, params=params, camera_id=1)
    reconstruction.add_camera_with_trivial_rig(camera)
    for number, (rotation, translation) in enumerate(miniature.poses()):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(rotation), translation)
        name = f"view{number}.png"
        image = pycolmap.Image(name=name, camera_id=1, image_id=11 + number)
        reconstruction.add_image_with_trivial_frame(image, pose)
    return model_from_reconstruction(reconstruction)


EDGE = np.array([(-12, 12, miniature.HEIGHT), (12, 12, miniature.HEIGHT)])


def line3dpp_row(model, views, segments=1, shorten=0.0):
    """One row of Line3D++ with EDGE, cut into equal segments, seen in `views`."""
    knots = EDGE[0] + np.linspace(0, 1, segments + 1)[:, None] * (EDGE[1] - EDGE[0])
    words = [segments, *np.stack([knots[:-1], knots[1:]], axis=1).ravel()]
    words.append(len(views))
    for index in views:
        ends = model.views[index].project(EDGE)[0]
        ends = ends + shorten * np.array([ends[1] - ends[0], ends[0] - ends[1]])
        words += [model.views[index].image_id, 7, *ends.ravel()]
    return " ".join(str(word) for word in words) + " \n"


def check_on_edge(edges):
    np.testing.assert_allclose(edges.points[:, 1:], EDGE[0, 1:][None].repeat(len(edges.points), 0))
    assert edges.points[:, 0].min() == pytest.approx(-12)
    assert edges.points[:, 0].max() == pytest.approx(12)


def test_line3dpp_text(model, tmp_path):
    path = tmp_path / "lines.txt"
    path.write_text(line3dpp_row(model, [0, 2, 5]) + line3dpp_row(model, [1, 3], segments=2))
    edges = peers.load(path, model, spacing_px=4)
    assert edges.num_edges == 3
    check_on_edge(edges)
    first = slice(edges.edge_offsets[0], edges.edge_offsets[1])
    tracks = [
        edges.observations.views[a:b].tolist()
        for a, b in zip(
            edges.observations.offsets[:-1][first],
            edges.observations.offsets[1:][first],
            strict=True,
        )
    ]
    assert all(track == [0, 2, 5] for track in tracks)
    projected, _ = model.views[0].project(edges.points[:1])
    np.testing.assert_allclose(edges.observations.pixels[0], projected[0])
    longest = max(np.ptp(model.views[i].project(EDGE)[0], axis=0).max() for i in (0, 2, 5))
    steps = edges.edge_offsets[1] - 1
    assert longest / 4 <= steps <= longest / 4 + 2


def test_points_beyond_a_2d_segment_are_not_seen_there(model, tmp_path):
    whole = line3dpp_row(model, [0, 2]).split()
    short = line3dpp_row(model, [5], shorten=0.25).split()
    words = [*whole[:7], "3", *whole[8:], *short[8:]]
    (tmp_path / "lines.txt").write_text(" ".join(words))
    edges = peers.load(tmp_path / "lines.txt", model)
    seen_by_last = np.bincount(
        np.repeat(np.arange(edges.num_points), np.diff(edges.observations.offsets)),
        weights=edges.observations.views == 5,
    )
    x = edges.points[:, 0]
    assert (seen_by_last[np.abs(x) < 4] == 1).all()
    assert (seen_by_last[np.abs(x) > 10] == 0).all()
    check_on_edge(edges)


def test_limap_1_tracks(model, tmp_path):
    ends = " ".join(str(v) for v in EDGE.ravel())
    track = f"{ends}\n3 3\nimage_id_list 11 13 16 \nline_id_list 4 5 6 \nEND\n"
    (tmp_path / "track_0.txt").write_text(track)
    rows = [" ".join(str(v) for v in end) for end in EDGE]
    (tmp_path / "alltracks.txt").write_text(f"1\n0 3 3\n{rows[0]}\n{rows[1]}\n11 13 16\n4 5 6\n")
    for path in (tmp_path, tmp_path / "alltracks.txt"):
        edges = peers.load(path, model)
        check_on_edge(edges)
        assert set(edges.observations.views.tolist()) == {0, 2, 5}


def limap_text():
    """Lines as LIMAP's own text export gives them: ends (2, 3) and the track (O, 2) of each."""
    words = iter((LIMAP / "lines3D.txt").read_text().split())
    lines = []
    for _ in range(int(next(words))):
        next(words)
        ends = np.array([float(next(words)) for _ in range(6)]).reshape(2, 3)
        track = [(int(next(words)), int(next(words))) for _ in range(int(next(words)))]
        next(words)
        lines.append((ends, np.array(track)))
    return lines


def test_a_real_result_of_limap_2_reads_as_limap_itself_writes_it():
    lines, expected = peers.read_lines(LIMAP), limap_text()
    assert len(lines) == len(expected) == 9
    for line, (ends, track) in zip(lines, expected, strict=True):
        np.testing.assert_allclose(line.segments[0], ends, atol=1e-5)
        np.testing.assert_array_equal(line.image_ids, track[:, 0])
        assert np.isfinite(line.ends2D).all()


def test_a_real_result_of_limap_2_reprojects_onto_its_2d_segments(data_path):
    from colmap_edges.colmap.model import load_model

    nut = load_model(data_path / "abc-00000006" / "sparse")
    views = {view.image_id: view for view in nut.views}
    distances = []
    for line in peers.read_lines(LIMAP):
        for image_id, ends in zip(line.image_ids.tolist(), line.ends2D, strict=True):
            pixels, _ = views[image_id].project(line.segments[0])
            normal = np.array([ends[1, 1] - ends[0, 1], ends[0, 0] - ends[1, 0]])
            distances += np.abs((pixels - ends[0]) @ normal / np.linalg.norm(normal)).tolist()
    assert np.median(distances) < 1
    edges = peers.load(LIMAP, nut)
    assert edges.num_points > 100
    assert np.diff(edges.observations.offsets).min() >= 2


def test_openmvg_points(model, tmp_path):
    views = [
        {"key": 5 - i, "value": {"ptr_wrapper": {"data": {"filename": f"view{i}.jpg"}}}}
        for i in range(6)
    ]
    observations = [{"key": k, "value": {"id_feat": 0, "x": [k, 2.5]}} for k in (5, 1)]
    structure = [{"key": 0, "value": {"X": [1, 2, 3], "observations": observations}}]
    path = tmp_path / "sfm_data.json"
    path.write_text(json.dumps({"views": views, "structure": structure}))
    edges = peers.load(path, model)
    assert edges.points.tolist() == [[1, 2, 3]]
    assert edges.observations.views.tolist() == [0, 4]
    assert edges.observations.pixels.tolist() == [[5, 2.5], [1, 2.5]]


def test_obj_lines(tmp_path):
    (tmp_path / "lines.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nl 1 2 3\nl -1 -3\n")
    lines = peers.read_lines(tmp_path / "lines.obj")
    assert [line.segments[0].tolist() for line in lines] == [
        [[0, 0, 0], [1, 0, 0]], [[1, 0, 0], [1, 1, 0]], [[1, 1, 0], [0, 0, 0]],
    ]  # fmt: skip


@pytest.mark.parametrize("content", ["1 0 0 0\n", "x y\n", "1 0 0 0 1 1 1 1 99 0 1 1 2 2\n"])
def test_bad_lines_give_one_error(model, tmp_path, content):
    (tmp_path / "lines.txt").write_text(content)
    with pytest.raises(ColmapEdgesError):
        peers.load(tmp_path / "lines.txt", model)


def test_cut_limap_file_gives_an_error(model, tmp_path):
    (tmp_path / "lines3D.bin").write_bytes((LIMAP / "lines3D.bin").read_bytes()[:500])
    with pytest.raises(ColmapEdgesError, match="cut short"):
        peers.load(tmp_path, model)


def test_strecha_camera_files(model, tmp_path):
    import cv2

    rotation, translation = miniature.poses()[1]
    center = -rotation.T @ translation
    rows = [*miniature.CALIBRATION, np.zeros(3), *rotation.T, center]
    text = "\n".join(" ".join(repr(float(v)) for v in row) for row in rows)
    cv2.imwrite(str(tmp_path / "0000.jpg"), np.zeros((240, 320), np.uint8))
    (tmp_path / "0000.jpg.camera").write_text(text + "\n320 240\n")
    (image,) = strecha.posed_images(tmp_path)
    np.testing.assert_allclose(image.rotation, rotation)
    np.testing.assert_allclose(image.translation, translation, atol=1e-12)
    np.testing.assert_allclose(image.calibration, miniature.CALIBRATION)

    short = "\n".join(" ".join(repr(float(v)) for v in row) for row in rows[4:])
    (tmp_path / "0000.jpg.camera").write_text(short + "\n320 240\n")
    with pytest.raises(ColmapEdgesError, match="camera file"):
        strecha.posed_images(tmp_path)
    matrix = [", ".join(repr(float(v)) for v in row) for row in miniature.CALIBRATION]
    (tmp_path / "K.txt").write_text("\n".join(matrix))
    (again,) = strecha.posed_images(tmp_path)
    np.testing.assert_allclose(again.calibration, miniature.CALIBRATION)

    pose = strecha.load_true_poses(tmp_path).pose("0000.jpg")
    np.testing.assert_allclose(pose.matrix(), np.column_stack([rotation, translation]), atol=1e-9)
    with pytest.raises(ColmapEdgesError, match=r"no pose of image 0001.jpg"):
        strecha.load_true_poses(tmp_path).pose("0001.jpg")
    (tmp_path / "0000.jpg.camera").unlink()
    with pytest.raises(ColmapEdgesError, match=r"holds no NAME.camera"):
        strecha.load_true_poses(tmp_path)


def test_lines_in_unknown_images_are_refused(model):
    line = peers.Line(
        segments=EDGE[None],
        image_ids=np.array([11, 99]),
        ends2D=np.full((2, 2, 2), np.nan),
    )
    with pytest.raises(ColmapEdgesError, match="99"):
        peers.sample_lines([line], model)
    known = replace(line, image_ids=np.array([11, 12]))
    assert peers.sample_lines([known], model).num_edges == 1


def test_lines_of_peers_are_curves_too(tmp_path):
    found = read_curves(LIMAP)
    assert len(found.segments) == 9
    expected = np.concatenate([ends for ends, _ in limap_text()])
    np.testing.assert_allclose(found.points, expected, atol=1e-5)
    with pytest.raises(ColmapEdgesError, match="does not exist"):
        read_curves(tmp_path / "none.txt")
