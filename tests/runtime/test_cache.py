"""The cache returns what was saved, and only while its inputs are unchanged."""

import json
import os
import shutil
import time
from functools import partial

import cv2
import numpy as np
import pycolmap
import pytest
from forked import COMMAND, Forked, call_forked

from colmap_edges.core.arrays import flattened, unflattened
from colmap_edges.core.edges3d import Edges3D, TracedEdges
from colmap_edges.errors import ColmapEdgesError, OptionError
from colmap_edges.evaluation.metrics.poses import with_pose_noise
from colmap_edges.options import DetectionOptions, MeshingOptions, PipelineOptions, TracingOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run
from colmap_edges.runtime import cache as cache_module
from colmap_edges.runtime.cache import Cache, key_of, packed, seal, unpacked

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

ARRAYS = {"a": np.arange(6.0).reshape(2, 3), "b": np.zeros(0, bool), "c": np.array("text")}


@pytest.fixture(scope="module")
def reference(small, tmp_path_factory):
    """An output made without a cache."""
    return trace(small, tmp_path_factory.mktemp("reference") / "out")[0]


# Without what is not in the cache, and what is in it with the edges; it takes most of the time.
PLAIN = {"use_faces": False, "use_patches": False, "refine_poses": False}


def trace(scene, output, cache=None, command="reconstruct", **options):
    """Output folder and, by stage, the counts of a run."""
    paths = Paths(image_path=scene[0], input_path=scene[1], output_path=output, cache_path=cache)
    options = PipelineOptions(num_threads=2, report=False, **PLAIN | options)
    report = run(command, paths, options, overwrite=True)
    return output, {stage["name"]: stage["counts"] for stage in report["stages"]}


@pytest.fixture
def filled(filled_once, tmp_path):
    """A cache with all entries of the small scene, which may be changed."""
    return shutil.copytree(filled_once, tmp_path / "cache")


@pytest.fixture(scope="module")
def filled_once(small, tmp_path_factory):
    folder = tmp_path_factory.mktemp("filled")
    trace(small, folder / "out", folder / "cache")
    return folder / "cache"


def reused(counts):
    """Images and edges that were found in the cache."""
    return counts["detect"]["images_reused"], counts["trace"]["edges_reused"]


def test_entries_come_back_as_they_were(tmp_path):
    cache = Cache(tmp_path / "new" / "cache")
    assert cache.load("kind", "key", dict) is None
    assert cache.save("kind", "key", ARRAYS)
    found = cache.load("kind", "key", dict)
    assert list(found) == list(ARRAYS)
    for name, array in ARRAYS.items():
        np.testing.assert_array_equal(found[name], array)
        assert found[name].dtype == array.dtype
    assert cache.load("kind", "other", dict) is None
    assert not any(cache.unfinished.iterdir())


