"""Shared fixtures: a synthetic scene on disk, made once a session."""

import hashlib
import os
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

# As the command sets it, and before numpy is loaded: threads that wait for each other burn time.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import scenes

from colmap_edges.colmap.model import load_model

# Files that take longest; they start first, so that at the end no process waits for one of them.
LONGEST = (
    *("cli/test_option_extremes.py", "project/test_docs.py", "scripts/test_reproduce_results.py"),
    *("cli/test_terminal.py", "report/test_report.py", "evaluation/test_scripts.py"),
    *("pipeline/test_interruption.py", "runtime/test_cluster.py", "cli/test_cli.py"),
    *("colmap/test_camera_models.py", "pipeline/test_pipeline.py", "pipeline/test_determinism.py"),
    *(
        "pipeline/test_dark_corners.py",
        "scripts/test_benchmark_scripts.py",
        "scripts/test_make_scene.py",
    ),
    *("fuzzing/test_fuzzing.py", "pipeline/test_edge_path.py", "runtime/test_cache.py"),
    *("surfaces/test_mesher.py", "surfaces/test_bodies.py", "colmap/test_plausibility.py"),
    *("evaluation/test_benchmark.py", "core/test_distortion.py", "images/test_background.py"),
    *("poses/test_refine_poses.py", "scripts/test_try_scenes.py", "project/test_examples.py"),
    *(
        "scripts/test_making_the_demo_scene.py",
        "scripts/test_fixed_scenes.py",
        "cli/test_environment.py",
    ),
    *("edges2d/test_working_scale.py", "pipeline/test_nothing_lost.py", "colmap/test_model.py"),
    *("pipeline/test_neighbours.py", "pipeline/test_panoramas.py", "project/test_site.py"),
)
RANKS = {name: rank for rank, name in enumerate(LONGEST)}


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: RANKS.get("/".join(item.path.parts[-2:]), len(RANKS)))


def pytest_addoption(parser):
    parser.addoption("--soak", action="store_true", help="run the long versions of tests")


@pytest.fixture(scope="session")
def soak(request):
    """Whether the long version of a test is asked for."""
    return request.config.getoption("--soak")


@pytest.fixture
def show(soak, capsys):
    """A function that prints a line of the long versions' counts."""

    def write(line: str) -> None:
        if soak:
            with capsys.disabled():
                print(line, flush=True)  # noqa: T201

    return write


@pytest.fixture(scope="session")
def scene():
    return scenes.make_scene()


@pytest.fixture(scope="session")
def scene_paths(scene, tmp_path_factory):
    """(image_path, input_path) of the scene; read-only by agreement."""
    return scene.write(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """(image_path, input_path) of a scene that is meshed in half a second; read-only, too."""
    scene = scenes.make_scene(num_views=6, width=240, height=180)
    return scene.write(tmp_path_factory.mktemp("small"))


@pytest.fixture(scope="session")
def scene_model(scene_paths):
    return load_model(scene_paths[1])


@pytest.fixture(scope="session")
def scene_edges(scene, scene_model):
    """The true edges with noisy observations."""
    return scenes.true_edges(scene_model, scene, noise_px=0.3)


@pytest.fixture(scope="session")
def hash_folder():
    """A function that gives the digest of every file below a folder."""

    def digest(folder: Path) -> dict[str, str]:
        return {
            str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
            for path in sorted(folder.rglob("*"))
            if path.is_file()
        }

    return digest


@pytest.fixture(scope="session")
def hash_output(hash_folder):
    """A function that gives the digests of an output but its reports, which hold times."""

    def digest(folder: Path) -> dict[str, str]:
        digests = hash_folder(folder)
        assert digests.pop("report.json")
        digests.pop("report.html", None)
        return digests

    return digest


@pytest.fixture
def public():
    """A folder that every user may enter; those of pytest are the user's own."""
    folder = Path(tempfile.mkdtemp(prefix="colmap-edges-test-"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture
def other_user():
    """A context in which files are opened as a user without rights; needs root."""
    if os.geteuid() != 0:
        pytest.skip("only root can act as another user")

    @contextmanager
    def acting():
        os.seteuid(65534)
        try:
            yield
        finally:
            os.seteuid(0)

    return acting
