"""Interrupted runs: signals, full disks, folders that are not writable."""

import shutil
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from forked import COMMAND, Forked, call_forked

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

SIGNALS = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
RUNS, SOAK_RUNS = 4, 50
PLAIN = ("--use_faces", 0, "--use_patches", 0, "--refine_poses", 0)  # what takes long
needs_mounts = pytest.mark.skipif(
    not shutil.which("unshare")
    or subprocess.run(["unshare", "-rm", "true"], capture_output=True).returncode != 0,
    reason="needs a mount namespace",
)


@pytest.fixture(scope="module")
def mesh_command(small):
    """A function that gives the command that meshes the small scene."""

    def command(output, *flags):
        run = ["mesh", "--output_path", output, *flags]
        run += ["--image_path", small[0], "--input_path", small[1]]
        return [str(word) for word in [*run, "--num_threads", 1]]

    return command


def in_shell(words):
    """The command line with these words, in a process of its own, as a shell's line."""
    return subprocess.list2cmdline([sys.executable, "-m", "colmap_edges", *words])


@pytest.fixture(scope="module")
def flags(soak):
    """Those of the runs that signals end: in the long version all stages."""
    return ("--overwrite",) if soak else ("--overwrite", *PLAIN)


@pytest.fixture(scope="module")
def undisturbed(mesh_command, flags, tmp_path_factory):
    """An output, another one without edges, and seconds from the start of work to the end."""
    folder = tmp_path_factory.mktemp("undisturbed")
    assert call_forked(mesh_command(folder / "plain", "--use_edges", 0)).returncode == 0
    process = Forked(COMMAND, *mesh_command(folder / "edges", *flags))
    wait_for(folder / "edges", process)
    started = time.monotonic()
    process.communicate()
    assert process.returncode == 0
    return folder / "edges", folder / "plain", time.monotonic() - started


@pytest.fixture(scope="module")
def plain(mesh_command, tmp_path_factory):
    """An output without faces; read-only by agreement."""
    output = tmp_path_factory.mktemp("plain") / "out"
    assert call_forked(mesh_command(output, *PLAIN)).returncode == 0
    return output


def wait_for(output, process):
    """Wait until the work on an output has begun or the process is gone."""
    work = output.with_name(f".{output.name}.colmap-edges") / "new"
    while not work.exists() and process.poll() is None:
        time.sleep(0.002)


