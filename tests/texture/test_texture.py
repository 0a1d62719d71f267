"""Textures of a painted wall behind a board, from views that differ in light, lens and masks."""

from dataclasses import replace

import curves
import cv2
import numpy as np
import pycolmap
import pymeshlab
import pytest
import trimesh

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.meshes import read_mesh, write_mesh
from colmap_edges.report.scene3d import mesh_layer
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.texture import packing
from colmap_edges.texture.gains import find_gains
from colmap_edges.texture.pictures import Images
from colmap_edges.texture.seen_faces import cut_in_front, find_seen_faces
from colmap_edges.texture.texturing import textured

SIZE = (320, 240)
BOARD = np.array([(-0.25, -0.4, 1.0), (0.25, -0.4, 1.0), (0.25, 0.4, 1.0), (-0.25, 0.4, 1.0)])
BOARD_COLOR = np.array([20.0, 200.0, 40.0])
# Cameras before the wall z = 2, which look along z.
CENTERS = [(-0.6, 0, 0), (0, 0.1, 0), (0.6, 0, 0), (0.1, -0.3, 0)]
LIGHTS = (1.0, 1.25, 0.8, 1.0)


def painted(points):
    """(N, 3) RGB colours of the wall, which change slowly."""
    x, y = points[:, 0], points[:, 1]
    return np.column_stack([110 + 50 * np.sin(2 * x), 110 + 50 * np.cos(3 * y), 90 + 30 * x * y])


def make_view(index, distortion=0.0):
    camera = pycolmap.Camera(
        model="SIMPLE_RADIAL",
        width=SIZE[0],
        height=SIZE[1],
        params=[220, SIZE[0] / 2, SIZE[1] / 2, distortion],
    )
    return curves.make_view(np.eye(3), np.negative(CENTERS[index]), index, camera)


def photograph(view, light, board=True):
    """The image of a view, BGR."""
    columns, rows = np.meshgrid(*(np.arange(n) + 0.5 for n in SIZE))
    rays = view.rays(np.column_stack([columns.ravel(), rows.ravel()]))
    colors = painted(view.center + 2 * rays)
    if board:
        on = view.center + rays
        hit = (np.abs(on[:, 0]) < 0.25) & (np.abs(on[:, 1]) < 0.4)
        colors[hit] = BOARD_COLOR
    picture = np.clip(np.rint(light * colors), 0, 255).astype(np.uint8)
    return np.ascontiguousarray(picture.reshape(SIZE[1], SIZE[0], 3)[:, :, ::-1])


def wall(steps, board=True):
    """A wall of 2 steps^2 triangles, and a board of two before it."""
    ticks = np.linspace(-1, 1, steps + 1)
    x, y = (grid.ravel() for grid in np.meshgrid(ticks, 0.8 * ticks))
    vertices = np.column_stack([x, y, np.full(len(x), 2.0)])
    a = (np.arange(steps)[:, None] * (steps + 1) + np.arange(steps)).ravel()
    b, c, d = a + 1, a + steps + 2, a + steps + 1
    faces = np.concatenate([np.column_stack([a, d, c]), np.column_stack([a, c, b])])
    if board:
        first = len(vertices)
        vertices = np.concatenate([vertices, BOARD])
        faces = np.concatenate([faces, first + np.array([[0, 3, 2], [0, 2, 1]])])
    return Mesh(
        vertices=vertices,
        faces=faces.astype(np.int32),
        point3D_ids=np.full(len(vertices), -1),
        colors=np.full((len(vertices), 3), 7, np.uint8),
    )


def write_images(folder, views, lights, board=True):
    for view, light in zip(views, lights, strict=True):
        cv2.imwrite(str(folder / view.name), photograph(view, light, board))
    return Images(folder)


def middles(mesh):
    """(F, 3) the triangles' centres, and (F, 3) the colours that the texture has there."""
    texture = mesh.texture
    height, width = texture.picture.shape[:2]
    places = texture.points[texture.corners].mean(axis=1) * [width, height]
    columns, rows = np.floor(places).astype(int).T
    return mesh.vertices[mesh.faces].mean(axis=1), texture.picture[rows, columns].astype(float)


def errors(mesh, light=1.0):
    """(F,) greatest difference of a channel from the scene's colours."""
    points, colors = middles(mesh)
    true = np.where(points[:, 2:] > 1.5, painted(points), BOARD_COLOR)
    return np.abs(colors - light * true).max(axis=1)


