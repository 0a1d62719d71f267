"""The same input gives the same bytes for any threads, locale, file order and image order."""

import os
import shutil
import subprocess
import sys

import numpy as np
import pycolmap
import pytest
from forked import call_forked
from project import DEMO

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

LOCALES = ["C", "POSIX", "C.UTF-8", "de_DE.UTF-8", "tr_TR.UTF-8", "fr_FR.ISO-8859-1"]


def mesh(folder, output, *flags, **environment):
    """Mesh the scene below `folder`, in an environment of its own in a process of its own."""
    words = ["mesh", "--report", "0", "--output_path", output, "--image_path", folder / "images"]
    words = [str(word) for word in (*words, "--input_path", folder / "sparse", *flags)]
    if environment:  # which Python reads when it starts
        command = [sys.executable, "-m", "colmap_edges", *words]
        variables = os.environ | environment
        subprocess.run(command, check=True, capture_output=True, env=variables, timeout=600)
    else:
        assert call_forked(words, 600).returncode == 0
    return output


def contents(output, hash_output):
    digests = hash_output(output)
    assert {"mesh.ply", "edges.ply", "edges.json", "sparse/points3D.bin"} <= set(digests)
    return digests


@pytest.fixture(scope="module")
def small_scene(tmp_path_factory):
    """A folder with images/ and sparse/ of every fourth view of the demo."""
    folder = tmp_path_factory.mktemp("small")
    reconstruction = pycolmap.Reconstruction(DEMO / "sparse")
    names = sorted(image.name for image in reconstruction.images.values())
    kept = set(names[::4])
    for frame_id, frame in list(reconstruction.frames.items()):
        images = [reconstruction.images[data.id].name for data in frame.image_ids]
        if not kept & set(images):
            reconstruction.deregister_frame(frame_id)
    (folder / "sparse").mkdir()
    (folder / "images").mkdir()
    reconstruction.write(folder / "sparse")
    for name in kept:
        shutil.copy(DEMO / "images" / name, folder / "images")
    return folder


@pytest.fixture(scope="module")
def reference(small_scene, tmp_path_factory):
    """The output on one thread."""
    return mesh(small_scene, tmp_path_factory.mktemp("reference") / "out", "--num_threads", 1)


@pytest.mark.parametrize("threads", [1, 2, 7])
def test_threads_and_repeated_runs(small_scene, reference, tmp_path, hash_output, soak, threads):
    if not soak:
        pytest.skip("in the long version")
    mesh(small_scene, tmp_path / "out", "--num_threads", threads, PYTHONHASHSEED=str(threads))
    assert contents(tmp_path / "out", hash_output) == contents(reference, hash_output)


def test_threads_locale_and_orders_of_files_and_images(
    small_scene, reference, tmp_path, hash_output
):
    """All at once: files made in another order, with other times, in folders of other names."""
    folder = tmp_path / "scène 2"
    (folder / "images").mkdir(parents=True)
    for path in sorted((small_scene / "images").iterdir(), reverse=True):
        shutil.copyfile(path, folder / "images" / path.name)
    shutil.copytree(small_scene / "sparse", folder / "sparse")
    reverse_images(folder / "sparse" / "images.bin")
    environment = locale_of("de_DE.UTF-8", tmp_path) or {}
    mesh(folder, tmp_path / "out", "--num_threads", 2, PYTHONHASHSEED="2", **environment)
    assert contents(tmp_path / "out", hash_output) == contents(reference, hash_output)


def reverse_images(path):
    """Write the records of an images.bin in the other order: the same images by their ids."""
    from colmap_edges.colmap.binary_files import COUNT, image_records

    data = path.read_bytes()
    records = image_records(data, path)[::-1]
    assert len(records) > 5
    path.write_bytes(data[: COUNT.size] + b"".join(data[r.start : r.end] for r in records))


def test_order_of_images_in_the_model(small_scene, reference, tmp_path, hash_output, soak):
    """Ids decide, not places in the file."""
    if not soak:
        pytest.skip("in the long version")
    shutil.copytree(small_scene, tmp_path / "scene")
    reverse_images(tmp_path / "scene" / "sparse" / "images.bin")
    mesh(tmp_path / "scene", tmp_path / "out")
    assert contents(tmp_path / "out", hash_output) == contents(reference, hash_output)


def locale_of(name, folder):
    """Variables of a locale, made in `folder` unless installed; nothing where that fails."""
    available = subprocess.run(["locale", "-a"], capture_output=True, text=True).stdout
    made = name.lower().replace("-", "") in available.lower().replace("-", "")
    environment = {"LC_ALL": name, "LANG": name, "LANGUAGE": name[:2]}
    if not made:  # without the locale, programs fall back to C; make it where that is possible
        charset = name.partition(".")[2]
        command = ["localedef", "-i", name.partition(".")[0], "-f", charset, folder / name]
        if not shutil.which("localedef") or subprocess.run(command, capture_output=True).returncode:
            return None
        environment["LOCPATH"] = str(folder)
    return environment


@pytest.mark.parametrize("name", LOCALES)
def test_locale(small_scene, reference, tmp_path, hash_output, soak, name):
    if not soak:
        pytest.skip("in the long version")
    environment = locale_of(name, tmp_path)
    if environment is None:
        pytest.skip(f"the locale {name} is not installed and cannot be made")
    mesh(small_scene, tmp_path / "out", **environment)
    assert contents(tmp_path / "out", hash_output) == contents(reference, hash_output)


def test_the_reference_has_edges_and_a_mesh(reference):
    """Nothing would be easier to repeat than nothing."""
    from colmap_edges.evaluation.metrics.raycasting import load_mesh
    from colmap_edges.evaluation.readers.curves import load_curves

    assert len(load_curves(reference / "edges.ply").segments) > 100
    mesh_found = load_mesh(reference / "mesh.ply")
    assert len(mesh_found.faces) > 1000
    assert np.isfinite(mesh_found.vertices).all()
