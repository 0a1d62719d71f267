import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_path():
    """Folder of the real scenes; tests that need it are skipped without it."""
    default = Path(__file__).resolve().parents[2].parent / "shared" / "data"
    path = Path(os.environ.get("COLMAP_EDGES_DATA", default))
    if not path.is_dir():
        pytest.skip(f"the real scenes are not in {path} (set COLMAP_EDGES_DATA)")
    return path