@pytest.mark.parametrize("distortion", [0.0, 0.15])
@pytest.mark.parametrize(("steps", "board"), [(2, False), (24, True)])
def test_texture_has_the_colours_of_the_scene(tmp_path, distortion, steps, board):
    views = [make_view(i, distortion) for i in range(4)]
    images = write_images(tmp_path, views, [1] * 4, board)
    mesh, counts = textured(wall(steps, board), views, images, 1024, 2)
    assert counts["faces_without_view"] == 0
    found = errors(mesh)
    assert np.median(found) < 3
    assert found.max() < 12, "a ghost of the board, or a seam"


def test_large_triangles_follow_perspective(tmp_path):
    """Two triangles on a floor that recedes: its colours inside are right, not only at corners."""
    view = make_view(1)
    corners = np.array([(-0.8, 0.4, 1.2), (0.8, 0.4, 1.2), (0.8, 0.4, 9.0), (-0.8, 0.4, 9.0)])
    faces = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    floor = replace(wall(1, board=False), vertices=corners, faces=faces)
    columns, rows = np.meshgrid(*(np.arange(n) + 0.5 for n in SIZE))
    rays = view.rays(np.column_stack([columns.ravel(), rows.ravel()]))
    with np.errstate(divide="ignore"):
        depths = np.clip((0.4 - view.center[1]) / rays[:, 1], 0, 20)
    depths[rays[:, 1] <= 0] = 20
    gray = np.uint8(np.rint(10 * depths)).reshape(SIZE[::-1])
    cv2.imwrite(str(tmp_path / view.name), np.dstack([gray, gray, gray]))
    mesh, _ = textured(floor, [view], Images(tmp_path), 1024, 1)
    points, colors = middles(mesh)
    np.testing.assert_allclose(colors[:, 0], 10 * points[:, 2], atol=4)


def test_gains_of_views_are_recovered(tmp_path):
    views = [make_view(i) for i in range(4)]
    images = write_images(tmp_path, views, LIGHTS)
    gains = find_gains(find_seen_faces(wall(16), views, images, 1), 4)
    expected = np.log(LIGHTS) - np.log(LIGHTS).mean()
    np.testing.assert_allclose(gains, np.tile(expected[:, None], 3), atol=0.02)
    mesh, _ = textured(wall(16), views, images, 1024, 1)
    light = np.exp(np.log(LIGHTS).mean())
    on_wall = middles(mesh)[0][:, 2] > 1.5
    assert errors(mesh, light)[on_wall].max() < 12


def test_masked_pixels_are_not_in_the_texture(tmp_path):
    """A person before the wall of whom the mesh knows nothing."""
    views = [make_view(i) for i in range(4)]
    images, masks = tmp_path / "images", tmp_path / "masks"
    images.mkdir(), masks.mkdir()
    write_images(images, views, [1] * 4)
    for view in views:
        picture = cv2.imread(str(images / view.name))
        mask = 255 * np.uint8((picture != BOARD_COLOR[::-1]).any(axis=2))
        cv2.imwrite(str(masks / f"{view.name}.png"), mask)
    found, _ = textured(wall(16, board=False), views, Images(images, masks), 1024, 1)
    assert errors(found).max() < 12
    ghost, _ = textured(wall(16, board=False), views[1:2], Images(images), 1024, 1)
    assert errors(ghost).max() > 60, "the check would see it"


def test_triangles_without_view_take_the_colours_of_neighbours(tmp_path):
    views = [make_view(i) for i in range(4)]
    mesh = wall(8, board=False)
    behind = replace(mesh, vertices=mesh.vertices * [1, 1, -1], faces=mesh.faces)
    images = write_images(tmp_path, views, [1] * 4, board=False)
    found, counts = textured(behind, views, images, 256, 1)
    assert counts["faces_without_view"] == len(mesh.faces)
    assert np.abs(middles(found)[1] - 7).max() < 6, "the colours of vertices, if nothing is seen"
    far = replace(mesh, vertices=mesh.vertices * [3, 1, 1])
    found, counts = textured(far, views, images, 1024, 1)
    assert 0 < counts["faces_without_view"] < len(mesh.faces)
    near_seen = middles(found)[1]
    assert near_seen.min() > 30


def test_the_size_is_bounded(tmp_path):
    views = [make_view(i) for i in range(4)]
    images = write_images(tmp_path, views, [1] * 4)
    for size in (64, 300, 1024):
        found, counts = textured(wall(8), views, images, size, 1)
        assert max(found.texture.picture.shape) <= size
        assert (counts["texture_scale"] < 1) == (size < 1024)
        assert np.median(errors(found)) < 12
    with pytest.raises(ColmapEdgesError, match="raise texture_size"):
        packing.packed(np.tile([0.0, 0.0, 5.0, 5.0], (10_000, 1)), 64)


def test_unreadable_images_are_left_out(tmp_path):
    views = [make_view(i) for i in range(4)]
    images = write_images(tmp_path, views, [1] * 4)
    (tmp_path / "0.png").write_bytes(b"damaged")
    found, counts = textured(wall(16), views, images, 1024, 1)
    assert counts["views_used"] <= 3
    assert np.median(errors(found)) < 3


