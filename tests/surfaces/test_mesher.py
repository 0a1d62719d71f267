"""The mesher on analytic solids, on malformed and degenerate input, and its invariances."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from solid_points import as_trimesh, fibonacci_sphere

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.meshes import read_mesh, write_mesh
from colmap_edges.images.background import BackgroundRays
from colmap_edges.options import MeshingOptions
from colmap_edges.surfaces import mesher as meshing
from colmap_edges.surfaces.mesh import spread_colors
from colmap_edges.surfaces.simplify import simplify

pytest.importorskip("colmap_edges._mesher", reason="the CGAL extension is not built")

OPTIONS = MeshingOptions()


def visible_if_facing(points, normals, centers):
    """Every point is seen by the cameras on the outer side of its tangent plane."""
    facing = ((centers[None] - points[:, None]) * normals[:, None]).sum(2) > 1e-9
    offsets = np.concatenate([[0], np.cumsum(facing.sum(1))])
    return offsets.astype(np.int64), np.nonzero(facing)[1].astype(np.int32)


def sphere_scene(count=800, num_cameras=40):
    points = fibonacci_sphere(count)
    centers = 3 * fibonacci_sphere(num_cameras)
    return points, *visible_if_facing(points, points, centers), centers


def box_scene(step=0.1):
    """A regular grid of coplanar points on each side of the unit cube."""
    ticks = np.arange(0, 1 + step / 2, step)
    u, v = (a.ravel() for a in np.meshgrid(ticks, ticks))
    points, normals = [], []
    for axis in range(3):
        for side in (0.0, 1.0):
            face, normal = np.zeros((len(u), 3)), np.zeros((len(u), 3))
            face[:, axis], face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = side, u, v
            normal[:, axis] = 2 * side - 1
            points.append(face)
            normals.append(normal)
    points, normals = np.concatenate(points), np.concatenate(normals)
    centers = 0.5 + 2.5 * fibonacci_sphere(30)
    return points, *visible_if_facing(points, normals, centers), centers


def face_set(mesh):
    """The triangles as sorted triples of positions' input indices."""
    return {tuple(sorted(face)) for face in mesh.point3D_ids[mesh.faces].tolist()}


def assert_manifold(mesh):
    """Every edge has one or two faces, turning the same way; faces around a vertex form one fan."""
    sides = np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    assert len(np.unique(sides, axis=0)) == len(sides), "a directed edge occurs twice"
    assert len(np.unique(mesh.faces)) == len(mesh.vertices), "a vertex is unused"
    around = [[] for _ in mesh.vertices]
    for a, b, c in mesh.faces.tolist():
        for v, p, q in ((a, b, c), (b, c, a), (c, a, b)):
            around[v].append((p, q))
    for links in around:
        starts, nexts = {p for p, _ in links}, dict(links)
        begin = next(iter(starts - set(nexts.values())), links[0][0])
        walked, at = 0, begin
        while at in nexts and walked < len(links):
            at, walked = nexts[at], walked + 1
        assert walked == len(links), "the faces around a vertex form several fans"
    for count, borders in euler_characteristics(mesh):
        # 2 - 2g - b, of a component of genus g with b borders.
        assert (count + borders) % 2 == 0 and count + borders <= 2, "no orientable surface"


def euler_characteristics(mesh):
    """Of each component: vertices less edges plus faces, and the number of border loops."""
    count = len(mesh.vertices)
    sides = np.concatenate([mesh.faces[:, [k, (k + 1) % 3]] for k in range(3)])
    edges = np.unique(np.sort(sides, axis=1), axis=0)
    pieces, piece_of = components_of(edges, count)
    twins = {(b, a) for a, b in sides.tolist()}
    border = [side for side in sides.tolist() if tuple(side) not in twins]
    border = np.array(border, np.int64).reshape(-1, 2)
    _, loop_of = components_of(border, count)
    on_border = np.unique(border)
    _, first = np.unique(loop_of[on_border], return_index=True)
    numbers = (
        np.bincount(piece_of, minlength=pieces)
        - np.bincount(piece_of[edges[:, 0]], minlength=pieces)
        + np.bincount(piece_of[mesh.faces[:, 0]], minlength=pieces)
    )
    return zip(numbers, np.bincount(piece_of[on_border[first]], minlength=pieces), strict=True)


def components_of(edges, count):
    graph = coo_matrix((np.ones(len(edges)), tuple(edges.T.astype(np.int64))), (count, count))
    return connected_components(graph, directed=False)


