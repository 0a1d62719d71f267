"""Recordings for rerun: their contents, and errors when none can be made."""

import os
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

from colmap_edges.cli.main import main
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run
from colmap_edges.report import rerun_viewer as viewer
from colmap_edges.report.rerun_viewer import (
    check_recording_path,
    colors_of,
    open_viewer,
    up_axis,
)
from colmap_edges.surfaces.faces.outlines import Face

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

NO_OUTPUT = viewer.Path("nowhere")


@pytest.fixture(scope="module")
def rerun():
    return pytest.importorskip("rerun")


def read_recording(rerun, path):
    """The columns of a recording: by entity path, then by name, the values of every row."""
    found = {}
    for part in rerun.chunk.RrdReader(str(path)).stream():
        batch = part.to_record_batch()
        columns = found.setdefault(part.entity_path, {})
        for name in {*batch.schema.names} - {"log_time", "rerun.controls.RowId"}:
            columns.setdefault(name, []).extend(batch.column(name).to_pylist())
    return found


@pytest.fixture(scope="module")
def meshed(rerun, scene_paths, tmp_path_factory):
    """The recording of a run of mesh, and its report."""
    folder = tmp_path_factory.mktemp("viewer")
    paths = Paths(image_path=scene_paths[0], input_path=scene_paths[1], output_path=folder / "out")
    target = folder / "run.rrd"
    with open_viewer(str(target), paths.output_path, False) as shown:
        report = run("mesh", paths, PipelineOptions(report=False), viewer=shown)
    assert [path.name for path in folder.glob("*.rrd")] == ["run.rrd"]
    return read_recording(rerun, target), report


def test_recording_contains_the_results_of_the_run(meshed, scene_model):
    entities, report = meshed
    counts = {stage["name"]: stage["counts"] for stage in report["stages"]}
    assert len(entities["/points"]["Points3D:positions"][0]) == counts["read"]["points3D"]
    assert len(entities["/edges"]["LineStrips3D:strips"][0]) == counts["trace"]["edges"]
    assert len(entities["/mesh"]["Mesh3D:triangle_indices"][0]) == counts["mesh"]["faces"]
    for view in scene_model.views:
        assert entities[camera_path(view)]["EncodedImage:blob"][0] is not None


def test_faces_are_translucent_polygons_with_outlines(rerun, tmp_path):
    square = np.array([[0, 0, 2], [1, 0, 2], [1, 1, 2], [0, 1, 2]], float)
    face = Face(
        normal=np.array([0.0, 0, -1]),
        offset=-2.0,
        area=1.0,
        outline=square,
        holes=(),
        views=np.arange(2),
        plane=0,
    )
    with open_viewer(str(tmp_path / "run.rrd"), NO_OUTPUT, False) as shown:
        shown.show_faces([face])
    entities = read_recording(rerun, tmp_path / "run.rrd")
    mesh = entities["/faces"]
    assert len(mesh["Mesh3D:triangle_indices"][0]) == 2
    assert {color & 255 for color in mesh["Mesh3D:vertex_colors"][0]} == {128}
    (strip,) = entities["/faces/outlines"]["LineStrips3D:strips"][0]
    np.testing.assert_allclose(strip, [*square, square[0]])


def camera_path(view):
    return "/cameras/" + view.name.replace("/", "\\/")


def test_edges_are_labelled_with_their_views(meshed, scene_model):
    labels = meshed[0]["/edges"]["LineStrips3D:labels"][0]
    views = [int(label.split()[-2]) for label in labels]
    assert 3 <= min(views) <= max(views) <= len(scene_model.views)
    colors = meshed[0]["/edges"]["LineStrips3D:colors"][0]
    assert len({color for color, n in zip(colors, views, strict=True) if n == views[0]}) == 1


def test_recorded_cameras_agree_with_the_model(meshed, scene_model):
    points = scene_model.points3D_xyz[:20]
    for view in scene_model.views:
        columns = meshed[0][camera_path(view)]
        pose = [flat(columns[f"Transform3D:{name}"]) for name in ("mat3x3", "translation")]
        matrix = flat(columns["Pinhole:image_from_camera"]).reshape(3, 3).T  # column-major
        local = (points - pose[1]) @ pose[0].reshape(3, 3, order="F")
        pixels = local @ matrix.T
        expected, _ = view.project(points)
        scale = flat(columns["Pinhole:resolution"])[0] / view.width
        np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], scale * expected, atol=0.01)


def flat(rows):
    """The numbers of the last row, which holds for all times."""
    row = [row for row in rows if row is not None][-1]
    while isinstance(row[0], list):
        row = list(chain.from_iterable(row))
    return np.array(row, float)