def test_threads_do_not_change_the_texture(tmp_path):
    views = [make_view(i) for i in range(4)]
    images = write_images(tmp_path, views, LIGHTS)
    one, two = (textured(wall(12), views, images, 512, threads)[0] for threads in (1, 3))
    assert one.texture.jpeg == two.texture.jpeg
    np.testing.assert_array_equal(one.texture.points, two.texture.points)


def test_charts_do_not_overlap():
    rng = np.random.default_rng(3)
    lows = rng.uniform(0, 900, (200, 2))
    found = packing.packed(np.column_stack([lows, lows + rng.uniform(0, 90, (200, 2))]), 512)
    used = np.zeros(found.shape, int)
    for (x, y), (width, height) in zip(found.places, found.sizes, strict=True):
        used[y : y + height, x : x + width] += 1
        assert x >= 0 and y >= 0 and x + width <= 512 and y + height <= found.shape[0]
    assert used.max() == 1 and found.scale < 1


def test_triangles_are_cut_before_the_camera():
    local = np.array([(0.0, 0, 2), (1, 0, 2), (0, 1, -2), (1, 1, -2), (5, 5, 2), (0, 0, -2)])
    faces = np.array([[0, 1, 2], [2, 0, 3], [0, 4, 1], [2, 3, 5]], np.int32)
    points, cut = cut_in_front(local, faces)
    assert points[cut][:, :, 2].min() > 0
    areas = [np.linalg.norm(np.cross(b - a, c - a)) / 2 for a, b, c in points[cut]]
    whole = [np.linalg.norm(np.cross(b - a, c - a)) / 2 for a, b, c in local[faces]]
    # At near = 0.02, a corner ahead keeps a share (1.98 / 4)^2 of its triangle.
    share = (1.98 / 4) ** 2
    behind = 1 - (2.02 / 4) ** 2
    assert sum(areas) == pytest.approx(behind * whole[0] + share * whole[1] + whole[2], rel=1e-6)


def test_the_report_has_the_texture(tmp_path):
    views = [make_view(i) for i in range(4)]
    images = write_images(tmp_path, views, [1] * 4)
    mesh, _ = textured(wall(8), views, images, 1024, 1)
    layer = mesh_layer(mesh, mesh.vertices.min(axis=0), mesh.vertices.max(axis=0))
    assert layer["texture"].startswith("data:image/jpeg;base64,")
    x = layer["x"]["low"] + layer["x"]["step"] * layer["x"]["steps"]
    corners = layer["corners"].reshape(3, -1).T
    np.testing.assert_allclose(x[corners], mesh.vertices[mesh.faces][:, :, 0], atol=1e-3)
    at = layer["texture_points"]["y"]
    y = at["low"] + at["step"] * at["steps"]
    expected = mesh.texture.points[mesh.texture.corners][:, :, 1]
    np.testing.assert_allclose(y[corners], expected, atol=1e-4)


@pytest.mark.parametrize("suffix", [".obj", ".glb"])
def test_programs_read_the_texture(tmp_path, suffix):
    """Colours at known points of the wall, as trimesh and MeshLab find them, and read_mesh."""
    pytest.importorskip("PIL", reason="trimesh reads textures by Pillow")
    views = [make_view(i) for i in range(4)]
    images = write_images(tmp_path, views, [1] * 4)
    mesh, _ = textured(wall(16), views, images, 512, 1)
    path = tmp_path / "out" / f"mesh{suffix}"
    path.parent.mkdir()
    write_mesh(mesh, path, up="z", unit="m")
    read = trimesh.load(path, force="mesh", process=False)
    colors = read.visual.to_color().vertex_colors[:, :3].astype(float)
    x, y, z = read.vertices.T  # y up
    points = np.column_stack([x, -z, y])
    on_wall = points[:, 2] > 1.5
    assert np.median(np.abs(colors - painted(points))[on_wall]) < 3
    meshes = pymeshlab.MeshSet()
    meshes.load_new_mesh(str(path))
    assert meshes.current_mesh().face_number() == len(mesh.faces)
    if suffix == ".obj":
        assert meshes.current_mesh().texture_number() == 1
    again = read_mesh(path)
    assert again.texture.jpeg == mesh.texture.jpeg
    np.testing.assert_allclose(middles(again)[0], middles(mesh)[0], atol=1e-6)
    np.testing.assert_allclose(middles(again)[1], middles(mesh)[1])
    moved = tmp_path / "moved.glb"
    write_mesh(again, moved)
    assert len(read_mesh(moved).vertices) == len(mesh.vertices)