def test_sphere_is_watertight_and_round():
    mesh = meshing.mesh_points(*sphere_scene(), OPTIONS)
    solid = as_trimesh(mesh)
    assert solid.is_watertight and solid.is_winding_consistent
    assert solid.euler_number == 2
    assert len(mesh.vertices) == 800
    assert 0.97 < solid.volume / (4 / 3 * np.pi) < 1


@pytest.mark.parametrize("exponent", [-1040, -1000, -500, 500, 900])
def test_extreme_scales_do_not_matter(exponent):
    points, *tracks, centers = sphere_scene(200, 10)
    usual = meshing.mesh_points(points, *tracks, centers, OPTIONS)
    scaled = (np.ldexp(points, exponent), *tracks, np.ldexp(centers, exponent))
    mesh = meshing.mesh_points(*scaled, OPTIONS)
    if exponent > -1022:  # smaller numbers have fewer digits
        np.testing.assert_array_equal(mesh.faces, usual.faces)
        np.testing.assert_array_equal(np.ldexp(mesh.vertices, -exponent), usual.vertices)
    assert len(mesh.faces) > 100


def test_cameras_at_infinity_are_an_error():
    points, *tracks, centers = sphere_scene(200, 10)
    for factor in (1e-310, 1e-300, 1e-200):
        with pytest.raises(ColmapEdgesError, match="all 200 points lie within"):
            meshing.mesh_points(points * factor, *tracks, centers, OPTIONS)


def test_box_of_grids_is_exact():
    mesh = meshing.mesh_points(*box_scene(), OPTIONS)
    solid = as_trimesh(mesh)
    assert_manifold(mesh)
    assert solid.is_watertight and solid.euler_number == 2
    assert solid.volume == pytest.approx(1, abs=1e-12)
    assert solid.area == pytest.approx(6, abs=1e-12)


@pytest.mark.parametrize("scale", [1e-3, 1e3, 1e-150, 1e100])
def test_scale_does_not_matter(scale):
    points, offsets, cameras, centers = sphere_scene()
    reference = meshing.mesh_points(points, offsets, cameras, centers, OPTIONS)
    scaled = meshing.mesh_points(points * scale, offsets, cameras, centers * scale, OPTIONS)
    assert face_set(scaled) == face_set(reference)


def test_huge_offset_does_not_matter():
    points, offsets, cameras, centers = sphere_scene()
    reference = meshing.mesh_points(points, offsets, cameras, centers, OPTIONS)
    offset = np.array([5e5, 5e6, 300.0])
    moved = meshing.mesh_points(points + offset, offsets, cameras, centers + offset, OPTIONS)
    assert face_set(moved) == face_set(reference)


@given(seed=st.integers(0, 2**31))
@settings(max_examples=10, deadline=None)
def test_order_of_points_and_rays_does_not_matter(seed):
    points, offsets, cameras, centers = sphere_scene(count=300)
    rng = np.random.default_rng(seed)
    points = points * rng.uniform(0.7, 1.3, (len(points), 1))
    reference = meshing.mesh_points(points, offsets, cameras, centers, OPTIONS)
    order = rng.permutation(len(points))
    rows = [rng.permutation(cameras[offsets[i] : offsets[i + 1]]) for i in order]
    shuffled = meshing.mesh_points(
        points[order],
        np.concatenate([[0], np.cumsum([len(row) for row in rows])]),
        np.concatenate(rows),
        centers,
        OPTIONS,
    )
    np.testing.assert_array_equal(shuffled.vertices, reference.vertices)
    np.testing.assert_array_equal(shuffled.faces, reference.faces)
    np.testing.assert_array_equal(order[shuffled.point3D_ids], reference.point3D_ids)


def test_number_of_threads_does_not_matter():
    scene = noisy_scene(np.random.default_rng(1), 2000)
    one = meshing.mesh_points(*scene, OPTIONS, num_threads=1)
    many = meshing.mesh_points(*scene, OPTIONS, num_threads=7)
    np.testing.assert_array_equal(one.faces, many.faces)
    np.testing.assert_array_equal(one.vertices, many.vertices)


def noisy_scene(rng, count, num_cameras=12):
    """Random points, each seen by random cameras: as contradictory as rays can be."""
    points, centers = rng.normal(size=(count, 3)), 2 * rng.normal(size=(num_cameras, 3))
    counts = rng.integers(0, 5, count)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    return points, offsets, rng.integers(0, num_cameras, offsets[-1]).astype(np.int32), centers


