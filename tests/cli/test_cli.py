import json
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import asdict, fields

import pytest
from forked import COMMAND, Forked, call_forked

import colmap_edges
from colmap_edges.options import PipelineOptions, preset

WORK = ".out.colmap-edges/new"  # where the output is in the making
pytestmark = pytest.mark.pipeline  # runs of the whole pipeline


def start(*args, **kwargs):
    command = [sys.executable, "-m", "colmap_edges", *map(str, args)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL}
    return subprocess.Popen(command, text=True, **pipes, **kwargs)


def call(*args, code=0):
    done = call_forked(map(str, args))
    assert done.returncode == code, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout + done.stderr


@pytest.fixture
def flags(scene_paths, tmp_path):
    return [
        *("--image_path", scene_paths[0], "--input_path", scene_paths[1]),
        *("--output_path", tmp_path / "out"),
    ]


@pytest.fixture
def quick(small, tmp_path):
    """Flags of a run of the small scene."""
    scene = ("--image_path", small[0], "--input_path", small[1])
    return [*scene, "--output_path", tmp_path / "out"]


@pytest.fixture(scope="module")
def undisturbed(scene_paths, tmp_path_factory):
    """What `detect` writes of the usual scene; read-only by agreement."""
    output = tmp_path_factory.mktemp("undisturbed") / "out"
    words = ("--image_path", scene_paths[0], "--input_path", scene_paths[1])
    call("detect", *words, "--output_path", output)
    return output


@pytest.mark.parametrize("command", ["detect", "reconstruct", "mesh", "info"])
def test_help_names_the_flags(command):
    assert "--verbose" in call(command, "--help")


# What takes long to import, by name: nothing of it may be there when a command starts.
HEAVY = {"numpy", "scipy", "cv2", "pycolmap", "networkx", "trimesh", "pymeshlab", "email"}


