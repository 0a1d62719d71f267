import os
from pathlib import Path

import pytest
from project import ROOT

from colmap_edges.evaluation.layouts import dtu
from colmap_edges.evaluation.triangulation import triangulate


@pytest.fixture(scope="session")
def data_path():
    """Folder of the real scenes; tests that need it are skipped without it."""
    default = ROOT.parent / "shared" / "data"
    path = Path(os.environ.get("COLMAP_EDGES_DATA", default))
    if not path.is_dir():
        pytest.skip(f"the real scenes are not in {path} (set COLMAP_EDGES_DATA)")
    return path


@pytest.fixture(scope="session")
def mesher():
    """Tests that mesh are skipped where the CGAL mesher is not built."""
    try:
        from colmap_edges import _mesher  # noqa: F401
    except ImportError:
        pytest.skip("the CGAL mesher is not built")


@pytest.fixture(scope="module")
def sparse(root, tmp_path_factory):
    """The sparse model of the miniature in the module's folder `root`."""
    folder, images = dtu.posed_images(root, 6)
    path = tmp_path_factory.mktemp("sparse")
    triangulate(images, folder, path)
    return path
