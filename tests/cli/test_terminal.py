"""Closed standard streams, ignored signals, and names that are not plain text."""

import io
import logging
import os
import pty
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time

import pycolmap
import pytest
from forked import COMMAND, Forked, call_forked

from colmap_edges.cli.main import main
from colmap_edges.cli.terminal import LogFormatter, duration, wrapped
from colmap_edges.colmap.model import load_model
from colmap_edges.errors import printable

FAST = ("--use_edges", "0", "--report", "0")
PLAIN = ("--use_faces", "0", "--use_patches", "0", "--refine_poses", "0")  # what takes long
RED = "\x1b[31m"


def command(scene, output, *flags, name="mesh"):
    run = [sys.executable, "-m", "colmap_edges", name, "--image_path", scene[0]]
    return [os.fspath(word) for word in (*run, "--input_path", scene[1], *flags)] + [
        "--output_path",
        os.fspath(output),
    ]


def call(scene, output, *flags, name="mesh", **how):
    run = command(scene, output, *flags, name=name)
    if how:
        return subprocess.run(run, capture_output=True, text=True, timeout=120, **how)
    return call_forked(run[3:])


def renamed(scene, folder, names):
    """A copy of a scene with other names of its first images."""
    images, sparse = folder / "images", folder / "sparse"
    shutil.copytree(scene[0], images)
    sparse.mkdir()
    reconstruction = pycolmap.Reconstruction(str(scene[1]))
    for image, name in zip(reconstruction.images.values(), names, strict=False):
        source = scene[0] / image.name
        (images / image.name).unlink()
        image.name = name
        (images / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(source, images / name)
    reconstruction.write_binary(str(sparse))
    return images, sparse


@pytest.fixture(scope="module")
def usual(small, tmp_path_factory):
    """What a run makes; read-only by agreement."""
    output = tmp_path_factory.mktemp("usual") / "out"
    assert call(small, output, *FAST[2:], *PLAIN).returncode == 0
    return output


@pytest.mark.parametrize("closed", ["2>&-", ">&-", "<&- >&- 2>&-", "<&-", "2>&- >/dev/null"])
def test_closed_streams_do_no_harm(small, tmp_path, closed, hash_output, usual, soak):
    if closed in ("<&-", "2>&- >/dev/null") and not soak:
        pytest.skip("in the long version: they are closed together with others above")
    run = shlex.join(command(small, tmp_path / "out", *FAST[2:], *PLAIN))
    done = subprocess.run(["sh", "-c", f"{run} {closed}"], capture_output=True, timeout=120)
    assert done.returncode == 0
    assert hash_output(tmp_path / "out") == hash_output(usual)


def test_errors_with_a_closed_stream_keep_their_code(small, tmp_path):
    run = shlex.join(command((small[0], tmp_path), tmp_path / "out"))
    done = subprocess.run(["sh", "-c", f"{run} 2>&-"], timeout=120)
    assert done.returncode == 1


@pytest.mark.parametrize(("ignored", "code"), [(True, 0), (False, 129)])
def test_nohup_is_respected(small, tmp_path, ignored, code):
    words = command(small, tmp_path / "out", *PLAIN)[3:]
    process = Forked(COMMAND, *words, hangup_ignored=ignored)
    end = time.monotonic() + 60
    while not any(tmp_path.glob(".out.*/new")) and time.monotonic() < end:
        time.sleep(0.002)
    for _ in range(2):  # the kernel and the shell both send it
        process.send_signal(signal.SIGHUP)
    _, errors = process.communicate()
    assert (process.returncode, errors) == (code, "")
    assert [path.name for path in tmp_path.iterdir()] == ["out"] * ignored


def test_closed_terminal_leaves_no_files(small, tmp_path):
    """The kernel then hangs up on the run, whose messages go nowhere."""
    pid, terminal = pty.fork()
    if pid == 0:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # also where nohup runs the tests
        os.execv(sys.executable, command(small, tmp_path / "out"))
    end = time.monotonic() + 60
    while not any(tmp_path.glob(".out.*/new")) and time.monotonic() < end:
        time.sleep(0.002)
    os.close(terminal)
    _, status = os.waitpid(pid, 0)
    assert os.waitstatus_to_exitcode(status) == 129
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a b.jpg", "a b.jpg"),
        ("größe 木.jpg", "größe 木.jpg"),
        (f"{RED}x", r"\x1b[31mx"),
        ("a\r\nb\tc\x9b\x7f", r"a\r\nb\tc\x9b\x7f"),
        ("\u202egpj.exe", r"\u202egpj.exe"),
        ("caf\udce9", r"caf\udce9"),
    ],
)
def test_printable(text, shown):
    assert printable(text) == shown


