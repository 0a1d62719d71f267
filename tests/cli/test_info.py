"""The command `info`, on hand-made models and reports."""

import json

import numpy as np
import pycolmap
import pytest

from colmap_edges.cli.info import count_lines, describe, describe_model, report_lines
from colmap_edges.colmap.model import model_from_reconstruction
from colmap_edges.errors import ColmapEdgesError

REPORT = {
    "command": "reconstruct",
    "stages": [
        {"name": "read", "wall_s": 0.5, "peak_mb": 100.0, "counts": {"images_with_poses": 3}},
        {
            "name": "trace",
            "wall_s": 2.0,
            "peak_mb": 200.5,
            "counts": {"edges": 7, "dropped": {"by_chance": 1}},
        },
    ],
}


def reconstruction(track_lengths=(2, 3, 3), unposed=1):
    """Three posed images of two cameras, some without a pose, points seen by so many images."""
    made = pycolmap.Reconstruction()
    for camera_id, width in ((1, 640), (2, 320)):
        camera = pycolmap.Camera.create_from_model_name(camera_id, "PINHOLE", 500.0, width, 240)
        made.add_camera_with_trivial_rig(camera)
    for image_id in range(1, 4):
        image = pycolmap.Image(f"{image_id}.png", [], 1 if image_id < 3 else 2, image_id)
        points2D = [pycolmap.Point2D(np.array([10.0, 10.0 + i])) for i in range(3)]
        image.points2D = pycolmap.Point2DList(points2D)
        made.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
    for row, length in enumerate(track_lengths):
        elements = [pycolmap.TrackElement(image_id, row) for image_id in range(1, length + 1)]
        made.add_point3D(np.array([0, 0, 5.0]), pycolmap.Track(elements), np.zeros(3, np.uint8))
    for image_id in range(4, 4 + unposed):
        made.add_image_with_trivial_frame(pycolmap.Image(f"{image_id}.png", [], 1, image_id))
    return made


def test_a_model_in_four_lines(tmp_path):
    expected = [
        "cameras: 2 (PINHOLE 320x240, PINHOLE 640x240)",
        "images: 3 with poses, 1 without",
        "points3D: 3, 8 observations",
        "track length: median 3, longest 3",
    ]
    assert describe_model(model_from_reconstruction(reconstruction())) == expected
    reconstruction().write_binary(tmp_path)  # which leaves out images without poses
    expected[1] = "images: 3 with poses, 0 without"
    assert describe(tmp_path) == expected


def test_a_model_without_points_has_no_track_length():
    lines = describe_model(model_from_reconstruction(reconstruction((), unposed=0)))
    assert lines[1:] == ["images: 3 with poses, 0 without", "points3D: 0, 0 observations"]


def test_a_report_stage_by_stage():
    assert report_lines(REPORT) == [
        "output of colmap-edges reconstruct",
        "read: 0.5 s, 100.0 MB",
        "  images with poses: 3",
        "trace: 2.0 s, 200.5 MB",
        "  edges: 7",
        "  dropped:",
        "    by chance: 1",
    ]


def test_results_of_an_output_are_told_in_a_users_words(tmp_path):
    stages = [
        {"name": name, "wall_s": 40.0, "peak_mb": 100.0, "counts": counts}
        for name, counts in {
            "read": {"images_with_poses": 24, "points3D": 11878},
            "write": {"edges": 7, "edge_points": 80, "length": 2.5, "median_residual_px": 0.06},
        }.items()
    ]
    alignment = {"unit": "mm", "scale": 2.0}
    finding = {"text": "3 images have no pose", "remedy": "register them"}
    record = {"command": "reconstruct", "stages": stages, "findings": [finding]}
    (tmp_path / "report.json").write_text(json.dumps(record | {"alignment": alignment}))
    (tmp_path / "edges.ply").touch()
    assert describe(tmp_path) == [
        "Made by:  colmap-edges reconstruct",
        "Images:   24 with poses",
        "Edges:    7 in 3D, total length 2.5 mm, median reprojection error 0.06 px",
        "Points:   11,878 SfM points and 80 edge points in the written model",
        "Time:     1 min 20 s",
        "Aligned:  scaled by 2, unit mm",
        "Note:     3 images have no pose. To change that: register them.",
        "Files:    edges.ply, report.json",
    ]


def test_info_without_counts():
    assert count_lines({}, "  ") == []
    assert count_lines({"a_b": {}}, "") == ["a b:"]


def test_an_output_with_and_without_a_model(tmp_path):
    (tmp_path / "report.json").write_text(json.dumps(REPORT))
    assert describe(tmp_path, verbose=True) == report_lines(REPORT)
    (tmp_path / "sparse").mkdir()
    reconstruction().write_binary(tmp_path / "sparse")
    lines = describe(tmp_path, verbose=True)
    assert lines[:7] == report_lines(REPORT)
    assert lines[7:9] == ["sparse:", "  cameras: 2 (PINHOLE 320x240, PINHOLE 640x240)"]


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "[1]", "{}", "null", '{"command": "mesh"}', "[" * 100_000]
    + [json.dumps(REPORT | {"stages": stages}) for stages in (3, [3], [{}], [{"name": "read"}])]
    + [json.dumps(REPORT | {"stages": [REPORT["stages"][0] | {"counts": [1]}]})],
)
def test_a_damaged_report_is_one_line(tmp_path, text):
    (tmp_path / "report.json").write_text(text)
    for verbose in (False, True):
        with pytest.raises(ColmapEdgesError, match=r"report\.json") as caught:
            describe(tmp_path, verbose)
        assert "\n" not in str(caught.value)


def test_folder_without_model_or_report_is_an_error(tmp_path):
    with pytest.raises(ColmapEdgesError, match="no readable COLMAP model"):
        describe(tmp_path)
