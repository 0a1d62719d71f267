"""Invalid arguments of the Python interface are errors of one line, or make no difference."""

import inspect
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pycolmap
import pytest

import colmap_edges
from colmap_edges import ColmapEdgesError, Curves3D, Edges3D, Mesh, fit_curves, mesh, read_edges
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.export.dxf import write_dxf
from colmap_edges.export.edges import write_obj
from colmap_edges.export.edges_json import write_json
from colmap_edges.export.glb import write_glb
from colmap_edges.export.limap import write_structures
from colmap_edges.export.ply import write_ply
from colmap_edges.export.svg import write_svg
from colmap_edges.images.background import BackgroundRays
from colmap_edges.surfaces.faces.finding import NO_FACES
from colmap_edges.surfaces.faces.outlines import Face

NOT_DATA = (None, 5, "x", [], {}, np.zeros((3, 3)), object, True)
NOT_PATHS = (None, 5, b"x", [], "", "a\0b", "\ud800", "x" * 5000, Path("a\0"), np.zeros(2))
NOT_NUMBERS = (None, -1, 10**30, 1.5, "2", True, np.nan, [])


def accepted(call, *arguments):
    """Whether a call works; otherwise it must raise our error, in one line."""
    try:
        call(*arguments)
    except ColmapEdgesError as error:
        assert "\n" not in str(error)
        assert len(str(error)) < 300
        return False
    return True


@np.errstate(over="ignore", invalid="ignore")
def spoiled_arrays(values):
    """Wrong variants of an array, by name; of floats and indices also with wrong values."""
    wrong = {
        "none": None,
        "list": values.tolist(),
        "short": values[:-1],
        "empty": values[:0],
        "deep": values[..., None],
        "text": values.astype(str),
        "object": values.astype(object),
        "half": values.astype(np.float16),
    }
    numbers = {"f": (np.nan, np.inf, 1e308, -1e200, 1e-310), "i": (-1, 10**6, 2**31 - 1, -(2**31))}
    for number in numbers.get(values.dtype.kind, ()):
        wrong[f"{number}"] = np.full(values.shape, number).astype(values.dtype)
    if values.dtype.kind == "f":
        wrong["tiny"] = (values * 1e-150).astype(values.dtype)
    return wrong


def spoiled(record, prefix=""):
    """Copies of a dataclass of arrays with one wrong array or part, by name."""
    for entry in fields(record):
        value, name = getattr(record, entry.name), prefix + entry.name
        if isinstance(value, np.ndarray):
            for kind, wrong in spoiled_arrays(value).items():
                yield f"{name} {kind}", replace(record, **{entry.name: wrong})
        elif is_dataclass(value):
            yield f"{name} none", replace(record, **{entry.name: None})
            for kind, wrong in spoiled(value, f"{name}."):
                yield kind, replace(record, **{entry.name: wrong})


@pytest.fixture(scope="module")
def edges(scene_edges):
    """The first edges of the scene."""
    offsets = scene_edges.edge_offsets[:5]
    given = (scene_edges.closed[:4], scene_edges.end_nodes[:4])
    return scene_edges.reordered(np.arange(offsets[-1]), offsets, *given)


@pytest.fixture(scope="module")
def curves(edges):
    return fit_curves(edges)


@pytest.fixture(scope="module")
def sphere():
    random = np.random.default_rng(0)
    return Mesh(
        vertices=random.normal(size=(9, 3)),
        faces=np.array([(0, 1, 2), (3, 4, 8)], np.int32),
        point3D_ids=np.full(9, -1),
        colors=np.zeros((9, 3), np.uint8),
    )