def test_help_imports_nothing_heavy():
    script = (
        "import sys; from colmap_edges.cli.main import main\n"
        "try: main(['mesh', '--help'])\n"
        f"finally: print(sorted({HEAVY | {'rich'}!r} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_progress_is_shown_before_anything_heavy_is_imported(flags, tmp_path):
    script = (
        "import contextlib, sys\n"
        "from colmap_edges.cli import run_commands\n"
        "from colmap_edges.cli.main import main\n"
        f"heavy = {HEAVY!r}\n"
        "@contextlib.contextmanager\n"
        "def bars():\n"
        "    yield lambda *step: sys.exit(f'{step} {sorted(heavy & set(sys.modules))}')\n"
        "run_commands.progress_bars = bars\n"
        "main(['mesh', *sys.argv[1:]])\n"
    )
    arguments = [sys.executable, "-c", script, *map(str, flags)]
    done = subprocess.run(arguments, capture_output=True, text=True)
    assert done.stderr.strip() == "('read', 0, 1) []"


@pytest.mark.parametrize("own", [None, "3"])
def test_blas_has_one_thread_unless_the_user_says_otherwise(own):
    environment = {k: v for k, v in os.environ.items() if k != "OPENBLAS_NUM_THREADS"}
    script = (
        "import os; from colmap_edges.cli.main import main\n"
        "try: main(['--version'])\n"
        "finally: print(os.environ['OPENBLAS_NUM_THREADS'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        env=environment | ({"OPENBLAS_NUM_THREADS": own} if own else {}),
        capture_output=True,
        text=True,
    )
    assert done.stdout.splitlines()[-1] == (own or "1")


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries are not told")
def test_large_arrays_live_where_freed_ones_did():
    script = (
        "import resource, threading; from colmap_edges.cli.main import main\n"
        "try: main(['--version'])\n"
        "except SystemExit: pass\n"
        "import numpy as np\n"
        "def faults():\n"
        "    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "    worker = threading.Thread(target=np.ones, args=(8_000_000,))\n"
        "    worker.start(); worker.join()\n"
        "    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before\n"
        "print([faults() for _ in range(4)])"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    faults = json.loads(done.stdout.splitlines()[-1])
    assert faults[0] > 100
    assert max(faults[1:]) < 0.2 * faults[0]


def test_version():
    pattern = rf"colmap-edges {re.escape(colmap_edges.__version__)}, pycolmap \d.*, OpenCV \d.*, "
    assert re.search(pattern + r"numpy \d.*, CGAL \d", call("--version"))


def test_detect_says_where_files_are(flags, tmp_path):
    output = call("detect", *flags)
    assert str(tmp_path / "out") in output
    assert "overlays" in output
    assert len(list((tmp_path / "out" / "overlays").iterdir())) == 10


def test_hyphens_and_case_do_not_matter(small, tmp_path):
    call(
        *("detect", "--image-path", small[0], "--INPUT-path", small[1]),
        *("--output-path", tmp_path / "out", "--edgegraph.max-gap-points", "3.5"),
    )
    report = (tmp_path / "out" / "report.json").read_text()
    assert '"max_gap_points": 3.5' in report


def test_config_gives_defaults_and_flags_go_before(quick, tmp_path):
    config = tmp_path / "config.toml"
    config.write_text(
        "num_threads = 1\nmax-graph-memory-gb = 7\n[EdgeGraph]\nmax_gap_points = 2.5\n"
        "filter_regular_length = true\n"
    )
    call("detect", *quick, "--config", config, "--max_graph_memory_gb", "8")
    report = (tmp_path / "out" / "report.json").read_text()
    for text in ('"max_gap_points": 2.5', '"num_threads": 1', '"max_graph_memory_gb": 8'):
        assert text in report
    assert '"filter_regular_length": true' in report


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[EdgeGraph]\nmax_gap = 2", "unknown key EdgeGraph.max_gap; did you mean EdgeGraph.max"),
        ("num_thread = 2", "unknown key num_thread; did you mean num_threads"),
        ("[EdgeGraph]\nmax_gap_points = 'wide'", "max_gap_points is 'wide'; it must be a number"),
        ("[Detection]\nmin_chain_points = 12.5", "chain_points is 12.5; it must be an integer"),
        ("[Refinement]\nnoise_px = 0.2", "unknown key Refinement.noise_px"),
        ("[EdgeGraph\n", "cannot read"),
    ],
)
def test_config_mistakes_are_usage_errors(flags, tmp_path, text, message):
    config = tmp_path / "config.toml"
    config.write_text(text)
    assert message in call("detect", *flags, "--config", config, code=2)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--EdgeGraph.max_gap", "1"], "No such option"),
        (["--Refinement.noise_px", "1"], "No such option"),
        (
            ["--EdgeGraph.max_gap_points", "-1"],
            "--EdgeGraph.max_gap_points is -1.0; it must be from 0",
        ),
        (["--max_graph_memory_gb", "-1"], "Error: --max_graph_memory_gb is -1.0; it must be"),
        (["--random_seed", "1"], "No such option"),
        (["--EdgeGraph.filter_regular_length", "2"], "neither 0 nor 1"),
        (["--num_threads", "many"], "not a valid int"),
        (["--num_threads", "10000000"], "--num_threads is 10000000; it must be from -1 to 100000"),
        (["--Detection.gamma", "nan"], "--Detection.gamma is nan; it must be from 0.25 to 4"),
    ],
)
def test_usage_errors_exit_2(flags, tmp_path, args, message):
    assert message in call("detect", *flags, *args, code=2)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "flag",
    [
        *("--mesh_type", "--masks_are_background", "--use_faces", "--use_edges", "--refine_mesh"),
        *("--Meshing.method", "--max_faces"),
    ],
)
def test_flags_of_the_mesh_alone_are_no_flags_of_reconstruct(flags, tmp_path, flag):
    assert "No such option" in call("reconstruct", *flags, flag, "1", code=2)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (["--Tracing.num_rounds", "2147483647"], "it must be from 1 to 10"),
        (["--output_type", "PLY"], "'PLY' is not one of: BIN, TXT"),
        (["--masks_are_background", "1"], "there are no masks; give --mask_path"),
        (["--scheduler", "tcp://localhost:1"], "a --scheduler needs --cache_path"),
        (
            ["--export", "dxf,iges"],
            "--export is 'iges'; choose from: ply, obj, glb, dxf, step, svg, limap",
        ),
        (["--export", "glb,dxf", "--use_edges", "0"], "dxf holds edges and no mesh"),
    ],
)
def test_messages_spell_flags_as_help_does(flags, tmp_path, args, message):
    assert message in call("mesh", *flags, *args, code=2)
    assert not (tmp_path / "out").exists()


