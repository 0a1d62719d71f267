"""Pictures for the gallery, drawn of a small run."""

import cv2
import numpy as np
import pytest
from project import run_script

from colmap_edges import Face, Mesh, write_mesh
from colmap_edges.colmap.model import observation_residuals
from colmap_edges.colmap.writing import write_model
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.export.edges_json import write_json
from colmap_edges.export.faces import write_faces

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline


@pytest.fixture
def run_path(scene_model, scene_edges, tmp_path):
    """What a run leaves, its mesh and its face being one square in gray and in a colour."""
    residuals = observation_residuals(scene_model, scene_edges)
    ids = write_model(scene_model, scene_edges, tmp_path / "sparse", "BIN", residuals)
    curves = fit_curves(scene_edges)
    write_json(scene_edges, curves, scene_model, ids, residuals, tmp_path / "edges.json")
    low, high = scene_edges.points.min(axis=0), scene_edges.points.max(axis=0)
    square = np.array([low, [high[0], *low[1:]], [*high[:2], low[2]], [low[0], high[1], low[2]]])
    mesh = Mesh(
        vertices=square,
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        point3D_ids=np.full(4, -1),
        colors=np.full((4, 3), 99, np.uint8),
    )
    write_mesh(mesh, tmp_path / "mesh.ply")
    face = Face(
        normal=np.array([0.0, 0, 1]),
        offset=float(low[2]),
        area=1.0,
        outline=square,
        holes=(),
        views=np.arange(3),
        plane=4,
    )
    write_faces([face], scene_model, tmp_path / "faces.json")
    return tmp_path


def test_mesh_edges_and_faces_are_drawn(run_path, tmp_path):
    command = ("--run_path", run_path, "--name", "square", "--output_path", tmp_path / "out")
    run_script("make_gallery.py", *command)
    pictures = {path.stem: cv2.imread(str(path)) for path in (tmp_path / "out").iterdir()}
    assert set(pictures) == {"square_mesh", "square_edges", "square_faces"}
    assert {picture.shape for picture in pictures.values()} == {(500, 800, 3)}
    colorful = {name: (np.ptp(p.astype(int), axis=2) > 60).mean() for name, p in pictures.items()}
    assert colorful["square_mesh"] < 0.002 < colorful["square_edges"]
    assert colorful["square_faces"] > 2 * colorful["square_edges"]