@given(seed=st.integers(0, 2**31), grid=st.booleans())
@settings(max_examples=40, deadline=None)
def test_contradictory_rays_make_a_manifold(seed, grid):
    rng = np.random.default_rng(seed)
    points, offsets, cameras, centers = noisy_scene(rng, 300)
    if grid:
        points, centers = np.rint(3 * points), np.rint(3 * centers)
    options = replace(OPTIONS, quality_weight=0.0, long_facet_factor=float(rng.choice([0, 0.5, 2])))
    mesh = meshing.mesh_points(points, offsets, cameras, centers, options)
    assert_manifold(mesh)


def test_duplicates_unite_their_cameras():
    points, offsets, cameras, centers = sphere_scene()
    reference = meshing.mesh_points(points, offsets, cameras, centers, OPTIONS)
    counts = np.diff(offsets)
    first = np.repeat(np.arange(len(points)), counts), np.arange(len(cameras)) % 2 == 0
    rows = [np.bincount(first[0][keep], minlength=len(points)) for keep in (first[1], ~first[1])]
    split = meshing.mesh_points(
        np.concatenate([points, points]),
        np.concatenate([[0], np.cumsum(np.concatenate(rows))]),
        np.concatenate([cameras[first[1]], cameras[~first[1]]]),
        centers,
        OPTIONS,
    )
    np.testing.assert_array_equal(split.faces, reference.faces)
    assert split.stats["points_duplicate"] == len(points)


def wound_ring(turns, jitter=1e-4):
    """The sphere, and an edge that runs many times round it, each time a hair beside itself."""
    points, offsets, cameras, centers = sphere_scene()
    angles = np.linspace(0, 2 * np.pi * turns, 100 * turns, endpoint=False)
    ring = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=1)
    ring += np.random.default_rng(0).normal(0, jitter, ring.shape)
    seen = [np.flatnonzero(centers @ p > 1) for p in ring]
    offsets = np.concatenate([offsets, offsets[-1] + np.cumsum([len(row) for row in seen])])
    cameras = np.concatenate([cameras, *seen]).astype(np.int32)
    indices = np.arange(len(points), len(points) + len(ring), dtype=np.int32)
    lines = meshing.Polylines(indices, np.array([0, len(ring)]), np.zeros(1, bool))
    return (np.concatenate([points, ring]), offsets, cameras, centers), lines


def test_edges_that_run_beside_themselves_become_one():
    once = meshing.mesh_points(*wound_ring(1)[0], OPTIONS, wound_ring(1)[1])
    scene, lines = wound_ring(60)
    often = meshing.mesh_points(*scene, OPTIONS, lines)
    kept = meshing.mesh_points(*scene, replace(OPTIONS, merge_factor=0), lines)
    assert once.stats["points_merged"] == kept.stats["points_merged"] == 0
    assert often.stats["points_merged"] == 59 * 100
    assert often.stats["cells"] < 1.1 * once.stats["cells"] < 0.5 * kept.stats["cells"]
    assert len(often.vertices) == pytest.approx(len(once.vertices), abs=3)
    assert_manifold(often)
    assert as_trimesh(often).volume == pytest.approx(as_trimesh(once).volume, rel=1e-3)


def test_merging_does_not_depend_on_order_and_scale():
    scene, lines = wound_ring(10, jitter=2e-3)
    mesh = meshing.mesh_points(*scene, OPTIONS, lines)
    assert 0 < mesh.stats["points_merged"] < 9 * 100
    points, offsets, cameras, centers = scene
    larger = meshing.mesh_points(1e5 * points, offsets, cameras, 1e5 * centers, OPTIONS, lines)
    assert larger.stats["points_merged"] == mesh.stats["points_merged"]
    backwards = lines._replace(point_indices=lines.point_indices[::-1])
    np.testing.assert_array_equal(meshing.mesh_points(*scene, OPTIONS, backwards).faces, mesh.faces)


HOLE, THICKNESS = 0.4, 0.3


def is_plate(points):
    """Whether points are inside a square plate with a square hole."""
    x, y, z = np.abs(points - [0, 0, THICKNESS / 2]).T
    return (np.maximum(x, y) <= 1) & (np.maximum(x, y) >= HOLE) & (z <= THICKNESS / 2)