def test_one_config_serves_all_commands(quick, tmp_path):
    config = tmp_path / "config.toml"
    config.write_text(
        "quality = 'low'\nexport = 'DXF, glb'\nmesh_type = 'OBJ'\nuse_faces = false\n"
        "[Detection]\ngamma = 2\n[Meshing]\nmax_faces = 500\n"
    )
    call("detect", *quick, "--config", config)
    assert '"gamma": 2.0' in (tmp_path / "out" / "report.json").read_text()
    call("mesh", *quick, "--config", config, "--overwrite", "--report", "0")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["options"]["meshing"]["max_faces"] == 500
    exported = {"edges.dxf", "edges.glb", "mesh.obj", "mesh.glb"}
    assert exported <= set(report["files"]) and not {"edges.obj", "mesh.ply"} & set(report["files"])
    call("export", "--run_path", tmp_path / "out", "--output_path", tmp_path / "a.dxf")
    exported = (tmp_path / "a.dxf", tmp_path / "out" / "edges.dxf")
    assert exported[0].read_bytes() == exported[1].read_bytes()


def test_more_threads_than_can_be_used(quick, tmp_path):
    call("mesh", *quick, "--num_threads", 50000, "--report", 0)
    assert (tmp_path / "out" / "mesh.ply").stat().st_size > 10_000


def test_a_mesh_without_edges_needs_no_images(flags, tmp_path, scene_paths):
    call("mesh", *flags[2:], "--use_edges", 0)
    assert (tmp_path / "out" / "mesh.ply").stat().st_size > 1000
    shutil.copytree(scene_paths[1], tmp_path / "work" / "sparse" / "0")
    call("mesh", "--workspace_path", tmp_path / "work", "--use_edges", 0)
    assert (tmp_path / "work" / "edges" / "mesh.ply").is_file()
    assert "Missing --image_path;" in call("mesh", *flags[2:], code=2)


def test_empty_mesh_is_reported_with_its_cause(quick):
    output = call("mesh", *quick, "--Meshing.long_facet_factor", "1e-9", "--use_edges", 0)
    assert "Note: the mesh is empty" in output
    assert "To change that: raise --Meshing.long_facet_factor, or set it to 0" in output


def test_missing_flag_exits_2():
    assert "--image_path" in call("detect", code=2)


def test_bad_input_exits_1_in_one_line(flags, tmp_path):
    (tmp_path / "empty").mkdir()
    args = [*flags[:3], tmp_path / "empty", *flags[4:]]
    output = call("detect", *args, code=1)
    assert output.startswith("Error: no readable COLMAP model")
    assert output.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_existing_output_needs_overwrite(quick, tmp_path):
    call("detect", *quick)
    assert "--overwrite" in call("detect", *quick, code=1)
    call("detect", *quick, "--overwrite")


def test_info_of_a_model_and_of_an_output(undisturbed, tmp_path, scene_paths):
    assert "images: 10 with poses" in call("info", scene_paths[1])
    assert "Made by:  colmap-edges detect" in call("info", undisturbed)
    assert "no readable COLMAP model" in call("info", tmp_path, code=1)


def test_info_of_a_workspace(tmp_path, scene_paths):
    shutil.copytree(scene_paths[1], tmp_path / "sparse" / "0")
    output = call("info", tmp_path)
    assert output.startswith(f"{tmp_path / 'sparse' / '0'}:\n")
    assert "images: 10 with poses" in output


def test_closed_pipe_is_not_an_error(undisturbed):
    with start("info", undisturbed) as process:
        process.stdout.close()
        assert process.stderr.read() == ""
    assert process.returncode == 1


