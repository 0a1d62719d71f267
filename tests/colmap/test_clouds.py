"""Reading of clouds: miniatures of COLMAP's, OpenMVS's and scanners' files; damaged ones."""

from __future__ import annotations

from pathlib import Path

import dense_clouds as clouds
import numpy as np
import pytest

from colmap_edges.colmap.clouds import image_names, read_cloud, read_visibility
from colmap_edges.colmap.model import load_model
from colmap_edges.errors import ColmapEdgesError

POINTS = np.array([(0.5, 1, 2), (-3, 4, 5), (6, 7, -8.25)])
TRACKS = [[2, 0], [], [1, 2, 3]]
SHARED = Path(__file__).parents[3] / "shared" / "data" / "dense" / "demo"


def written(folder, name, data):
    (folder / name).write_bytes(data)
    return folder / name


def tracks_of(seen):
    return [of.tolist() for of in np.split(seen.images, seen.offsets[1:-1])]


def test_fused_clouds_are_read_with_colours_and_visibility(tmp_path):
    cloud = read_cloud(written(tmp_path, "fused.ply", clouds.fused_ply(POINTS)))
    assert np.array_equal(cloud.points, POINTS)
    assert cloud.colors.tolist() == [[10, 20, 30]] * 3
    assert cloud.seen is None
    seen = read_visibility(written(tmp_path, "fused.ply.vis", clouds.fused_vis(TRACKS)))
    assert tracks_of(seen) == TRACKS


def test_openmvs_clouds_tell_their_views(tmp_path):
    cloud = read_cloud(written(tmp_path, "scene_dense.ply", clouds.openmvs_ply(POINTS, TRACKS)))
    assert np.array_equal(cloud.points, POINTS)
    assert cloud.colors.tolist() == [[1, 2, 3]] * 3
    assert tracks_of(cloud.seen) == TRACKS


@pytest.mark.parametrize("order", ["ascii", "binary_big_endian"])
def test_clouds_of_scanners_are_read(tmp_path, order):
    properties = [("x", "double"), ("y", "double"), ("z", "double"), ("intensity", "float")]
    start = clouds.header(order, 3, properties)
    table = np.column_stack([POINTS, [0.1, 0.2, 0.3]])
    if order == "ascii":
        body = "\n".join(" ".join(map(str, row)) for row in table).encode() + b"\n"
    else:
        body = b"".join(
            row[:3].astype(">f8").tobytes() + row[3:].astype(">f4").tobytes() for row in table
        )
    cloud = read_cloud(written(tmp_path, "scan.ply", start + body))
    assert np.array_equal(cloud.points, POINTS)
    assert not cloud.colors.any()


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"solid cube", "is not a PLY file"),
        (clouds.header("binary_little_endian", 3, [("x", "float")]), "no vertices with x, y and z"),
        (clouds.fused_ply(POINTS)[:-1], "is damaged"),
        (clouds.openmvs_ply(POINTS, TRACKS)[:-1], "is damaged"),
        (clouds.header("ascii", 1, [(n, "float") for n in "xyz"]) + b"1 2 west", "is damaged"),
        (clouds.header("ascii", 1, [(n, "real") for n in "xyz"]), "cannot read 'property real x'"),
        (clouds.header("binary_little_endian", 10**12, clouds.FUSED), "is damaged"),
    ],
)
def test_damaged_clouds_are_one_line(tmp_path, data, message):
    with pytest.raises(ColmapEdgesError, match=message) as error:
        read_cloud(written(tmp_path, "cloud.ply", data))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "data", [b"", b"123", clouds.fused_vis(TRACKS)[:-4], clouds.fused_vis(TRACKS) + bytes(4)]
)
def test_damaged_visibility_is_one_line(tmp_path, data):
    with pytest.raises(ColmapEdgesError, match=r"is damaged|is no visibility"):
        read_visibility(written(tmp_path, "fused.ply.vis", data))


def test_a_real_cloud_lies_in_the_images_that_see_it():
    if not SHARED.is_dir():
        pytest.skip(f"{SHARED} is absent")
    model, cloud = load_model(SHARED / "sparse"), read_cloud(SHARED / "fused.ply")
    seen = read_visibility(SHARED / "fused.ply.vis")
    assert len(cloud.points) == len(seen.offsets) - 1 == 209_003
    names = image_names(model.reconstruction)
    view = next(view for view in model.views if view.name == names[0])
    rows = np.repeat(np.arange(len(cloud.points)), np.diff(seen.offsets))[seen.images == 0]
    assert view.holds(*view.project(cloud.points[rows])).mean() > 0.99