def plate_scene(scale=1.0):
    """Points on the rims of the plate, above all on none of its faces, and rays that miss it."""
    ticks = np.linspace(-1, 1, 41)
    sides = [np.column_stack([ticks, np.full(41, side)]) for side in (-1, 1)]
    square = np.concatenate([*sides, *(side[:, ::-1] for side in sides)])
    centers = 4 * fibonacci_sphere(30) + [0, 0, THICKNESS / 2]
    points, seen = [], []
    for size in (1, HOLE):
        for height in (0, THICKNESS):
            rim = np.column_stack([size * square, np.full(len(square), height)])
            for point in rim:
                steps = np.linspace(1e-3, 1, 500)[:, None]
                sight = (steps * (c - point) + point for c in centers)
                points.append(point)
                seen.append([i for i, line in enumerate(sight) if not is_plate(line).any()])
    offsets = np.concatenate([[0], np.cumsum([len(row) for row in seen])])
    targets = np.column_stack(
        [np.random.default_rng(0).uniform(-1.5, 1.5, (600, 2)), np.zeros(600)]
    )
    cameras, directions = [], []
    for index, center in enumerate(centers):
        lines = center + np.linspace(0, 2, 1000)[:, None, None] * (targets - center)
        free = ~is_plate(lines.reshape(-1, 3)).reshape(1000, -1).any(axis=0)
        cameras.append(np.full(free.sum(), index, np.int32))
        directions.append((targets - center)[free])
    rays = BackgroundRays(np.concatenate(cameras), np.concatenate(directions))
    visible = np.concatenate(seen).astype(np.int32)
    return (scale * np.array(points), offsets, visible, scale * centers), rays


def blocked_share(mesh, rays, centers):
    """Share of lines of sight that meet a mesh, whatever the side."""
    found = as_trimesh(mesh).ray.intersects_any(centers[rays.cameras], rays.directions)
    return found.mean()


def test_lines_of_sight_to_the_background_open_holes():
    scene, rays = plate_scene()
    closed = meshing.mesh_points(*scene, OPTIONS)
    options = replace(OPTIONS, long_facet_factor=0.0)
    opened = meshing.mesh_points(*scene, options, background=rays)
    assert opened.stats["background_rays"] == len(rays.cameras)
    assert blocked_share(closed, rays, scene[3]) > 0.03
    assert blocked_share(opened, rays, scene[3]) < 5e-4, "but for a ray that grazes the rim"
    solid = as_trimesh(opened)
    assert solid.is_watertight
    assert solid.volume == pytest.approx((4 - (2 * HOLE) ** 2) * THICKNESS, rel=0.02)
    assert (opened.point3D_ids >= 0).all(), "no camera is in the mesh"
    unused = meshing.mesh_points(*scene, replace(OPTIONS, background_weight=0), background=rays)
    np.testing.assert_array_equal(unused.faces, closed.faces)


def test_background_rays_vote_when_space_is_carved():
    scene, rays = plate_scene()
    options = replace(OPTIONS, method="carve")
    closed = blocked_share(meshing.mesh_points(*scene, options), rays, scene[3])
    opened = blocked_share(meshing.mesh_points(*scene, options, background=rays), rays, scene[3])
    assert opened < 0.2 * closed


def test_order_scale_and_threads_do_not_matter_to_background_rays():
    scene, rays = plate_scene()
    reference = meshing.mesh_points(*scene, OPTIONS, num_threads=1, background=rays)
    order = np.random.default_rng(0).permutation(len(rays.cameras))
    longer = np.random.default_rng(1).uniform(1e-3, 1e3, (len(order), 1))
    mixed = BackgroundRays(rays.cameras[order], rays.directions[order] * longer[order])
    points, offsets, cameras, centers = scene
    again = meshing.mesh_points(*scene, OPTIONS, num_threads=3, background=mixed)
    np.testing.assert_array_equal(again.faces, reference.faces)
    larger = meshing.mesh_points(
        1e6 * points, offsets, cameras, 1e6 * centers, OPTIONS, background=rays
    )
    assert face_set(larger) == face_set(reference)


@pytest.mark.parametrize(
    ("cameras", "directions", "message"),
    [
        ([0, 30], np.ones((2, 3)), "background holds index 30 of 30"),
        ([0], np.ones((2, 3)), "1 cameras and 2 directions"),
        ([0], np.zeros((1, 3)), "finite and not 0"),
        ([0], np.full((1, 3), np.nan), "finite and not 0"),
    ],
)
def test_background_rays_have_to_fit(cameras, directions, message):
    rays = BackgroundRays(np.array(cameras, np.int32), directions)
    with pytest.raises(ValueError, match=message):
        meshing.mesh_points(*box_scene(), OPTIONS, background=rays)