def test_full_disk_is_one_line_and_leaves_no_files(flags, tmp_path):
    done = call_forked(["detect", *flags], file_size=50_000)
    assert done.returncode == 1
    place = re.escape(str(tmp_path / "out" / "edge_graphs"))
    message = rf"Error: cannot write the edge graph to {place}/view_\d+.png.npz: File too large\n"
    assert re.fullmatch(message, done.stderr), done.stderr
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.1])
def test_next_run_after_a_kill_equals_an_undisturbed_one(
    flags, undisturbed, tmp_path, delay, hash_output
):
    process = Forked(COMMAND, "detect", *flags, "--num_threads", 1)
    deadline = time.monotonic() + 60
    while not any(tmp_path.glob(WORK)) and time.monotonic() < deadline:
        time.sleep(0.005)
    time.sleep(delay)
    process.kill()
    process.communicate()
    call("detect", *flags, "--overwrite")
    assert hash_output(tmp_path / "out") == hash_output(undisturbed)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_interruption_leaves_no_files(flags, tmp_path, number, code):
    process = Forked(COMMAND, "detect", *flags, "--num_threads", 1)
    deadline = time.monotonic() + 60
    while not any(tmp_path.glob(f"{WORK}/edge_graphs")) and time.monotonic() < deadline:
        time.sleep(0.005)
    os.kill(process.pid, number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == code
    assert "Traceback" not in errors
    assert not any(path.name.startswith((".out", "out")) for path in tmp_path.iterdir())


def test_help_fits_on_two_screens_and_full_help_has_all():
    wide = {**os.environ, "COLUMNS": "100"}
    for command in ("mesh", "reconstruct", "detect"):
        output, _ = start(command, "--help", env=wide).communicate(timeout=60)
        assert len(output.splitlines()) <= 100
        assert "--output_path" in output
    full = call("mesh", "--help_full")
    for entry in fields(PipelineOptions):
        assert entry.name in full or entry.default_factory is not None
    assert "--Tracing.max_false_edges" in full
    assert "--Tracing.max_false_edges" not in output
    assert "noise_px" not in full
    for command in (["info"], ["evaluate"], []):
        assert "--help_full" in call(*command, "--help_full")


def test_help_comes_at_once():
    start("--help").communicate()  # compiles what was not yet
    started = sum(os.times()[2:4])  # of children; other programs may be at work, too
    assert "reconstruct" in start("--help").communicate()[0]
    assert 0 < sum(os.times()[2:4]) - started < 0.5


@pytest.mark.parametrize("model", ["sparse/0", "sparse", "sparse/1"])
def test_workspace_gives_the_paths(small, tmp_path, model):
    shutil.copytree(small[0], tmp_path / "images")
    shutil.copytree(small[1], tmp_path / model)
    call("detect", "--workspace_path", tmp_path)
    assert len(list((tmp_path / "edges" / "overlays").iterdir())) == 6  # one of each image
    call("detect", "--workspace_path", tmp_path, "--output_path", tmp_path / "elsewhere")
    assert (tmp_path / "elsewhere" / "report.json").is_file()


@pytest.mark.parametrize(
    ("folder", "message"), [("images", "no model in"), ("x", "no folder images")]
)
def test_invalid_workspace_is_an_error(tmp_path, folder, message):
    (tmp_path / folder).mkdir()
    output = call("detect", "--workspace_path", tmp_path, code=1)
    assert message in output
    assert output.count("\n") == 1


def test_method_paper_sets_the_papers_options(quick, tmp_path):
    call("mesh", *quick, "--method", "PAPER", "--Meshing.vote_threshold", "2", "--report", "0")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    expected = asdict(preset("paper"))
    expected["meshing"]["vote_threshold"] = 2
    expected["report"] = False
    assert report["options"] == expected
    assert "pepcs" in next(s for s in report["stages"] if s["name"] == "trace")["counts"]["details"]
    output = call("mesh", *quick, "--method", "paper", "--quality", "low", "--overwrite", code=2)
    assert "has no effect with --method paper; leave it out" in output


def test_flags_go_before_the_preset(quick, tmp_path):
    call("reconstruct", *quick, "--quality", "LOW", "--ChainDepth.sample_step_points", "9")
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    expected = asdict(preset("low"))
    expected["chain_depth"]["sample_step_points"] = 9
    assert report["options"] == expected
    later = report["settings"].pop("later_rounds")
    assert later["tracing"] == {"min_agreeing_views": 1}
    assert report["settings"] == expected  # the preset upsamples nothing
