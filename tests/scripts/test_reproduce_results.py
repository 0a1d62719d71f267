"""All tables of the results, made of a miniature instead of the benchmarks' scenes."""

import json
import shutil
import sys
from pathlib import Path

import miniature
import numpy as np
import pytest
import trimesh
from project import ROOT, run_script

from colmap_edges.colmap.model import load_model
from colmap_edges.evaluation.layouts import dtu
from colmap_edges.evaluation.metrics import depth
from colmap_edges.evaluation.metrics.raycasting import RayCaster
from colmap_edges.evaluation.triangulation import triangulate

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder of scenes: the fountain and the demo are both the miniature."""
    folder = tmp_path_factory.mktemp("data")
    posed = dtu.posed_images(miniature.write(folder / "dtu", cameras=4), 6)
    for name in ("fountain-P11", "demo"):
        shutil.copytree(posed[0], folder / name / "images")
    sparse = folder / "fountain-P11" / "sparse"
    sparse.mkdir()
    triangulate(posed[1], posed[0], sparse)
    shutil.copytree(sparse, folder / "fountain-P11" / "sparse_thin")
    shutil.copytree(sparse, folder / "demo" / "sparse")
    write_truth(folder, load_model(sparse).views[::2])
    return folder


def write_truth(folder, views):
    """The planes of the miniature as a mesh, as depth maps, and the square's border as curves."""
    corners = np.array([(x * h, y * h, z) for h, z in ((60, 0.0), (12, miniature.HEIGHT))
               for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))])  # fmt: skip
    surface = trimesh.Trimesh(corners, [(0, 1, 2), (0, 2, 3), (4, 5, 6), (4, 6, 7)], process=False)
    surface.export(folder / "demo" / "surface.ply")
    border = np.array([(0, 1), (1, 2), (2, 3), (3, 0)])
    np.savez(folder / "demo" / "curves.npz", points=corners[4:], edges=border)
    depths = folder / "fountain-P11" / "reference_depth"
    depths.mkdir()
    caster = RayCaster(surface.vertices, surface.faces)
    for view in views:
        truth = depth.render_reference(caster, view).depth
        path = depths / f"{Path(view.name).stem}.npz"
        np.savez(path, depth=truth, scale=1.0, image_name=view.name)


def test_tables_of_the_scenes_that_are_there(data, tmp_path):
    pytest.importorskip("colmap_edges._mesher", reason="the CGAL mesher is not built")
    results = ROOT / "docs" / "results.md"
    before = results.read_bytes()
    # As the script's header allows; tests/evaluation/test_scripts.py has it triangulated.
    triangulated = tmp_path / "from_images" / "strecha" / "fountain-P11" / "sparse"
    shutil.copytree(data / "fountain-P11" / "sparse", triangulated)
    arguments = (data, tmp_path, sys.executable)
    done = run_script("reproduce_results", *arguments, PYTHONSAFEPATH="1", LIMAP_PYTHON="")
    assert "there is no dtu-scan24 corridor abc-00000006 pavilion-chair" in done.stderr
    assert results.read_bytes() == before  # for scenes are missing
    text = (tmp_path / "results.md").read_text()
    kept = [line for line in text.splitlines() if line.startswith("##")]
    for head in ("### fountain-P11", "### The demo scene", "### fountain, against reference depth"):
        assert head in kept
    assert not any("scan24" in head or "chair" in head for head in kept)
    for command in ("scenes --unit", "scenes --strecha", "edges --edges_path"):
        assert f"scripts/evaluate.py {command} " in text
    # Commands are as a reader would type them.
    assert "    scripts/evaluate.py edges --edges_path $OUT/demo/demo/edges/edges.ply" in text
    assert str(data) not in text and str(tmp_path) not in text
    for table, scenes_in_it in (("m", ["fountain", "fountain-thin"]), ("demo", ["demo"])):
        record = json.loads((tmp_path / table / "evaluation.json").read_text())
        assert list(record) == scenes_in_it
        for entry in record.values():
            rows = ["SfM", "COLMAP-like", "SfM-paper", "paper", "edges"]
            assert list(entry["methods"]) == rows
            assert all(method["mesh"]["median"] < 0.2 for method in entry["methods"].values())
    edges = json.loads((tmp_path / "edges" / "demo.json").read_text())
    assert edges["curves"]["scores"][1]["recall"] > 0.2
    assert "left-out points" in text