def test_signals_at_random_moments(
    mesh_command, flags, undisturbed, tmp_path, hash_output, soak, show
):
    whole, plain, seconds = undisturbed
    expected = hash_output(whole)
    earlier = hash_output(plain)
    ends = []
    for seed in range(10 * SOAK_RUNS):
        if sum(code != 0 for _, code in ends) == (SOAK_RUNS if soak else RUNS):
            break
        rng = np.random.default_rng(seed)
        folder = tmp_path / str(seed)
        folder.mkdir()
        output = folder / "out"
        if seed % 2:
            shutil.copytree(plain, output)
        number = SIGNALS[seed // 2 % 4]
        code = interrupt(mesh_command(output, *flags), output, number, rng, seconds)
        found = hash_output(output) if output.exists() else None
        # The whole new output, or what was there before; a kill may leave that moved aside.
        assert found in (expected, earlier if seed % 2 else None, None)
        if number != signal.SIGKILL and code != 0:
            assert [path.name for path in folder.iterdir()] == ["out"] * (found is not None)
            assert found is not None or not seed % 2
        assert call_forked(mesh_command(output, *flags)).returncode == 0
        assert hash_output(output) == expected
        assert [path.name for path in folder.iterdir()] == ["out"]
        ends.append((number.name, code))
        seconds *= 1 if code else 0.8  # it was faster this time
        shutil.rmtree(folder)
    hit = sum(code != 0 for _, code in ends)
    show(f"interruptions survived: {hit} before the end, {len(ends) - hit} at it")
    assert hit >= RUNS


def interrupt(command, output, number, rng, seconds):
    """Send a signal at a random moment of the run; give the exit code."""
    process = Forked(COMMAND, *command)
    wait_for(output, process)
    time.sleep(rng.uniform(0, seconds))
    process.send_signal(number)
    _, errors = process.communicate()
    assert "Traceback" not in errors, errors
    assert process.returncode in (0, -number, 128 + number)
    return process.returncode


@pytest.mark.parametrize("output_type", ["BIN", "TXT"])
def test_files_that_cannot_be_whole(
    mesh_command, plain, tmp_path, hash_output, soak, show, output_type
):
    """With every limit below the largest file a run is one line and leaves nothing."""
    sizes = sorted({p.stat().st_size for p in plain.rglob("*") if p.is_file()})
    limits = [size - 1 for size in sizes] if soak else [sizes[0] - 1, sizes[-1] - 1]
    for limit in limits:
        command = mesh_command(tmp_path / "out", *PLAIN, "--output_type", output_type)
        check_refused(call_forked(command, file_size=limit), tmp_path)
    show(f"{output_type}: runs with files cut short: {len(limits)}")


def check_refused(done, folder):
    """One clear line, and nothing in the folder."""
    assert done.returncode == 1, done.stdout + done.stderr
    lines = [line for line in done.stderr.splitlines() if line.startswith("Error: ")]
    assert len(lines) == 1
    assert "cannot write" in lines[0]
    assert "Traceback" not in done.stderr
    assert not any(folder.iterdir())


@needs_mounts
@pytest.mark.parametrize("output_type", ["BIN", "TXT"])
def test_full_disk(mesh_command, plain, tmp_path, hash_output, soak, show, output_type):
    """On a disk too small for the output the run is refused; with room it is as ever."""
    needed = sum(p.stat().st_size for p in plain.rglob("*") if p.is_file()) // 1024
    sizes = np.linspace(0.9 * needed, 4, 16 if soak else 1).astype(int).tolist()
    disk = tmp_path / "disk"
    disk.mkdir()
    flags = [*PLAIN, "--output_type", output_type, "--overwrite"]
    command = in_shell(mesh_command(disk / "out", *flags))
    for size in sizes:
        script = (
            f"mount -t tmpfs -o size={size}k none {disk} || exit 99\n"
            f"{command}; code=$?\n"
            f"ls -A {disk} > {tmp_path}/left\n"
            f"mount -o remount,size=50m {disk}; {command}\n"
            f"cp -r {disk}/out {tmp_path}/{size}; exit $code"
        )
        done = subprocess.run(
            ["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True
        )
        assert (tmp_path / "left").read_text() == "", size
        check_refused(done, disk)
        if output_type == "BIN":
            assert hash_output(tmp_path / str(size)) == hash_output(plain)
        assert (tmp_path / str(size) / "sparse" / f"points3D.{output_type.lower()}").is_file()
    show(f"{output_type}: full disks of {len(sizes)} sizes")


@needs_mounts
def test_read_only_disk(mesh_command, tmp_path):
    command = in_shell(mesh_command(tmp_path / "disk" / "out"))
    (tmp_path / "disk").mkdir()
    script = f"mount -t tmpfs -o ro none {tmp_path}/disk || exit 99; {command}"
    done = subprocess.run(["unshare", "-rm", "sh", "-c", script], capture_output=True, text=True)
    check_refused(done, tmp_path / "disk")
    assert "Read-only file system" in done.stderr


def test_two_runs_at_once(mesh_command, plain, tmp_path, hash_output):
    """The second is refused while the first goes on undisturbed."""
    first = Forked(COMMAND, *mesh_command(tmp_path / "out", *PLAIN))
    wait_for(tmp_path / "out", first)
    first.send_signal(signal.SIGSTOP)
    try:
        second = call_forked(mesh_command(tmp_path / "out"))
    finally:
        first.send_signal(signal.SIGCONT)
    assert second.returncode == 1
    assert second.stderr.startswith("Error: another run is writing to")
    first.communicate()
    assert first.returncode == 0
    assert hash_output(tmp_path / "out") == hash_output(plain)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_interrupted_evaluation_leaves_no_files(plain, small, tmp_path, number):
    pytest.importorskip("embreex", reason="the extra for evaluation is not installed")
    shutil.copytree(plain, tmp_path / "out")
    run = ["evaluate", "--run_path", tmp_path / "out", "--input_path", small[1]]
    run += ["--image_path", small[0], "--held_out_views", 2]
    process = Forked(COMMAND, *run)
    wait_for(tmp_path / "out" / "evaluation", process)
    process.send_signal(number)
    _, errors = process.communicate()
    assert (process.returncode, errors) == (128 + number, "")
    assert not any("evaluation" in path.name for path in (tmp_path / "out").iterdir())