def test_points_that_are_not_finite_are_dropped_and_counted():
    points, offsets, cameras, centers = sphere_scene()
    reference = meshing.mesh_points(points, offsets, cameras, centers, OPTIONS)
    extra = np.array([[np.nan, 0, 0], [0, np.inf, 0]])
    mesh = meshing.mesh_points(
        np.concatenate([points, extra]),
        np.concatenate([offsets, [offsets[-1] + 1, offsets[-1] + 2]]),
        np.concatenate([cameras, [0, 1]]).astype(np.int32),
        centers,
        OPTIONS,
    )
    np.testing.assert_array_equal(mesh.faces, reference.faces)
    assert mesh.stats["points_not_finite"] == 2


@pytest.mark.parametrize("seed", [4, 6, 21, 22])
def test_rays_in_the_plane_of_points(seed):
    """Facets may contain such a ray, with corners far behind the point that it starts from."""
    rng = np.random.default_rng(seed)
    plane = np.linalg.svd(np.array([[0.3, 0.5, 0.8]]))[2][1:]
    near, wide = rng.normal(0, 0.01, (400, 2)), rng.uniform(-5, 5, (60, 2))
    points = np.concatenate([np.concatenate([near, wide]) @ plane, rng.normal(0, 3, (100, 3))])
    centers = rng.uniform(-5, 5, (6, 2)) @ plane
    cameras = np.concatenate([np.sort(rng.choice(6, 3, replace=False)) for _ in points])
    offsets = 3 * np.arange(len(points) + 1)
    mesh = meshing.mesh_points(points, offsets, cameras.astype(np.int32), centers, OPTIONS)
    assert_manifold(mesh)


def test_points_on_cameras_and_rays_through_vertices():
    grid = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), -1).reshape(-1, 3)
    centers = grid[[0, 62, 124]]
    offsets = np.arange(len(grid) + 1) * 3
    cameras = np.tile(np.arange(3, dtype=np.int32), len(grid))
    mesh = meshing.mesh_points(grid, offsets, cameras, centers, OPTIONS)
    assert mesh.stats["rays_of_zero_length"] == 3
    assert_manifold(mesh)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((0, 3)),
        np.zeros((10, 3)),
        np.full((10, 3), np.nan),
        np.eye(3),
        np.outer(np.arange(10.0), [1, 2, 3]),
        np.column_stack([fibonacci_sphere(50)[:, :2], np.zeros(50)]),
    ],
    ids=["none", "one place", "nan", "three", "line", "plane"],
)
def test_points_without_volume_are_one_clear_line(points):
    offsets = np.arange(len(points) + 1)
    with pytest.raises(ColmapEdgesError, match=r"^[^\n]*span no volume[^\n]*$"):
        meshing.mesh_points(
            points, offsets, np.zeros(len(points), np.int32), np.ones((1, 3)), OPTIONS
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"cameras": [40]}, "index 40 of 40"),
        ({"cameras": [-1]}, "index -1 of 40"),
        ({"offsets": [0]}, "offsets"),
        ({"offsets": [1, *range(2, 801), 800]}, "offsets"),
        ({"centers": np.full((40, 3), np.nan)}, "finite"),
    ],
)
def test_arrays_that_do_not_fit_raise_value_error(change, message):
    points, offsets, cameras, centers = sphere_scene()
    cameras = np.concatenate([change.get("cameras", []), cameras[1:]]).astype(np.int32)
    cameras = cameras if "cameras" in change else sphere_scene()[2]
    offsets = np.array(change.get("offsets", offsets))
    with pytest.raises(ValueError, match=message):
        meshing.mesh_points(points, offsets, cameras, change.get("centers", centers), OPTIONS)


def test_one_camera_sees_a_height_field():
    x, y = np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-1, 1, 20))
    points = np.column_stack([x.ravel(), y.ravel(), 0.1 * np.sin(3 * x).ravel()])
    offsets = np.arange(len(points) + 1)
    mesh = meshing.mesh_points(
        points, offsets, np.zeros(len(points), np.int32), np.array([[0, 0, 3.0]]), OPTIONS
    )
    assert_manifold(mesh)
    upward = as_trimesh(mesh).face_normals[:, 2] > 0
    assert as_trimesh(mesh).area_faces[upward].sum() > 3.5


def floor_scene(*patches):
    """Points on a bumpy floor around the origin, ten units under four cameras."""
    points = np.concatenate([grid_on_floor(*patch) for patch in patches])
    centers = np.array([[x, y, 10.0] for x in (-1, 1) for y in (-1, 1)])
    offsets = 4 * np.arange(len(points) + 1)
    return points, offsets, np.tile(np.arange(4, dtype=np.int32), len(points)), centers