@pytest.fixture(scope="module")
def calls(scene_model, edges, curves, sphere, tmp_path_factory):
    """Every public function, as functions of one argument, with what is wrong for it."""
    folder = tmp_path_factory.mktemp("written")
    model, view = scene_model, scene_model.views[0]
    seen = len(edges.observations.views)
    ids, residuals = np.arange(edges.num_points), np.zeros(seen)
    reconstruct = partial(colmap_edges.reconstruct, model)
    shape = (edges.edge_offsets, edges.closed, edges.end_nodes)
    return [
        (colmap_edges.reconstruct, NOT_PATHS + NOT_DATA, "no images here"),
        (reconstruct, NOT_PATHS),
        (mesh, NOT_DATA + NOT_PATHS),
        (lambda v: mesh(model, v), NOT_DATA[1:]),
        (lambda v: mesh(model, method=v), NOT_DATA[1:]),
        (lambda v: mesh(model, options=v), NOT_DATA[1:]),
        (lambda v: mesh(model, num_threads=v), NOT_NUMBERS),
        *((lambda v, k=k: mesh(model, **{k: v}), NOT_DATA[1:]) for k in PARTS),
        (fit_curves, NOT_DATA),
        (lambda v: fit_curves(edges, regularize=v), (None, 5, "x", [])),
        (lambda v: fit_curves(edges, num_threads=v), NOT_NUMBERS),
        (colmap_edges.preset, NOT_DATA),
        (read_edges, NOT_DATA + NOT_PATHS),
        (lambda v: read_edges(folder, v), NOT_PATHS[1:]),
        (colmap_edges.to_networkx, NOT_DATA),
        (colmap_edges.to_pandas, NOT_DATA),
        (lambda v: colmap_edges.write_mesh(v, folder / "m.ply"), NOT_DATA),
        (lambda v: colmap_edges.write_mesh(sphere, v), NOT_PATHS),
        (colmap_edges.read_mesh, NOT_PATHS),
        (
            lambda v: colmap_edges.write_mesh(sphere, folder / "m.obj", up=v),
            (None, 5, "w", [], {}, True),
        ),
        (lambda v: write_glb(edges, folder / "e.glb", unit=v), NOT_DATA),
        (lambda v: colmap_edges.write_dxf_polylines(v, folder / "e.dxf"), NOT_DATA),
        (edges.observations_of, (*NOT_NUMBERS, 10**6)),
        *((lambda v, w=w: w(v, folder / "e"), NOT_DATA) for w in (write_ply, write_obj, write_glb)),
        *((partial(w, edges), NOT_PATHS) for w in (write_ply, write_obj, write_glb)),
        (partial(write_dxf, curves), NOT_PATHS),
        (lambda v: write_dxf(v, folder / "c.dxf"), NOT_DATA),
        (lambda v: write_svg(edges, v, view, 0, folder / "a.svg"), NOT_DATA),
        (lambda v: write_svg(edges, curves, v, 0, folder / "a.svg"), NOT_DATA),
        (lambda v: write_svg(edges, curves, view, v, folder / "a.svg"), NOT_NUMBERS),
        (partial(write_structures, edges, curves, model), NOT_PATHS),
        (lambda v: write_structures(edges, curves, v, folder / "structures"), NOT_DATA),
        (lambda v: write_json(edges, curves, model, v, residuals, folder / "e"), NOT_DATA),
        (lambda v: write_json(edges, curves, model, ids, v, folder / "e"), NOT_DATA),
        (lambda v: Edges3D.of_polylines(v, np.array([4])), NOT_DATA),
        (lambda v: Edges3D.of_polylines(np.zeros((3, 3)), v), (*NOT_DATA, np.array([-1, 4]))),
        (lambda v: edges.reordered(v, *shape), (*NOT_DATA, np.array([10**9]))),
        (Curves3D.concatenated, (None, 5, [1], [None], [edges])),
        (curves.spline, (*NOT_NUMBERS, 10**6)),
        (curves.control_rows, (*NOT_NUMBERS, 10**6)),
        (curves.sampled, (None, -1, 0, 1e-300, "2", True, np.nan, [])),
        (lambda v: curves.at(v, np.zeros(3)), (*NOT_DATA, np.full(3, 10**6), np.zeros(2, int))),
        (lambda v: curves.at(np.zeros(3, int), v), NOT_DATA),
    ]


PARTS = ("background", "contours", "faces")


def test_wrong_arguments_are_refused(calls):
    for call, *wrong in calls:
        for value in wrong[0]:
            arguments = (value, *wrong[1:])
            assert not accepted(call, *arguments), (inspect.getsource(call), value)


@pytest.mark.parametrize("name", ["image_path", "cache_path", "mask_path", "edge_path"])
def test_errors_of_paths_name_the_argument(scene_model, name):
    for path in NOT_PATHS[1:]:
        with pytest.raises(ColmapEdgesError, match=f"^{name} is "):
            colmap_edges.reconstruct(scene_model, **{"image_path": "nowhere", name: path})


def test_all_public_functions_check_their_arguments():
    public = (getattr(colmap_edges, name) for name in colmap_edges.__all__)
    functions = {of.__name__: of for of in public if inspect.isfunction(of)}
    writers = (write_ply, write_obj, write_json, write_glb, write_dxf, write_svg, write_structures)
    functions |= {of.__name__: of for of in writers}
    assert [name for name, of in functions.items() if not hasattr(of, "__wrapped__")] == ["preset"]