def test_damaged_entries_are_not_found(tmp_path, caplog):
    cache, rng = Cache(tmp_path), np.random.default_rng(0)
    cache.save("kind", "key", ARRAYS)
    path = cache.path("kind", "key")
    whole = path.read_bytes()
    damaged = [whole[:n] for n in (0, 5, 32, len(whole) // 2, len(whole) - 1)]
    for at in rng.integers(0, len(whole), 200):
        flipped = bytearray(whole)
        flipped[at] ^= 1 << rng.integers(8)
        damaged.append(bytes(flipped))
    for data in damaged:
        path.write_bytes(data)
        assert cache.load("kind", "key", dict) is None
    assert len(caplog.records) == len(damaged)
    assert "is damaged; it is made again" in caplog.text
    # An entry under another's name is none, however whole.
    path.write_bytes(whole)
    cache.path("kind", "kez").parent.mkdir(exist_ok=True)
    shutil.copy(path, cache.path("kind", "kez"))
    assert cache.load("kind", "kez", dict) is None
    assert cache.load("kind", "key", dict) is not None


HEADS = {
    **{"objects": b'[["a", "|O", [2]]]', "too few bytes": b'[["a", "<f8", [9]]]'},
    **{"no type": b'[["a", "(9,)f4,(", [1]]]', "no JSON": b"[[", "no list": b"3"},
    "nested too deeply": b"[" * 200_000,
}


@pytest.mark.parametrize("head", HEADS.values(), ids=HEADS)
def test_entries_of_other_content_are_not_found(tmp_path, head):
    """Sealed, but of objects, of too few bytes, or with another head."""
    data = len(head).to_bytes(8, "little") + bytes(8) + head.ljust(32) + bytes(range(16))
    cache = Cache(tmp_path / "cache")
    path = cache.path("kind", "key")
    path.parent.mkdir(parents=True)
    for content in (data, data[:3]):
        path.write_bytes(seal("kind", "key", content) + content)
        assert cache.load("kind", "key", dict) is None


def test_keys_differ_for_different_parts(monkeypatch):
    parts = [
        (),
        (b"ab", b"c"),
        (b"a", b"bc"),
        ("ab", "c"),
        (np.zeros(4),),
        (np.zeros((2, 2)),),
        (np.zeros(8, np.float32),),
        (DetectionOptions(),),
        (DetectionOptions(min_chain_points=13),),
    ]
    keys = [key_of(*part) for part in parts]
    assert len(set(keys)) == len(keys)
    assert key_of(*parts[1]) == keys[1]
    monkeypatch.setattr(cache_module, "code_version", lambda: "other")
    assert key_of(*parts[1]) not in keys


def test_only_forgotten_files_are_removed(tmp_path):
    unfinished = Cache(tmp_path).unfinished
    old, new, others = unfinished / ("0" * 32), unfinished / ("1" * 32), unfinished / "draft.txt"
    for path in (old, new, others):
        path.write_bytes(b"half")
    for path in (old, others):
        os.utime(path, (time.time() - 2 * cache_module.FORGOTTEN_S,) * 2)
    Cache(tmp_path)
    assert sorted(unfinished.iterdir()) == [new, others]


def test_folder_that_cannot_be_made(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ColmapEdgesError, match="cannot use cache"):
        Cache(tmp_path / "file" / "cache")


def test_a_cache_of_another_user_is_read(public, other_user, caplog):
    """Entries that may be read but not touched are found; those that may not be read are not."""
    cache = Cache(public / "cache")
    for key in ("open", "closed"):
        assert cache.save("kind", key, ARRAYS)
    for path in [cache.folder, *cache.folder.rglob("*")]:
        path.chmod(0o755 if path.is_dir() else 0o644)
    cache.path("kind", "closed").chmod(0o600)
    for folder in (None, cache.unfinished):
        if folder:  # as a user keeps it who cleans up
            folder.rmdir()
        with other_user():
            theirs = Cache(cache.folder)
            found = theirs.load("kind", "open", dict)
            assert theirs.load("kind", "closed", dict) is None
            assert theirs.load("kind", "missing", dict) is None
            assert not theirs.save("kind", "new", ARRAYS)
        np.testing.assert_array_equal(found["a"], ARRAYS["a"])
    assert "cannot read cache entry" in caplog.text
    assert "missing" not in caplog.text
    cache.folder.chmod(0o700)
    with other_user(), pytest.raises(ColmapEdgesError, match=r"cannot use .*ermission denied"):
        Cache(cache.folder)


def test_a_cache_of_another_user_saves_work(small, public, other_user, tmp_path):
    counts = trace(small, tmp_path / "first", public / "cache")[1]
    images, sparse = (shutil.copytree(path, public / path.name) for path in small)
    (public / "out").mkdir()
    (public / "out").chmod(0o777)
    with other_user():
        found = trace((images, sparse), public / "out" / "edges", public / "cache")[1]
    assert reused(found) == (6, counts["trace"]["edges"])


@pytest.mark.parametrize("has_contours", [False, True])
def test_edges_come_back_with_their_observations_and_contours(scene_edges, tmp_path, has_contours):
    contours = scene_edges if has_contours else Edges3D.none()
    made = flattened(TracedEdges(edges=scene_edges, contours=contours))
    cache = Cache(tmp_path)
    cache.save("edges", "key", made)
    found = unflattened(TracedEdges, cache.load("edges", "key", dict))
    assert found.contours.num_edges == contours.num_edges
    back = flattened(found)
    assert "edges.observations.positions" in back
    assert list(back) == list(made)
    for name, array in made.items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array)


def test_second_run_reuses_and_gives_the_same(small, tmp_path, hash_output):
    """With all stages: some of them read what detection leaves in memory."""
    whole = {"command": "mesh", **dict.fromkeys(PLAIN, True)}
    reference = trace(small, tmp_path / "reference", **whole)[0]
    first, made = trace(small, tmp_path / "first", tmp_path / "cache", **whole)
    again, found = trace(small, tmp_path / "again", tmp_path / "cache", **whole)
    assert reused(made) == (0, 0)
    assert reused(found) == (6, found["trace"]["edges"])
    assert found["trace"]["edges"] > 0
    expected = hash_output(reference)
    assert hash_output(first) == hash_output(again) == expected
    for name in ("detect", "trace"):
        left_out = ("images_reused", "edges_reused")
        without = [{k: v for k, v in c[name].items() if k not in left_out} for c in (made, found)]
        assert without[0] == without[1]


def test_changed_inputs_are_recomputed(small, tmp_path):
    images, cache = tmp_path / "images", tmp_path / "cache"
    shutil.copytree(small[0], images)
    scene, output = (images, small[1]), tmp_path / "out"
    edges = trace(scene, output, cache, "mesh")[1]["trace"]["edges"]
    meshing = MeshingOptions(quality_weight=0.5)
    written = {"output_type": "TXT", "mesh_type": "OBJ"}
    again = trace(scene, output, cache, "mesh", meshing=meshing, **written)[1]
    assert reused(again) == (6, edges)
    tracing = TracingOptions(curve_step_points=5)
    cached = partial(trace, scene, output, cache)
    assert reused(cached(tracing=tracing)[1]) == (6, 0)
    assert reused(cached(random_seed=1)[1]) == (6, 0)
    detection = DetectionOptions(min_chain_points=14)
    assert reused(cached(detection=detection)[1]) == (0, 0)
    path = sorted(images.iterdir())[2]
    cv2.imwrite(str(path), cv2.imread(str(path))[:, ::-1])
    assert reused(cached()[1]) == (5, 0)


def test_poses_refined_on_edges_come_back(small, tmp_path, hash_output):
    model = tmp_path / "off"
    model.mkdir()
    with_pose_noise(pycolmap.Reconstruction(small[1]), 0.5, 3).write(str(model))
    scene = (small[0], model)
    outputs = [
        trace(scene, tmp_path / name, tmp_path / "cache", refine_poses=True) for name in "ab"
    ]
    made, found = (counts["trace"] for _, counts in outputs)
    assert made["details"]["poses"]["refined"]
    assert found["details"] == made["details"]
    assert found["edges_reused"] == made["edges"] > 0
    assert hash_output(outputs[0][0]) == hash_output(outputs[1][0])


def test_damaged_images_are_left_out_again(small, tmp_path, hash_output):
    images = tmp_path / "images"
    shutil.copytree(small[0], images)
    sorted(images.iterdir())[1].write_bytes(b"no image")
    plain = trace((images, small[1]), tmp_path / "plain")[0]
    for name, expected in (("first", 0), ("again", 5)):
        output, counts = trace((images, small[1]), tmp_path / name, tmp_path / "cache")
        assert counts["detect"]["images_damaged"] == 1
        assert counts["detect"]["images_reused"] == expected
        assert hash_output(output) == hash_output(plain)


def test_damaged_entries_are_made_again(small, reference, filled, tmp_path, hash_output):
    entries = sorted(filled.rglob("*.entry"))
    assert len(entries) == 7
    sizes = [path.stat().st_size for path in entries]
    for path in entries[::2]:
        path.write_bytes(path.read_bytes()[:-100])
    output, counts = trace(small, tmp_path / "out", filled)
    assert hash_output(output) == hash_output(reference)
    assert reused(counts)[0] < 6
    assert [path.stat().st_size for path in entries] == sizes
    assert reused(trace(small, tmp_path / "out", filled)[1]) == (6, counts["trace"]["edges"])


def test_a_cache_that_cannot_be_written_is_done_without(
    small, reference, tmp_path, hash_output, caplog
):
    cache = tmp_path / "cache"
    cache.mkdir()
    (cache / "edge_graphs").touch()  # where a folder should be
    output, counts = trace(small, tmp_path / "out", cache)
    assert caplog.text.count("cannot write cache entry") == 1  # not one an image
    assert hash_output(output) == hash_output(reference)
    assert reused(counts) == (0, 0)


def test_output_within_the_cache_is_refused(small, tmp_path):
    (tmp_path / "cache").mkdir()
    with pytest.raises(ColmapEdgesError, match="choose another folder"):
        trace(small, tmp_path / "cache" / "out", tmp_path / "cache")


def test_a_scheduler_needs_a_cache(small, tmp_path):
    paths = Paths(image_path=small[0], input_path=small[1], output_path=tmp_path / "out")
    with pytest.raises(OptionError, match="cache_path"):
        run("mesh", paths, PipelineOptions(), scheduler="tcp://127.0.0.1:1")


def command(scene, output, cache):
    """The words of the command that traces the edges of a scene with a cache."""
    flags = ["--image_path", scene[0], "--input_path", scene[1], "--output_path", output]
    flags += ["--cache_path", cache, "--num_threads", 1, "--overwrite"]
    return ["reconstruct", *map(str, flags), "--refine_poses", "0"]


def test_two_runs_at_once_share_a_cache(small, reference, tmp_path, hash_output):
    outputs = [tmp_path / name for name in "ab"]
    runs = [Forked(COMMAND, *command(small, o, tmp_path / "cache")) for o in outputs]
    for output, process in zip(outputs, runs, strict=True):
        process.communicate()
        assert process.returncode == 0
        assert hash_output(output) == hash_output(reference)


def test_killed_runs_leave_no_half_entries(small, reference, tmp_path, hash_output, caplog, soak):
    cache, rng = tmp_path / "cache", np.random.default_rng(0)
    for _ in range(20 if soak else 2):
        process = Forked(COMMAND, *command(small, tmp_path / "killed", cache))
        while process.poll() is None and not (cache / "edge_graphs").exists():
            time.sleep(0.002)
        time.sleep(rng.uniform(0, 0.3))
        process.kill()
        process.communicate()
        left = len(list(cache.rglob("*.entry")))
        output, counts = trace(small, tmp_path / "out", cache)
        assert "damaged" not in caplog.text
        assert hash_output(output) == hash_output(reference)
        assert reused(counts)[0] == min(left, 6)
        shutil.rmtree(cache)


def test_report_counts_reused_results(small, tmp_path):
    for _ in range(2):
        done = call_forked([*command(small, tmp_path / "out", tmp_path / "cache"), "--verbose"])
        assert done.returncode == 0
    assert "6 images reused" in done.stdout
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["paths"]["cache_path"] == str(tmp_path / "cache")


def forged(path, kind, change):
    """Seal an entry again after a change of its arrays."""
    arrays = dict(unpacked(bytearray(path.read_bytes()[32:])))
    arrays |= change(arrays)
    data = packed({name: array for name, array in arrays.items() if array is not None})
    path.write_bytes(seal(kind, path.stem, data) + data)


FORGED_GRAPHS = {
    "missing": lambda a: {"points": None},
    "of another type": lambda a: {"points": a["points"].astype(float)},
    "of another shape": lambda a: {"normals": a["normals"][:, :1].copy()},
    "shorter": lambda a: {"colors": a["colors"][1:]},
    "outside of the image": lambda a: {"points": a["points"] + np.float32(900)},
    "offset out of range": lambda a: {"polyline_offsets": a["polyline_offsets"] + 10**6},
}
VIEWS = "edges.observations.views"
FORGED_EDGES = {
    "moved": lambda a: {"edges.points": a["edges.points"] + 1},
    "view out of range": lambda a: {VIEWS: a[VIEWS] + np.int32(99)},
    "counts of another kind": lambda a: {"details": np.array("[]")},
}


def test_forged_entries_are_made_again(small, reference, filled, tmp_path, hash_output, caplog):
    """Sealed like entries, but no result of a run: of each image in another way."""
    entries = sorted((filled / "edge_graphs").rglob("*.entry"))
    for path, change in zip(entries, FORGED_GRAPHS.values(), strict=True):
        forged(path, "edge_graphs", change)
    shutil.rmtree(filled / "edges")
    output, counts = trace(small, tmp_path / "out", filled)
    assert hash_output(output) == hash_output(reference)
    for path, name in zip(entries, FORGED_GRAPHS, strict=True):
        assert f"{path} is damaged; it is made again" in caplog.text, name
    assert reused(counts) == (0, 0)
    (path,) = (filled / "edges").rglob("*.entry")
    for name, change in FORGED_EDGES.items():
        forged(path, "edges", change)
        caplog.clear()
        output, counts = trace(small, tmp_path / "out", filled)
        assert hash_output(output) == hash_output(reference), name
        assert caplog.text.count("is damaged; it is made again") == 1
        assert reused(counts) == (6, 0)


@pytest.mark.parametrize("place", [0, 1])
def test_a_cache_among_the_inputs_is_refused(small, tmp_path, place):
    with pytest.raises(ColmapEdgesError, match=r"cache_path .* is inside or around the input"):
        trace(small, tmp_path / "out", small[place] / "cache")
    assert not (small[place] / "cache").exists()