def grid_on_floor(side, half_width):
    x, y = (a.ravel() for a in np.meshgrid(*[np.linspace(-half_width, half_width, side)] * 2))
    return np.column_stack([x, y, 0.5 * half_width * np.sin(5 * x) * np.cos(7 * y)])


def upward_area(mesh):
    solid = as_trimesh(mesh)
    return (solid.area_faces * np.maximum(solid.face_normals[:, 2], 0)).sum()


def test_dense_points_tear_no_holes_in_the_coarse_surface():
    coarse = meshing.mesh_points(*floor_scene((7, 4.0)), OPTIONS)
    both = meshing.mesh_points(*floor_scene((7, 4.0), (60, 0.01)), OPTIONS)
    assert both.stats["long_facets_dropped"] == coarse.stats["long_facets_dropped"]
    assert upward_area(coarse) == pytest.approx(64, rel=0.05)
    assert upward_area(both) == pytest.approx(64, rel=0.05)


def test_long_triangles_are_dropped():
    points, offsets, cameras, centers = floor_scene((9, 1.0), (9, 1.0))
    points[81:] += [10.0, 0.1, 0]
    bridged = meshing.mesh_points(
        points, offsets, cameras, centers, replace(OPTIONS, long_facet_factor=0.0)
    )
    apart = meshing.mesh_points(points, offsets, cameras, centers, OPTIONS)
    assert upward_area(bridged) > 20
    assert upward_area(apart) == pytest.approx(8, rel=0.1)
    assert apart.stats["long_facets_dropped"] > 0


def test_simplified_sphere_stays_a_sphere():
    points, offsets, cameras, centers = sphere_scene()
    shift = np.array([5e6, -2e6, 100.0])
    mesh = meshing.mesh_points(points + shift, offsets, cameras, centers + shift, OPTIONS)
    colors = np.rint(127 * points + 127).astype(np.uint8)[mesh.point3D_ids]
    simple = simplify(replace(mesh, colors=colors), 300)
    solid = as_trimesh(simple)
    assert len(simple.faces) <= 300 and solid.is_watertight and solid.euler_number == 2
    assert_manifold(simple)
    np.testing.assert_allclose(np.linalg.norm(simple.vertices - shift, axis=1), 1, atol=0.03)
    assert np.abs(127 * (simple.vertices - shift) + 127 - simple.colors).max() < 25
    assert simplify(mesh, len(mesh.faces)) is mesh


def test_edges_without_solid_weight_leave_nothing_solid():
    scene = sphere_scene()
    count = len(scene[0])
    edges = meshing.Polylines(np.arange(count, dtype=np.int32), np.array([0, count]), [False])
    for weight, is_empty in ((0.0, True), (1.0, False)):
        options = replace(OPTIONS, edge_solid_weight=weight, min_segment_factor=0.0)
        mesh = meshing.mesh_points(*scene, options, edges)
        assert (len(mesh.faces) == 0) == is_empty


def torus_scene(count=3000):
    """A ring of radii 1 and 0.4, seen from outside and from within its hole."""
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0, 2 * np.pi, (2, count))
    normals = np.column_stack([np.cos(v) * np.cos(u), np.cos(v) * np.sin(u), np.sin(v)])
    points = np.column_stack([np.cos(u), np.sin(u), np.zeros(count)]) + 0.4 * normals
    axis = np.column_stack([np.zeros((9, 2)), np.linspace(-1, 1, 9)])
    centers = np.concatenate([4 * fibonacci_sphere(20), axis])
    along = centers[None] - points[:, None]
    seen = (along * normals[:, None]).sum(2) > 0
    inner = np.linspace(0.02, 1, 60)[:, None]
    for i, j in np.argwhere(seen):  # not through the ring itself
        way = points[i] + inner * along[i, j]
        tube = np.hypot(np.hypot(way[:, 0], way[:, 1]) - 1, way[:, 2])
        seen[i, j] = (tube > 0.4).all()
    offsets = np.concatenate([[0], np.cumsum(seen.sum(1))]).astype(np.int64)
    return points, offsets, np.nonzero(seen)[1].astype(np.int32), centers


@pytest.mark.parametrize(
    ("scene", "euler_number", "volume"),
    [(sphere_scene, 2, 4 / 3 * np.pi), (box_scene, 2, 1.0), (torus_scene, 0, 0.32 * np.pi**2)],
)
def test_euler_characteristic_of_solids(scene, euler_number, volume):
    mesh = meshing.mesh_points(*scene(), replace(OPTIONS, min_component_faces=100))
    solid = as_trimesh(mesh)
    assert_manifold(mesh)
    assert solid.is_watertight and solid.euler_number == euler_number
    assert solid.volume == pytest.approx(volume, rel=0.01)