@pytest.fixture
def receiver(rerun, tmp_path, monkeypatch):
    """The process of a viewer that saves what it is shown, at `tmp_path`/received.rrd."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    monkeypatch.setattr(viewer, "PORT", port)
    target = tmp_path / "received.rrd"
    command = [sys.executable, "-m", "rerun", "--save", str(target), "--port", str(port)]
    output = subprocess.DEVNULL
    process = subprocess.Popen(command, stdout=output, stderr=output, start_new_session=True)
    try:
        wait_until(lambda: viewer.is_listening(port))
        yield process
    finally:
        end(process)


def end(process):
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)  # it has started a process of its own
        process.wait()


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_viewer_that_listens_is_shown_the_run(rerun, receiver, scene_model, tmp_path):
    with open_viewer("1", NO_OUTPUT, False) as shown:
        shown.show_model(scene_model)
    wait_until(lambda: "/points" in paths_so_far(rerun, tmp_path / "received.rrd"))


def test_closing_the_viewer_ends_no_run(receiver, scene_model, caplog):
    with open_viewer("1", NO_OUTPUT, False) as shown:
        shown.show_model(scene_model)
        end(receiver)
        wait_until(lambda: not viewer.is_listening(viewer.PORT))
        shown.show_model(scene_model)
    assert "the rerun viewer did not receive all data" in caplog.text


def paths_so_far(rerun, path):
    try:
        return set(read_recording(rerun, path))
    except (OSError, ValueError, RuntimeError):
        return set()


def wait_until(holds, seconds=60):
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.1)


@pytest.mark.parametrize("target", ["1", "run.rrd"])
@pytest.mark.parametrize("module", [None, pytest])
def test_without_rerun_the_remedy_is_named(target, module, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "rerun", module)
    message = r"rerun-sdk, which is not installed; run: pip install 'colmap-edges\[rerun\]'"
    with pytest.raises(ColmapEdgesError, match=message), open_viewer(target, NO_OUTPUT, False):
        pass


def test_without_display_the_recording_is_named(rerun, monkeypatch):
    monkeypatch.setattr(viewer, "is_listening", lambda port: False)
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with (
        pytest.raises(ColmapEdgesError, match=r"--rerun FILE\.rrd"),
        open_viewer("1", NO_OUTPUT, 0),
    ):
        pass


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("run.rrd", "exists already; choose another path or add --overwrite"),
        ("missing/run.rrd", "is not a folder; create it"),
        ("out/run.rrd", "is inside output_path"),
        ("folder.rrd", "it is a folder, not a file"),
    ],
)
def test_recording_that_cannot_be_made(target, message, tmp_path):
    for folder in ("out", "folder.rrd"):
        (tmp_path / folder).mkdir()
    (tmp_path / "run.rrd").write_text("earlier")
    with (
        pytest.raises(ColmapEdgesError, match=message),
        open_viewer(str(tmp_path / target), tmp_path / "out", False),
    ):
        pass
    assert (tmp_path / "run.rrd").read_text() == "earlier"


def test_failed_run_keeps_the_earlier_recording(rerun, tmp_path):
    target = tmp_path / "run.rrd"
    target.write_text("RRF2 earlier")
    with pytest.raises(ColmapEdgesError), open_viewer(str(target), tmp_path / "out", True):
        raise ColmapEdgesError("failed")
    assert target.read_text() == "RRF2 earlier"
    with open_viewer(str(target), tmp_path / "out", True):
        pass
    assert target.read_bytes()[:3] == b"RRF"
    assert [path.name for path in tmp_path.iterdir()] == ["run.rrd"]


def test_anything_else_is_a_usage_error(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["mesh", "--rerun", "film.mp4"])
    assert ended.value.code == 2
    assert "is neither 0, 1 nor a FILE.rrd" in capsys.readouterr().err


def test_closed_edges_end_where_they_begin(scene_edges):
    edges = replace(scene_edges, closed=np.arange(scene_edges.num_edges) % 2 == 0)
    for line, closed, count in zip(
        edges.polylines(), edges.closed, np.diff(edges.edge_offsets), strict=True
    ):
        assert len(line) == count + closed
        assert (line[0] == line[-1]).all() == closed


def test_more_views_are_brighter():
    colors = colors_of(np.array([3, 4, 9, 3])).sum(axis=1)
    assert colors[0] == colors[3] < colors[1] < colors[2]
    assert colors_of(np.zeros(0, np.int64)).shape == (0, 3)
    assert len(np.unique(colors_of(np.full(3, 7)), axis=0)) == 1


@pytest.mark.parametrize(
    ("up", "name"), [((0, -1, 0.2), "RIGHT_HAND_Y_DOWN"), ((0.1, 0, 1), "RIGHT_HAND_Z_UP")]
)
def test_up_axis_is_the_nearest(up, name, scene_model, monkeypatch):
    monkeypatch.setattr(viewer, "up_direction", lambda model: np.array(up))
    assert up_axis(scene_model) == name


@pytest.mark.parametrize(("content", "replaced"), [(b"RRF2 earlier", True), (b"mine", False)])
def test_only_recordings_are_replaced(tmp_path, content, replaced):
    path = tmp_path / "run.rrd"
    path.write_bytes(content)
    if replaced:
        check_recording_path(path, tmp_path / "out", True, [])
        return
    with pytest.raises(ColmapEdgesError, match="not a recording of rerun, so it is not replaced"):
        check_recording_path(path, tmp_path / "out", True, [])
