"""Odd environment variables, limits of memory and threads, and signals while libraries load."""

import os
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from forked import call_forked

from colmap_edges.cli import imports
from colmap_edges.cli.errors import one_line
from colmap_edges.cli.imports import check_opencv_variables, importing
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.runtime.platform import signals_deferred

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

ODD = {
    **{"TZ": "XXX-99:99:99", "OPENBLAS_NUM_THREADS": "x", "COLUMNS": "x", "LINES": "-5"},
    **{"LC_ALL": "x", "LANG": "zz_ZZ.UTF-99", "PYTHONHASHSEED": "7", "HOME": None},
    **{"TMPDIR": "/nowhere", "NO_COLOR": "1", "FORCE_COLOR": "x", "TERM": "odd"},
    **{"OPENCV_LOG_LEVEL": "x", "MALLOC_ARENA_MAX": "x", "PATH": ""},
}
REFUSED = ("OPENCV_FOR_THREADS_NUM", "OPENCV_IO_MAX_IMAGE_PIXELS", "OPENCV_TRACE")
NOBODY = (65533, 65533)  # a user without processes


def command(scene, output, *flags):
    words = [sys.executable, "-m", "colmap_edges", "mesh", "--report", "0", "--num_threads", "4"]
    words += ["--image_path", scene[0], "--input_path", scene[1], "--output_path", output, *flags]
    return [os.fspath(word) for word in words]


def call(scene, output, *flags, variables=None, **how):
    changed = os.environ | (variables or {})
    environment = {name: value for name, value in changed.items() if value is not None}
    return subprocess.run(
        command(scene, output, *flags),
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
        **how,
    )


def check_one_line(done, *words):
    assert done.returncode == 1, done.stdout + done.stderr
    *logged, line = done.stderr.splitlines()  # OpenCV logs that it has no threads
    assert line.startswith("Error: "), done.stderr
    assert all("Can't spawn new thread" in each for each in logged), done.stderr
    assert all(word in line for word in words), line


def test_odd_variables_change_nothing(small, tmp_path, soak, show):
    tried = [{name: value} for name, value in ODD.items()] if soak else []
    for number, variables in enumerate([ODD, *tried]):
        # BLAS then has a thread for each core, which wait for each other in all stages.
        flags = ("--use_faces", "0", "--use_patches", "0")
        done = call(small, tmp_path / str(number), *flags, variables=variables)
        assert done.returncode == 0, (variables, done.stderr)
        assert done.stderr == "", variables
    show(f"odd environment variables: {1 + len(tried)} runs, none refused")


@pytest.mark.parametrize("name", REFUSED)
def test_variables_that_opencv_cannot_read_are_named(monkeypatch, tmp_path, name):
    monkeypatch.chdir(tmp_path)  # in which OpenCV traces
    monkeypatch.setenv(name, "x")
    with pytest.raises(ColmapEdgesError, match=f"{name}=x; unset"):
        check_opencv_variables()
    monkeypatch.setenv(name, "1")
    check_opencv_variables()


def test_libraries_that_do_not_load_are_one_line(monkeypatch):
    monkeypatch.setattr(imports, "HANDLED", [])
    text = r"cannot load the libraries \(no such thing\)"
    with pytest.raises(ColmapEdgesError, match=text), importing():
        raise ImportError("no such\nthing")


def test_little_address_space_is_one_line(small, tmp_path, soak, show):
    sizes = range(100, 1500, 25) if soak else (300,)
    refused = 0
    for size in sizes:
        limit = (size << 20,) * 2
        done = call(
            small,
            tmp_path / str(size),
            preexec_fn=lambda limit=limit: resource.setrlimit(resource.RLIMIT_AS, limit),
        )
        if done.returncode:
            check_one_line(done, "memory" if size << 20 >= 1e9 else "address space")
            assert not (tmp_path / str(size)).exists()
        refused += done.returncode != 0
    show(f"limits of the address space: {len(sizes)} runs, {refused} refused")
    assert refused


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can act as another user")
@pytest.mark.parametrize("num_processes", [1, 2, 3])
def test_threads_that_cannot_be_had(small, public, num_processes):
    for path in small:
        shutil.copytree(path, public / path.name)
    (public / "mine").mkdir()
    os.chown(public / "mine", *NOBODY)
    scene = [public / path.name for path in small]
    words = command(scene, public / "mine" / "out")[3:]
    done = call_forked(words, user=NOBODY, num_processes=num_processes, timeout=60)
    if done.returncode:
        check_one_line(done, "threads", "ulimit -u")
    assert [path.name for path in (public / "mine").iterdir()] == ["out"] * (not done.returncode)
    assert num_processes > 1 or done.returncode


@pytest.mark.parametrize("text", ["std::bad_alloc", "can't start new thread", ""])
def test_refused_memory_and_threads_are_one_line(text):
    error = RuntimeError(text) if text else MemoryError()
    assert one_line(error).startswith("the system refuses memory or threads")
    assert one_line(ValueError("a fault of this program")) is None


def test_signals_wait_until_the_block_ends():
    met = []
    before = signal.signal(signal.SIGUSR1, lambda number, _frame: met.append(number))
    try:
        with signals_deferred([signal.SIGUSR1]):
            # Of the process, another thread of the test runner would take it.
            signal.pthread_kill(threading.get_ident(), signal.SIGUSR1)
            assert met == []
        assert met == [signal.SIGUSR1]
    finally:
        signal.signal(signal.SIGUSR1, before)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_signals_while_libraries_load(small, tmp_path, number, soak):
    """The process ends with the code of the signal, without a dump of its stack."""
    for delay in (0.02 * step for step in range(25 if soak else 1)):
        process = subprocess.Popen(
            command(small, tmp_path / "out"),
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=lambda: signal.signal(number, signal.SIG_DFL),
        )
        while process.poll() is None and "pycolmap/_core" not in maps_of(process.pid):
            time.sleep(0.002)
        time.sleep(delay)
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
        assert process.returncode == 128 + number
        interrupted = "Interrupted; nothing was written."
        assert errors.strip() == (interrupted if number == signal.SIGINT else "")
        assert not any(tmp_path.iterdir())


def maps_of(pid):
    """The files that a process has loaded."""
    try:
        return Path(f"/proc/{pid}/maps").read_text()
    except OSError:
        return ""