# The published settings of the paper's mesher, whose rays vote for free space only.
PAPER_VOTES = {"vote_near": 0.2, "vote_behind": 0.0, "vote_threshold": 1.0}


@pytest.mark.parametrize("votes", [{}, PAPER_VOTES], ids=["default", "paper"])
@pytest.mark.parametrize("method", ["carve", "manifold"])
@pytest.mark.parametrize("scene", [sphere_scene, torus_scene])
def test_votes_find_the_solids(scene, method, votes):
    mesh = meshing.mesh_points(*scene(), replace(OPTIONS, method=method, **votes))
    assert_manifold(mesh)
    volume = 4 / 3 * np.pi if scene is sphere_scene else 0.32 * np.pi**2
    assert abs(as_trimesh(mesh).volume) == pytest.approx(volume, rel=0.04)


def balls_scene(noise, side=3, count=150, radius=0.35):
    """A lattice of balls, seen from all around where no other ball is in between."""
    middles = np.stack(np.meshgrid(*[np.arange(side)] * 3), -1).reshape(-1, 3) - (side - 1) / 2
    normals = np.tile(fibonacci_sphere(count), (len(middles), 1))
    points = np.repeat(middles, count, axis=0) + radius * normals
    is_other = np.repeat(np.arange(len(middles)), count)[:, None] != np.arange(len(middles))
    centers, seen = 5 * fibonacci_sphere(40), []
    for center in centers:
        along = (center - points) / np.linalg.norm(center - points, axis=1, keepdims=True)
        to_middles = middles - points[:, None]
        depth = (to_middles * along[:, None]).sum(2)
        miss = np.linalg.norm(to_middles - depth[..., None] * along[:, None], axis=2)
        is_hidden = ((miss < radius) & (depth > 0) & is_other).any(axis=1)
        seen.append(((along * normals).sum(1) > 0) & ~is_hidden)
    is_seen = np.column_stack(seen)
    offsets = np.concatenate([[0], np.cumsum(is_seen.sum(1))]).astype(np.int64)
    points = points + np.random.default_rng(0).normal(0, noise, points.shape)
    return points, offsets, np.nonzero(is_seen)[1].astype(np.int32), centers


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05])
def test_the_sweep_gets_round_every_ball(noise):
    """Free space goes round 27 balls, of which noise makes the votes touch in hundreds of places.

    A region that grows from one cell has to close around each; where it is cornered, balls stay
    joined and free space stays solid.
    """
    scene = balls_scene(noise)
    options = replace(OPTIONS, long_facet_factor=0.0)
    mesh = meshing.mesh_points(*scene, replace(options, method="manifold"))
    carved = meshing.mesh_points(*scene, replace(options, method="carve"))
    solid = as_trimesh(mesh)
    assert_manifold(mesh)
    assert mesh.stats["vertices_split"] == mesh.stats["edges_split"] == 0
    assert solid.is_watertight and solid.euler_number == 27 * 2
    assert solid.volume == pytest.approx(as_trimesh(carved).volume, rel=0.05)


@given(seed=st.integers(0, 2**31), grid=st.booleans())
@settings(max_examples=40, deadline=None)
def test_the_sweep_needs_no_splitting(seed, grid):
    points, offsets, cameras, centers = noisy_scene(np.random.default_rng(seed), 300)
    if grid:
        points, centers = np.rint(3 * points), np.rint(3 * centers)
    options = replace(OPTIONS, method="manifold", long_facet_factor=0.0)
    mesh = meshing.mesh_points(points, offsets, cameras, centers, options)
    assert_manifold(mesh)
    assert mesh.stats["vertices_split"] == mesh.stats["edges_split"] == 0


@pytest.mark.parametrize("method", ["carve", "manifold"])
def test_single_wrong_rays_open_no_surface(method):
    points, offsets, cameras, centers = sphere_scene()
    wrong = [int(np.argmin(centers @ point)) for point in points[::100]]  # through the sphere
    cameras = np.insert(cameras, offsets[1::100], wrong).astype(np.int32)
    offsets = offsets + np.concatenate([[0], np.cumsum(np.arange(len(points)) % 100 == 0)])
    scene = points, offsets, cameras, centers
    mesh = meshing.mesh_points(*scene, replace(OPTIONS, method=method))
    carved = meshing.mesh_points(*scene, replace(OPTIONS, method="carve", **PAPER_VOTES))
    assert_manifold(mesh)
    assert as_trimesh(mesh).volume == pytest.approx(4 / 3 * np.pi, rel=0.04)
    assert as_trimesh(carved).volume < 2, "the paper's votes stand no wrong ray"


