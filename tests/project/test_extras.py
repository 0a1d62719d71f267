"""What is missing of the extras is named in one line, before a run where one needs it."""

import re
import sys

import numpy as np
import pytest
from project import ROOT

import colmap_edges
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics.clouds import cloud_to_mesh
from colmap_edges.export.ply import read_ply

PROJECT = (ROOT / "pyproject.toml").read_text()
EDGES = Edges3D.of_polylines(np.zeros((2, 3)), np.array([2]))
USES = {
    ("networkx", "graph"): lambda path: colmap_edges.to_networkx(EDGES),
    ("pandas", "pandas"): lambda path: colmap_edges.to_pandas(EDGES),
    ("OCP", "step"): lambda path: colmap_edges.write_step(colmap_edges.Curves3D.none(), path),
    ("plyfile", "evaluation"): read_ply,
    ("pymeshlab", "evaluation"): lambda path: cloud_to_mesh(np.zeros((1, 3)), path, path),
}


@pytest.mark.parametrize(("library", "extra"), USES)
def test_a_missing_library_is_named_with_its_extra(library, extra, monkeypatch, tmp_path):
    (tmp_path / "file").touch()
    monkeypatch.setitem(sys.modules, library, None)
    told = rf"needs {library}, which is not installed; run: pip install 'colmap-edges\[{extra}\]'"
    with pytest.raises(ColmapEdgesError, match=told):
        USES[library, extra](tmp_path / "file")
    wanted = {"OCP": "cadquery-ocp-novtk"}.get(library, library)
    line = re.search(rf"^{extra} = .*$", PROJECT, re.MULTILINE)[0]
    assert f'"{wanted}>=' in line


def test_all_holds_every_extra_of_users():
    extras = dict(re.findall(r"^(\w+) = (\[.*\])$", PROJECT, re.MULTILINE))
    users = set(re.findall(r"[a-z]+", re.search(r"colmap-edges\[(.*?)\]", extras["all"])[1]))
    own = {"cluster", "evaluation", "graph", "pandas", "step"}
    assert users == own and own <= set(extras)
    assert "rerun-sdk" in extras["all"]  # which has no wheels for Python 3.10