def test_wrong_arrays_are_refused_or_make_no_difference(
    scene_model, edges, curves, sphere, tmp_path
):
    ids = np.arange(edges.num_points)
    residuals, view = np.zeros(len(edges.observations.views)), scene_model.views[0]
    uses = {
        "edges": [
            fit_curves,
            colmap_edges.to_networkx,
            colmap_edges.to_pandas,
            lambda v: write_ply(v, tmp_path / "e.ply"),
            lambda v: write_glb(v, tmp_path / "e.glb"),
            lambda v: write_json(v, curves, scene_model, ids, residuals, tmp_path / "e.json"),
        ],
        "curves": [
            lambda v: write_dxf(v, tmp_path / "c.dxf"),
            lambda v: write_svg(edges, v, view, 0, tmp_path / "c.svg"),
        ],
        "mesh": [lambda v: colmap_edges.write_mesh(v, tmp_path / "m.ply")],
    }
    for name, record in (("edges", edges), ("curves", curves), ("mesh", sphere)):
        for _, wrong in spoiled(record):
            for use in uses[name]:
                accepted(use, wrong)


def test_errors_name_the_array_and_its_fault(scene_edges):
    num_offsets = len(scene_edges.edge_offsets)
    cases = {
        "edges.points has the shape": replace(scene_edges, points=scene_edges.points[:, :2]),
        "edges.points has the dtype float32": replace(
            scene_edges, points=scene_edges.points.astype(np.float32)
        ),
        r"edges.points\[0, 0\] is nan": replace(scene_edges, points=scene_edges.points * np.nan),
        "edges.sigmas has the shape": replace(scene_edges, sigmas=scene_edges.sigmas[1:]),
        "edges.edge_offsets must rise": replace(
            scene_edges, edge_offsets=scene_edges.edge_offsets[::-1]
        ),
        "edges.edge_offsets gives 0 entries to row 1": replace(
            scene_edges, edge_offsets=scene_edges.edge_offsets[[0, 1, 1, *range(3, num_offsets)]]
        ),
        "edges.observations is of type NoneType": replace(scene_edges, observations=None),
        "too small; scale the model up": replace(scene_edges, points=scene_edges.points * 1e-60),
    }
    for message, wrong in cases.items():
        with pytest.raises(ColmapEdgesError, match=message):
            wrong.check()
    scene_edges.check()


def test_edges_of_another_model_are_refused(scene, scene_model, scene_edges):
    fewer = pycolmap.Reconstruction(scene.reconstruction)
    fewer.deregister_frame(next(iter(fewer.frames)))
    with pytest.raises(ColmapEdgesError, match="view"):
        mesh(fewer, scene_edges)
    moved = replace(scene_edges, points=scene_edges.points + 0.5)
    for name in ("edges", "contours"):
        with pytest.raises(ColmapEdgesError, match=f"{name} are not of this model: most points"):
            mesh(scene_model, **{name: moved})
    with pytest.raises(ColmapEdgesError, match="but the model has 0 images"):
        mesh(pycolmap.Reconstruction(), scene_edges)


def test_background_and_faces_of_another_model_are_refused(scene_model):
    one = np.zeros(1, np.int32)
    for rays, message in (
        (BackgroundRays(one + 99, np.ones((1, 3))), "background.cameras holds view 99"),
        (BackgroundRays(one, np.zeros((1, 3))), "a direction of length 0"),
        (BackgroundRays(one, np.full((1, 3), np.nan)), "background.directions"),
        (BackgroundRays(one, None), "background.directions"),
    ):
        with pytest.raises(ColmapEdgesError, match=message):
            mesh(scene_model, background=rays)
    corners, views = np.eye(3), np.zeros(1, np.int64)
    face = Face(
        normal=corners[2], offset=0.0, area=1.0, outline=corners, holes=(), views=views, plane=0
    )
    seen = SeenPoints(np.zeros((1, 3)), np.array([0, 1]), one + 99)
    faces = replace(NO_FACES, faces=[face], points=seen, face_ids=views)
    with pytest.raises(ColmapEdgesError, match=r"faces\.points\.track_views holds view 99"):
        mesh(scene_model, faces=faces)
    with pytest.raises(
        ColmapEdgesError, match=r"faces\.face_ids\[0\] is 1; it must be from 0 to 0"
    ):
        mesh(scene_model, faces=replace(faces, face_ids=views + 1))


def test_files_that_cannot_be_written_are_errors(scene_edges, sphere, tmp_path):
    assert not accepted(write_ply, scene_edges, tmp_path / "missing" / "e.ply")
    assert not accepted(colmap_edges.write_mesh, sphere, tmp_path / "missing" / "m.ply")
    assert accepted(write_ply, scene_edges, str(tmp_path / "e.ply"))


def test_edges_of_an_empty_model_are_of_another(edges):
    with pytest.raises(ColmapEdgesError):
        mesh(pycolmap.Reconstruction(), edges)
