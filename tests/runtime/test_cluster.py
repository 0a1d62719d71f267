"""Tracing on a dask.distributed cluster: identical output, also when workers die."""

import os
import signal
import socket
import time

import pytest
import scenes
from cluster_tasks import die, die_once, fail_first, other_version
from forked import COMMAND, Forked

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run
from colmap_edges.runtime.cache import Cache
from colmap_edges.runtime.executors import cluster_workers, run_all

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

distributed = pytest.importorskip("distributed", reason="dask is not installed")


@pytest.fixture(scope="module")
def cluster():
    """Two workers, each a process of its own, on this machine's loopback."""
    with distributed.LocalCluster(
        n_workers=2,
        threads_per_worker=1,
        processes=True,
        host="127.0.0.1",
        dashboard_address=":0",
    ) as found:
        yield found


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """(image_path, input_path) of a small scene, one image of it damaged."""
    scene = scenes.make_scene(num_views=8, width=320, height=240)
    paths = scene.write(tmp_path_factory.mktemp("small"))
    sorted(paths[0].iterdir())[3].write_bytes(b"no image")
    return paths


@pytest.fixture(scope="module")
def reference(small, tmp_path_factory):
    """An output made by threads."""
    return reconstruct(small, tmp_path_factory.mktemp("reference") / "out")[0]


def reconstruct(scene, output, cache=None, **arguments):
    """Output folder and, by stage, the counts of a run."""
    paths = Paths(image_path=scene[0], input_path=scene[1], output_path=output, cache_path=cache)
    options = PipelineOptions(num_threads=1, report=False)
    report = run("reconstruct", paths, options, **arguments)
    return output, {stage["name"]: stage["counts"] for stage in report["stages"]}


def test_edges_are_those_of_threads(cluster, small, reference, tmp_path, hash_output):
    address, cache = cluster.scheduler_address, tmp_path / "cache"
    for name, images_reused in (("first", 0), ("again", 7)):
        output, counts = reconstruct(small, tmp_path / name, cache, scheduler=address)
        assert hash_output(output) == hash_output(reference)
        assert counts["detect"]["images_reused"] == images_reused
        assert counts["detect"]["images_damaged"] == 1
        assert counts["trace"]["edges"] > 5
    _, counts = reconstruct(small, tmp_path / "alone", cache)
    assert counts["trace"]["edges_reused"] == counts["trace"]["edges"]


def test_tasks_of_killed_workers_run_again(cluster, small, reference, tmp_path, hash_output):
    """One worker is killed while edges are detected, the other while they are traced."""
    with distributed.Client(cluster, set_as_default=False) as client:
        client.wait_for_workers(2)
        pids = client.run(os.getpid)
    victims = dict(zip(("detect", "trace"), pids.values(), strict=True))

    def kill(name, done, _total):
        if name in victims and done == 3:
            os.kill(victims.pop(name), signal.SIGKILL)

    output, _ = reconstruct(
        small,
        tmp_path / "out",
        tmp_path / "cache",
        scheduler=cluster.scheduler_address,
        progress=kill,
    )
    assert not victims
    assert hash_output(output) == hash_output(reference)


def test_detect_writes_the_same_files(cluster, small, tmp_path, hash_output):
    outputs = []
    for name, scheduler in (("threads", ""), ("cluster", cluster.scheduler_address)):
        paths = Paths(
            image_path=small[0],
            input_path=small[1],
            output_path=tmp_path / name,
            cache_path=tmp_path / f"cache of {name}",
        )
        run("detect", paths, PipelineOptions(num_threads=1), scheduler=scheduler)
        outputs.append(hash_output(tmp_path / name))
    assert len(outputs[0]) == 14
    assert outputs[0] == outputs[1]


def test_errors_of_workers_are_errors_of_the_run(cluster, small, tmp_path):
    import cv2

    images = tmp_path / "images"
    images.mkdir()
    for path in small[0].iterdir():
        (images / path.name).write_bytes(path.read_bytes())
    first = min(images.iterdir())
    cv2.imwrite(str(first), cv2.imread(str(first))[:100])
    with pytest.raises(ColmapEdgesError, match=r"is 320x100, its camera 320x240"):
        reconstruct(
            (images, small[1]),
            tmp_path / "out",
            tmp_path / "cache",
            scheduler=cluster.scheduler_address,
        )
    assert not (tmp_path / "out").exists()


def test_workers_of_another_version_are_refused(cluster, tmp_path, monkeypatch):
    monkeypatch.setattr("colmap_edges.runtime.executors.code_version", other_version)
    with (
        pytest.raises(ColmapEdgesError, match="other versions"),
        cluster_workers(cluster.scheduler_address, Cache(tmp_path)),
    ):
        pass