def test_huge_coordinates_do_not_matter():
    points, offsets, cameras, centers = sphere_scene()
    shift = np.array([500_000.0, 5_000_000.0, 300.0])
    reference = meshing.mesh_points(points, offsets, cameras, centers, OPTIONS)
    moved = meshing.mesh_points(points + shift, offsets, cameras, centers + shift, OPTIONS)
    assert as_trimesh(moved).is_watertight
    assert face_set(moved) == face_set(reference)
    np.testing.assert_array_equal(moved.vertices, (points + shift)[moved.point3D_ids])


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_written_mesh_is_read_back(tmp_path, suffix):
    mesh = meshing.mesh_points(*sphere_scene(), OPTIONS)
    mesh = replace(mesh, colors=np.full((len(mesh.vertices), 3), [10, 200, 30], np.uint8))
    path = tmp_path / f"mesh{suffix}"
    write_mesh(mesh, path)
    read = trimesh.load(path, force="mesh", process=False)
    y_up = mesh.vertices if suffix == ".ply" else mesh.vertices[:, [0, 2, 1]] * (1, 1, -1)
    np.testing.assert_allclose(read.vertices, y_up, atol=1e-6)
    np.testing.assert_array_equal(read.faces, mesh.faces)
    np.testing.assert_array_equal(read.visual.vertex_colors[:, :3], mesh.colors)
    for up in ("z", "-y", (0.1, -0.7, 0.4)):
        write_mesh(mesh, path, up=up, unit="cm")
        again = read_mesh(path)
        np.testing.assert_allclose(again.vertices, mesh.vertices, atol=1e-6)
        np.testing.assert_array_equal(again.faces, mesh.faces)
        np.testing.assert_array_equal(again.colors, mesh.colors)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
@pytest.mark.parametrize("shift", [0, 5.7e6, 1e9])
def test_a_mesh_far_from_the_origin_keeps_its_shape(tmp_path, suffix, shift):
    mesh = meshing.mesh_points(*sphere_scene(), OPTIONS)
    moved = replace(mesh, vertices=mesh.vertices + shift)
    assert write_mesh(moved, tmp_path / f"mesh{suffix}") == (shift > 0)
    read = read_mesh(tmp_path / f"mesh{suffix}")
    np.testing.assert_allclose(read.vertices, moved.vertices, atol=1e-6, rtol=1e-14)
    np.testing.assert_array_equal(read.faces, mesh.faces)


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".glb"])
def test_a_mesh_without_triangles_is_written(tmp_path, suffix):
    mesh = meshing.mesh_points(*sphere_scene(), OPTIONS)
    nothing = np.zeros((0, 3))
    arrays = {"colors": np.uint8(nothing), "faces": np.int32(nothing)}
    empty = replace(mesh, vertices=nothing, point3D_ids=mesh.point3D_ids[:0], **arrays)
    assert not write_mesh(empty, tmp_path / f"mesh{suffix}")
    assert (tmp_path / f"mesh{suffix}").stat().st_size > 20
    assert read_mesh(tmp_path / f"mesh{suffix}").vertices.shape == (0, 3)


def test_unwritable_mesh_is_one_clear_line(tmp_path):
    mesh = meshing.mesh_points(*sphere_scene(), OPTIONS)
    with pytest.raises(ColmapEdgesError, match="choose one of"):
        write_mesh(mesh, tmp_path / "mesh.xyz")
    with pytest.raises(ColmapEdgesError, match="up is 'w'; give three numbers or one of: x, y"):
        write_mesh(mesh, tmp_path / "mesh.obj", up="w")
    with pytest.raises(ColmapEdgesError, match="unit is 'inch'; give one of: mm, cm"):
        write_mesh(mesh, tmp_path / "mesh.glb", unit="inch")
    with pytest.raises(ColmapEdgesError, match="cannot write the mesh"):
        write_mesh(mesh, tmp_path / "missing" / "mesh.ply")


def test_colors_spread_to_unknown_vertices():
    colors = np.array([[0, 0, 0], [100, 0, 0], [9, 9, 9], [9, 9, 9], [7, 7, 7]], np.uint8)
    faces = np.array([[0, 1, 2], [1, 2, 3]], np.int32)
    known = np.array([True, True, False, False, False])
    spread = spread_colors(colors, known, faces)
    assert spread.tolist() == [[0, 0, 0], [100, 0, 0], [50, 0, 0], [100, 0, 0], [7, 7, 7]]