def test_logs_are_printable():
    stream = io.StringIO()
    handler = logging.StreamHandler(stream)
    handler.setFormatter(LogFormatter(verbose=False))
    logger = logging.Logger("test")
    logger.addHandler(handler)
    try:
        raise ValueError(f"{RED}\nx")
    except ValueError:
        logger.exception("image %s", f"a\n{RED}")
    lines = stream.getvalue().split("\n")
    assert lines[0] == r"ERROR test: image a\n\x1b[31m"
    assert lines[1].startswith("Traceback")
    assert "\x1b" not in stream.getvalue()


def test_names_of_images_and_folders_cannot_steer_the_terminal(small, tmp_path):
    scene = renamed(small, tmp_path / "in", [f"a{RED}.jpg", "b\nc.jpg"])
    (scene[0] / f"a{RED}.jpg").write_bytes(b"damaged")
    output = tmp_path / f"out{RED}\n"
    done = call(scene, output, name="detect")
    assert done.returncode == 0, done.stderr
    assert r"a\x1b[31m.jpg" in done.stderr
    assert r"out\x1b[31m\n/overlays (" in done.stdout
    info = call_forked(["info", output])
    assert "Made by:  colmap-edges detect" in info.stdout
    (scene[0] / "b\nc.jpg").unlink()
    missing = call(scene, tmp_path / "second", "--verbose", name="detect")
    assert r"b\nc.jpg of the model is not in" in missing.stderr
    usage = call(scene, tmp_path / "second", f"--{RED}")
    assert usage.returncode == 2
    for text in (done, info, missing, usage):
        assert "\x1b" not in text.stdout + text.stderr


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("--Meshing.max_fces", "--Meshing.max_faces"),
        ("--edgegraph.max-gap=2", "--EdgeGraph.max_gap_points"),
    ],
)
def test_unknown_flags_are_named_as_typed_and_suggestions_as_in_the_help(capsys, typed, meant):
    """Versions of click differ in the words around them."""
    with pytest.raises(SystemExit) as end:
        main(["mesh", typed])
    assert end.value.code == 2
    before, after = capsys.readouterr().err.split(typed.split("=")[0], 1)
    assert "No such option" in before
    assert meant in after


@pytest.mark.parametrize("width", [30, 80])
def test_lines_are_broken_between_words(width):
    text = "Faces:    46 planar, total area 1,234,567.8 square scene units; only in /a/b-c/f.json"
    lines = wrapped(text, width)
    assert " ".join(line.strip() for line in lines) == text.replace(":    ", ":    ")
    assert all(line.startswith(" " * 10) for line in lines[1:]) and len(lines) > 1
    assert all(len(line) <= width or " " not in line.strip() for line in lines)
    assert wrapped("short", width) == ["short"] and wrapped("", width) == [""]


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(8.64, "8.6 s"), (42.2, "42 s"), (119.8, "2 min 0 s"), (7290, "2 h 1 min")],
)
def test_durations(seconds, text):
    assert duration(seconds) == text


def test_a_terminal_shows_what_is_left_and_whole_lines_of_logs():
    script = (
        "import logging, time; from colmap_edges.cli.terminal import progress_bars, start_logging\n"
        "start_logging(True)\n"
        "with progress_bars() as show:\n"
        "    show('detect', 0, 40)\n"
        "    for step in range(1, 20):\n"
        "        time.sleep(0.02); show('detect', step, 40)\n"
        "    logging.getLogger('colmap_edges.any').debug('a line of the log')\n"
        "    time.sleep(0.3)\n"
    )
    terminal, process_end = pty.openpty()
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "80", "LINES": "24"}
    with subprocess.Popen(
        [sys.executable, "-c", script], stderr=process_end, env=environment
    ) as process:
        os.close(process_end)
        shown = b""
        while True:
            try:
                part = os.read(terminal, 4096)
            except OSError:  # the other end is closed
                break
            if not part:
                break
            shown += part
    os.close(terminal)
    assert process.returncode == 0
    text = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.decode())
    lines = re.split(r"[\r\n]+", text)
    assert "DEBUG colmap_edges.any: a line of the log" in lines
    last = [line for line in lines if line.strip().startswith("detect")][-1]
    assert re.search(r"19/40 +0:00:0\d about \d\.\d s left", last), last
    assert any(line.strip().startswith("in all") for line in lines)
    assert max(map(len, lines)) <= 80