def test_a_task_that_dies_with_its_worker_runs_again(cluster, tmp_path):
    with cluster_workers(cluster.scheduler_address, Cache(tmp_path / "cache")) as workers:
        calls = [(die_once, (tmp_path / "marker",)) for _ in range(4)]
        assert all(pid != os.getpid() for pid in run_all(workers.views, calls))
    assert (tmp_path / "marker").exists()


def test_results_arriving_during_cancellation_do_not_block(cluster, tmp_path):
    with cluster_workers(cluster.scheduler_address, Cache(tmp_path / "cache")) as workers:
        for _ in range(40):
            with pytest.raises(ColmapEdgesError, match="the first"):
                run_all(workers.images, [(fail_first, (index,)) for index in range(8)])


def test_no_scheduler_at_the_address(small, tmp_path, monkeypatch):
    monkeypatch.setattr("colmap_edges.runtime.executors.ANSWER_S", 0.5)
    with pytest.raises(ColmapEdgesError, match=r"cannot reach the scheduler tcp://127.0.0.1:9"):
        reconstruct(small, tmp_path / "out", tmp_path / "cache", scheduler="tcp://127.0.0.1:9")
    assert not (tmp_path / "out").exists()


@pytest.fixture
def silent():
    """The address of a port that accepts connections and never answers."""
    with socket.socket() as listening:
        listening.bind(("127.0.0.1", 0))
        listening.listen()
        yield f"tcp://127.0.0.1:{listening.getsockname()[1]}"


def new_cluster(allowed_failures=3):
    """A cluster of one's own, of one worker."""
    import dask

    with dask.config.set({"distributed.scheduler.allowed-failures": allowed_failures}):
        return distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, host="127.0.0.1", dashboard_address=":0"
        )


def test_a_silent_scheduler_is_given_up(silent, small, tmp_path, monkeypatch):
    monkeypatch.setattr("colmap_edges.runtime.executors.ANSWER_S", 0.5)
    with pytest.raises(ColmapEdgesError, match=rf"scheduler {silent}: no answer .*; check"):
        reconstruct(small, tmp_path / "out", tmp_path / "cache", scheduler=silent)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_waiting_for_a_scheduler_ends_at_once(silent, small, tmp_path, number):
    flags = ["--image_path", small[0], "--input_path", small[1], "--scheduler", silent]
    flags += ["--cache_path", tmp_path / "cache", "--output_path", tmp_path / "out"]
    process = Forked(COMMAND, "mesh", *flags)
    while not (tmp_path / "cache").exists() and process.poll() is None:
        time.sleep(0.01)
    time.sleep(0.5)
    started = time.monotonic()
    process.send_signal(number)
    _, errors = process.communicate()
    assert process.returncode == 128 + number
    assert "Traceback" not in errors
    assert time.monotonic() - started < 5
    assert [path.name for path in tmp_path.iterdir()] == ["cache"]


def test_clusters_without_workers(tmp_path, monkeypatch):
    """At the start, and when the last one is lost while work is done."""
    monkeypatch.setattr("colmap_edges.runtime.executors.WATCH_S", 0.1)
    with new_cluster() as cluster:
        words = rf"scheduler {cluster.scheduler_address} had no workers .* dask worker"
        with cluster_workers(cluster.scheduler_address, Cache(tmp_path)) as workers:
            monkeypatch.setattr("colmap_edges.runtime.executors.WORKERS_S", 0.5)
            cluster.scale(0)
            calls = [(time.sleep, (60,))] * 3
            with pytest.raises(ColmapEdgesError, match=words):
                run_all(workers.views, calls, check=workers.check)
        with (
            pytest.raises(ColmapEdgesError, match=words),
            cluster_workers(cluster.scheduler_address, Cache(tmp_path)),
        ):
            pass


def test_tasks_that_end_their_workers_end_the_run(tmp_path):
    with (
        new_cluster(allowed_failures=0) as cluster,
        pytest.raises(ColmapEdgesError, match="repeatedly ended its worker"),
        cluster_workers(cluster.scheduler_address, Cache(tmp_path)) as workers,
    ):
        run_all(workers.views, [(die, ())], check=workers.check)


def test_a_scheduler_that_is_lost(tmp_path, monkeypatch):
    monkeypatch.setattr("colmap_edges.runtime.executors.ANSWER_S", 1)
    cluster = new_cluster()
    with (
        pytest.raises(
            ColmapEdgesError, match=r"scheduler tcp\S+ (was lost|does not answer); start"
        ),
        cluster_workers(cluster.scheduler_address, Cache(tmp_path)) as workers,
    ):
        cluster.close()
        run_all(workers.views, [(time.sleep, (60,))], check=workers.check)
