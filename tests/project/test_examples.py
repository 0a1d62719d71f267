"""The notebooks of docs/examples run from first cell to last, on a small scene."""

import json
import os
from pathlib import Path

import pytest
from project import ROOT

import colmap_edges

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

NOTEBOOKS = sorted((ROOT / "docs" / "examples").glob("*.ipynb"))
MAX_BYTES = 20_000


@pytest.fixture(scope="module")
def folder(small, tmp_path_factory):
    """Where notebooks run: with a small scene where the repository has the demo scene."""
    root = tmp_path_factory.mktemp("tree")
    demo = root / "tests" / "data" / "demo"
    demo.mkdir(parents=True)
    (demo / "images").symlink_to(small[0])
    (demo / "sparse").symlink_to(small[1])
    place = root / "docs" / "examples"
    place.mkdir(parents=True)
    return place


def test_notebooks_are_committed_without_outputs():
    assert len(NOTEBOOKS) >= 3
    for path in NOTEBOOKS:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        assert path.stat().st_size < MAX_BYTES, path.name
        assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells)
        assert cells[0]["cell_type"] == "markdown"


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the kernel's own packages
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_runs(path, folder, monkeypatch):
    nbclient = pytest.importorskip("nbclient", reason="notebooks are run by nbclient")
    pytest.importorskip("ipykernel", reason="notebooks are run by ipykernel")
    pytest.importorskip("pandas", reason="a notebook makes tables (extra pandas)")
    import nbformat

    package = str(Path(colmap_edges.__file__).parents[1])
    paths = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
    monkeypatch.setenv("PYTHONPATH", paths)
    monkeypatch.setenv("IPYTHONDIR", str(folder / "ipython"))
    notebook = nbformat.read(path, as_version=4)
    resources = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(notebook, timeout=300, resources=resources).execute()
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in cells)
    said = "".join(output.get("text", "") for cell in cells for output in cell.outputs)
    wanted = {
        "first_steps": "triangles with",
        "edges_as_data": "connected parts",
        "own_plot": "",
    }
    assert wanted[path.stem] in said
    if path.stem == "own_plot":
        assert (folder / "edges.html").stat().st_size > 1e6