def test_usage_errors_go_to_standard_error(capsys):
    with pytest.raises(SystemExit) as end:
        main(["mesh", "--no\a_flag"])
    assert end.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[0].startswith("Usage: ")
    assert r"--no\x07_flag" in lines[-1]


def test_unencodable_characters_are_escaped(small, tmp_path):
    environment = os.environ | {"PYTHONIOENCODING": "latin-1"}
    done = call(small, tmp_path / "木", *FAST, env=environment)
    assert done.returncode == 0, done.stderr
    assert r"\u6728/mesh.ply (" in done.stdout


def test_undecodable_paths_work(small, tmp_path, hash_output, usual):
    def bad(name):
        return tmp_path / os.fsdecode(name + b"\xe9")

    scene = bad(b"images"), bad(b"sparse")
    for source, target in zip(small, scene, strict=True):
        shutil.copytree(source, target)
    cache = (*PLAIN, "--cache_path", bad(b"cache"))
    for flags in (cache, (*cache, "--overwrite"), (*PLAIN, "--overwrite", "--output_type", "TXT")):
        done = call(scene, bad(b"out"), *flags)
        assert done.returncode == 0, done.stderr
        if "TXT" not in flags:
            assert hash_output(bad(b"out")) == hash_output(usual)
    assert call_forked(["info", bad(b"out")]).returncode == 0
    (bad(b"out") / os.fsdecode(b"n\xe9")).write_text("mine")
    done = call(scene, bad(b"out"), "--overwrite")
    assert done.returncode == 1
    assert done.stderr.startswith(f"Error: {tmp_path}/out")
    wrong = call((tmp_path, bad(b"nowhere")), tmp_path / "second")
    assert wrong.returncode == 1
    assert wrong.stderr.count("\n") == 1


INVALID_IN_TEXT = ("a\nb.jpg", "a b.jpg", "a.jpg\t", "\vx.jpg")


@pytest.mark.parametrize("name", INVALID_IN_TEXT)
def test_names_invalid_in_text_models(small, tmp_path, name):
    scene = renamed(small, tmp_path / "in", [name])
    done = call(scene, tmp_path / "out", "--output_type", "TXT")  # refused before all work
    assert done.returncode == 1
    assert f"image name {name!r} has a space or line break" in done.stderr
    assert done.stderr.count("\n") == 1


def test_names_invalid_in_text_models_are_valid_in_binary_ones(small, tmp_path):
    scene = renamed(small, tmp_path / "in", INVALID_IN_TEXT)
    assert call(scene, tmp_path / "out", *FAST[2:], *PLAIN).returncode == 0
    names = {view.name for view in load_model(tmp_path / "out" / "sparse").views}
    assert set(INVALID_IN_TEXT) <= names


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("x.jpg", "./x.jpg"), "x.jpg and x.jpg|x.jpg and ./x.jpg|./x.jpg and x.jpg"),
        (("a/x.jpg", "a//x.jpg"), "a//x.jpg"),
        (("x", "x.npz/y"), "folder of image x.npz/y"),
    ],
)
def test_images_with_the_same_output_file(small, tmp_path, names, words):
    scene = renamed(small, tmp_path / "in", names)
    done = call(scene, tmp_path / "out", name="detect")
    assert done.returncode == 1
    assert any(word in done.stderr for word in words.split("|"))
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("address", ["foo", "bogus://x:1", "inproc://1", "tls://127.0.0.1:9"])
def test_invalid_scheduler_addresses_are_errors(small, tmp_path, address):
    pytest.importorskip("distributed", reason="dask is not installed")
    started = time.monotonic()
    flags = ("--scheduler", address, "--cache_path", tmp_path / "cache")
    done = call(small, tmp_path / "out", *flags)
    assert done.returncode == 1
    assert done.stderr.startswith(f"Error: cannot reach the scheduler {address}: ")
    assert done.stderr.count("\n") == 1
    assert time.monotonic() - started < 15
