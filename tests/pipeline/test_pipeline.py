import json
import os
import shutil
import subprocess
import sys
from dataclasses import fields, replace
from pathlib import Path

import cv2
import dense_clouds
import numpy as np
import pycolmap
import pytest
import scenes
from scipy.spatial import cKDTree

import colmap_edges
from colmap_edges.cli.info import describe
from colmap_edges.colmap.clouds import image_names
from colmap_edges.colmap.model import load_model
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.declared_options import derived
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.options import PipelineOptions, TracingOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run
from colmap_edges.pipeline.write import write_stage
from colmap_edges.report.overlay import draw_edges
from colmap_edges.runtime.executors import thread_count
from colmap_edges.runtime.output import check_output_path, new_folder
from colmap_edges.runtime.ownership import file_sizes
from colmap_edges.runtime.stages import Stages
from colmap_edges.surfaces.patches.finding import NO_PATCHES

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

WITHOUT_FACES = PipelineOptions(use_faces=False, num_threads=2)


def paths_of(scene_paths, output, cache=None):
    images, model = scene_paths
    return Paths(image_path=images, input_path=model, output_path=output, cache_path=cache)


def copy_scene(scene_paths, folder):
    for source, name in zip(scene_paths, ("images", "sparse"), strict=True):
        shutil.copytree(source, folder / name)
    return folder / "images", folder / "sparse"


def detect(scene_paths, output, **options):
    return run("detect", paths_of(scene_paths, output), PipelineOptions(**options))


@pytest.fixture(scope="module")
def detected(scene_paths, tmp_path_factory):
    """Output of `detect` on one thread, and its report."""
    output = tmp_path_factory.mktemp("detected") / "out"
    return output, detect(scene_paths, output, num_threads=1)


def test_detect_writes_a_graph_and_a_picture_an_image(scene, detected):
    output, report = detected
    for name, image in scene.images.items():
        graph = np.load(output / "edge_graphs" / f"{name}.npz")
        assert len(graph["points"]) == graph["polyline_offsets"][-1] > 500
        picture = cv2.imread(str(output / "overlays" / f"{name}.png"))
        assert picture.shape[:2] == image.shape
    stages = report["stages"]
    assert stages[1]["counts"]["images"] == len(scene.images)
    assert json.loads((output / "report.json").read_text())["stages"] == stages
    assert [stage["name"] for stage in stages] == ["read", "detect"]
    assert all(stage["wall_s"] > 0 and stage["peak_mb"] > 20 for stage in stages)


def test_detect_is_the_same_on_any_number_of_threads(scene_paths, detected, tmp_path, hash_folder):
    """And the input is left as it was."""
    before = [hash_folder(path) for path in scene_paths]
    detect(scene_paths, tmp_path / "out", num_threads=3)
    assert [hash_folder(path) for path in scene_paths] == before
    for name in ("edge_graphs", "overlays"):
        assert hash_folder(tmp_path / "out" / name) == hash_folder(detected[0] / name)


def damage(kind, images, sparse):
    first = sorted(images.iterdir())[0]
    if kind == "missing image":
        first.unlink()
    elif kind == "unreadable images":
        for path in sorted(images.iterdir())[:-1]:
            path.write_bytes(b"no picture")
    elif kind == "image of another size":
        cv2.imwrite(str(first), np.zeros((50, 70, 3), np.uint8))
    elif kind == "truncated model":
        data = (sparse / "points3D.bin").read_bytes()
        (sparse / "points3D.bin").write_bytes(data[: len(data) // 2])
    elif kind == "no model":
        shutil.rmtree(sparse)
        sparse.mkdir()
    elif kind == "model without images":
        for name in ("images", "frames", "points3D"):
            (sparse / f"{name}.bin").write_bytes(bytes(8))


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("missing image", "view_001.png of the model is not in"),
        ("unreadable images", "cannot read image .*view_001.png.*9 of 10 images"),
        ("image of another size", "view_001.png is 70x50, its camera 480x360"),
        ("truncated model", "points3D.bin is damaged"),
        ("no model", "no readable COLMAP model"),
        ("model without images", "0 images with poses"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(scene_paths, tmp_path, kind, message):
    inputs = copy_scene(scene_paths, tmp_path)
    damage(kind, *inputs)
    with pytest.raises(ColmapEdgesError, match=message) as caught:
        detect(inputs, tmp_path / "out")
    assert "\n" not in str(caught.value)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["images", "sparse"]


def test_damaged_images_are_left_out_and_named(scene_paths, tmp_path, caplog):
    images, sparse = copy_scene(scene_paths, tmp_path)
    (images / "view_003.png").write_bytes(b"no picture")
    (images / "view_007.png").write_bytes(b"")
    options = replace(scenes.EDGES_ALONE, report=False)
    report = run("reconstruct", paths_of((images, sparse), tmp_path / "out"), options)
    assert report["stages"][1]["counts"]["damaged"] == ["view_003.png", "view_007.png"]
    assert "view_003.png, view_007.png" in report["findings"][0]["text"]
    assert [record.levelname for record in caplog.records] == ["WARNING", "WARNING"]
    records = json.loads((tmp_path / "out" / "edges.json").read_text())["edges"]
    seen = {image_id for record in records for image_id in record["image_ids"]}
    assert {1, 2, 4, 5} <= seen and not {3, 7} & seen


@pytest.mark.parametrize("relation", [".", "below/out", ".."])
@pytest.mark.parametrize("name", ["images", "sparse"])
def test_output_on_an_input_is_refused(scene_paths, tmp_path, relation, name, hash_folder):
    copy_scene(scene_paths, tmp_path / "work")
    (tmp_path / "work" / name / "below").mkdir()
    before = hash_folder(tmp_path)
    inputs = tmp_path / "work" / "images", tmp_path / "work" / "sparse"
    with pytest.raises(ColmapEdgesError, match="choose another folder"):
        run(
            "detect",
            paths_of(inputs, tmp_path / "work" / name / relation),
            PipelineOptions(),
            overwrite=True,
        )
    assert hash_folder(tmp_path) == before


def test_output_cannot_be_made(scene_paths, tmp_path):
    (tmp_path / "file").write_text("x")
    with pytest.raises(ColmapEdgesError, match="is not a folder"):
        detect(scene_paths, tmp_path / "missing" / "out")
    with pytest.raises(ColmapEdgesError, match="a file of that name"):
        detect(scene_paths, tmp_path / "file")


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="needs Linux's /proc")
def test_unwritable_parent(scene_paths):
    with pytest.raises(ColmapEdgesError, match="cannot write to /proc/"):
        detect(scene_paths, Path("/proc/edges"))


def test_foreign_folder_is_never_overwritten(tmp_path):
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "precious.jpg").write_text("x")
    with pytest.raises(ColmapEdgesError, match="not an output of colmap-edges"):
        check_output_path(tmp_path / "photos", [], overwrite=True)
    with pytest.raises(ColmapEdgesError, match="--overwrite"):
        check_output_path(tmp_path / "photos", [], overwrite=False)
    (tmp_path / "empty").mkdir()
    check_output_path(tmp_path / "empty", [], overwrite=False)


def write_output(folder, name, text):
    """Write an output of one file, and its report."""
    (folder / name).write_text(text)
    report = {"versions": {"colmap-edges": "0.1.0"}, "files": file_sizes(folder)}
    (folder / "report.json").write_text(json.dumps(report))


def test_earlier_output_stays_until_the_new_one_is_complete(tmp_path):
    output = tmp_path / "out"
    with new_folder(output) as folder:
        write_output(folder, "a", "first")
    with pytest.raises(RuntimeError), new_folder(output, overwrite=True) as folder:
        (folder / "a").write_text("second")
        raise RuntimeError
    assert (output / "a").read_text() == "first"
    with new_folder(output, overwrite=True) as folder:
        write_output(folder, "b", "third")
    assert sorted(p.name for p in output.iterdir()) == ["b", "report.json"]
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_second_run_into_one_output_is_refused(tmp_path):
    output = tmp_path / "out"
    with new_folder(output) as folder:
        (folder / "a").write_text("mine")
        with pytest.raises(ColmapEdgesError, match="another run"), new_folder(output):
            pass
        assert (folder / "a").read_text() == "mine"
    assert (output / "a").read_text() == "mine"


def test_leftovers_of_a_killed_run_are_cleaned(tmp_path):
    output = tmp_path / "out"
    script = (
        "import sys, time; from pathlib import Path\n"
        "from colmap_edges.runtime.output import new_folder\n"
        "with new_folder(Path(sys.argv[1])) as folder:\n"
        "    (folder / 'half').mkdir(); (folder / 'half' / 'a').write_text('x')\n"
        "    print('ready', flush=True); time.sleep(60)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script, str(output)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "ready\n"
    process.kill()
    process.communicate()
    assert not output.exists()
    with new_folder(output) as folder:
        assert not any(folder.iterdir())
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_output_moved_aside_by_a_killed_run_comes_back(tmp_path):
    output = tmp_path / "out"
    with new_folder(output) as folder:
        write_output(folder, "a", "old")
    script = (
        "import os, sys; from pathlib import Path\n"
        "from colmap_edges.runtime.output import new_folder\n"
        "rename = Path.rename\n"
        "def rename_once(path, target):\n"
        "    rename(path, target); os._exit(9)\n"
        "Path.rename = rename_once\n"
        "with new_folder(Path(sys.argv[1]), overwrite=True) as folder:\n"
        "    (folder / 'a').write_text('new')\n"
    )
    killed = subprocess.run([sys.executable, "-c", script, str(output)], timeout=60)
    assert killed.returncode == 9
    assert not output.exists()
    # It is back before the next run asks whether it may be replaced.
    with pytest.raises(ColmapEdgesError, match="--overwrite"), new_folder(output):
        pass
    assert (output / "a").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["out"]


def test_edges_are_drawn_where_they_are_seen(scene, scene_model):
    edges = scenes.true_edges(scene_model, scene, spacing=0.1)
    view = scene_model.views[3]
    image = np.zeros((view.height, view.width, 3), np.uint8)
    picture = draw_edges(image, 3, scene_model, edges)
    rows, columns = np.nonzero(picture.max(axis=2) > 100)
    projected = np.concatenate([view.project(scenes.resample(c, 0.005))[0] for c in scene.curves])
    drawn = np.column_stack([columns, rows]) + 0.5
    assert len(drawn) > 300
    assert cKDTree(projected).query(drawn)[0].max() < 2.5


@pytest.mark.parametrize("output_type", ["BIN", "TXT"])
def test_write_stage_writes_model_and_edges(scene_model, scene_edges, tmp_path, output_type):
    stages = Stages()
    options = PipelineOptions(output_type=output_type)
    extended = write_stage(
        scene_model, scene_edges, fit_curves(scene_edges), tmp_path, options, stages
    )
    suffix = output_type.lower()
    assert (tmp_path / "sparse" / f"points3D.{suffix}").is_file()
    written = load_model(tmp_path / "sparse")
    np.testing.assert_array_equal(written.point3D_ids, extended.point3D_ids)
    np.testing.assert_allclose(written.points3D_xyz, extended.points3D_xyz, rtol=1e-14)
    np.testing.assert_array_equal(written.points3D_rgb, extended.points3D_rgb)
    np.testing.assert_array_equal(written.track_offsets, extended.track_offsets)
    records = json.loads((tmp_path / "edges.json").read_text())["edges"]
    ids = [i for record in records for i in record["point3D_ids"]]
    found = written.points3D_xyz[np.searchsorted(written.point3D_ids, ids)]
    np.testing.assert_allclose(found, scene_edges.points, rtol=1e-14)
    assert stages.records()[0]["counts"]["edge_points"] == scene_edges.num_points


@pytest.mark.parametrize("output_type", ["BIN", "TXT"])
def test_patches_are_written_after_the_edges(scene_model, scene_edges, tmp_path, output_type):
    xyz = scene_edges.points[:4] + 0.01
    seen = SeenPoints(xyz, np.arange(0, 9, 2), np.tile(np.array([1, 3], np.int32), 4))
    grays = np.array([10, 20, 30, 40], np.uint8)
    patches = replace(NO_PATCHES, points=seen, grays=grays)
    options = PipelineOptions(output_type=output_type, write_patches=True)
    given = (scene_model, scene_edges, fit_curves(scene_edges), tmp_path, options, Stages())
    extended = write_stage(*given, patches)
    written = load_model(tmp_path / "sparse")
    np.testing.assert_allclose(written.points3D_xyz[-4:], xyz, rtol=1e-14)
    np.testing.assert_array_equal(written.points3D_rgb[-4:, 1], grays)
    assert written.point3D_ids[-4] == extended.point3D_ids.max() + 1
    np.testing.assert_array_equal(written.track_views[-8:], seen.track_views)
    pixels = scene_model.views[1].project(xyz)[0]
    np.testing.assert_allclose(written.track_points2D[-8::2], pixels, atol=1e-9)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """What the runs on the scene have in common: of each, what its options change is done."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def meshed(scene_paths, cache, tmp_path_factory):
    """Output of `mesh` on the scene, and its report."""
    output = tmp_path_factory.mktemp("mesh") / "out"
    return output, run("mesh", paths_of(scene_paths, output, cache), PipelineOptions(num_threads=1))


def test_mesh_writes_every_file(meshed, scene_model):
    output, report = meshed
    names = {"edges.json", "edges.ply", "faces.json", "mesh.ply", "sparse"}
    names |= {"report.html", "report.json"}
    assert {path.name for path in output.iterdir()} == names
    stages = ["read", "detect", "trace", "curves", "background", "round_faces"]
    stages += ["faces", "patches", "write", "mesh", "report"]
    assert [stage["name"] for stage in report["stages"]] == stages
    edge_points = report["stages"][stages.index("write")]["counts"]["edge_points"]
    written = load_model(output / "sparse")
    assert len(written.point3D_ids) == len(scene_model.point3D_ids) + edge_points


def test_edges_lie_on_the_true_curves_and_cover_them(meshed, scene, scene_model):
    written = load_model(meshed[0] / "sparse")
    points = written.points3D_xyz[len(scene_model.point3D_ids) :]
    # At 4 units' distance a pixel is 0.0076 units.
    assert np.mean(scene.distances(points) < 0.015) > 0.95
    well_seen = scene.samples[scene.sample_views >= 5]
    assert np.mean(cKDTree(points).query(well_seen)[0] < 0.04) > 0.8


def test_mesh_is_the_same_on_any_number_of_threads(meshed, scene_paths, tmp_path, hash_folder):
    """And tracing advances with every view."""
    steps = []
    paths, options = paths_of(scene_paths, tmp_path / "out"), PipelineOptions(num_threads=3)
    run("mesh", paths, options, progress=lambda *step: steps.append(step))
    traced = [step[1:] for step in steps if step[0] == "trace"]
    assert traced == [(done, 40) for done in [*range(41), 40]]  # two rounds of twice ten views
    digests = [hash_folder(output) for output in (meshed[0], tmp_path / "out")]
    for name in ("report.json", "report.html"):  # they hold times
        assert all(digest.pop(name) for digest in digests)
    assert digests[0] == digests[1]


def test_baseline_meshes_the_sfm_points_alone(scene_paths, tmp_path):
    options = PipelineOptions(use_edges=False, report=False)
    report = run("mesh", paths_of(scene_paths, tmp_path / "out"), options)
    assert [stage["name"] for stage in report["stages"]] == ["read", "mesh"]
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["mesh.ply", "report.json"]


def test_faces_are_meshed_and_written_unless_turned_off(scene_paths, meshed, cache, tmp_path):
    output, report = meshed
    counts = {stage["name"]: stage["counts"] for stage in report["stages"]}
    faces = counts["faces"]
    assert 0 < faces["planar_faces"] < faces["cells_believed"] <= faces["cells_on_planes"]
    assert [step["count"] for step in report["funnel"][-4:]] == [
        *(faces[f"cells{rest}"] for rest in ("", "_on_planes", "_believed")),
        faces["planar_faces"],
    ]
    listed = json.loads((output / "faces.json").read_text())["faces"]
    assert len(listed) == faces["planar_faces"]
    assert sum(face["area"] for face in listed) == pytest.approx(faces["area"])
    page = (output / "report.html").read_text(encoding="utf-8")
    assert f"{len(listed)} planar faces and a mesh of" in page
    assert f"planar faces: {len(listed)}" in "\n".join(describe(output, verbose=True))
    without = run("mesh", paths_of(scene_paths, tmp_path / "out", cache), WITHOUT_FACES)
    assert "faces" not in [stage["name"] for stage in without["stages"]]
    assert not (tmp_path / "out" / "faces.json").exists()


@pytest.fixture(scope="module")
def result(scene, scene_paths):
    """What Python's `reconstruct` returns for the scene."""
    return colmap_edges.reconstruct(scene.reconstruction, scene_paths[0])


def test_faces_in_python_are_those_of_a_run(scene_paths, meshed, result, tmp_path):
    output = meshed[0]
    read = colmap_edges.read_edges(output)
    assert len(result.faces.faces) == len(read.faces) > 0
    for face, again in zip(result.faces.faces, read.faces, strict=True):
        for field in fields(face):
            one, other = getattr(face, field.name), getattr(again, field.name)
            rings = field.name == "holes"
            assert all(map(np.array_equal, one, other)) if rings else np.array_equal(one, other)
    found = {name: getattr(result, name) for name in ("contours", "background", "patches")}
    given = colmap_edges.mesh(scene_paths[1], result.edges, faces=result.faces, **found)
    assert len(given.faces) == meshed[1]["stages"][-2]["counts"]["faces"]
    without = colmap_edges.mesh(scene_paths[1], result.edges, **found)
    of_faces = len(result.faces.points.points)
    assert of_faces > 0
    assert len(given.vertices) > len(without.vertices) + 0.5 * of_faces
    shutil.copytree(output, tmp_path / "out")
    listed = json.loads((output / "faces.json").read_text())
    listed["faces"][0]["image_ids"].append(999)
    (tmp_path / "out" / "faces.json").write_text(json.dumps(listed))
    with pytest.raises(ColmapEdgesError, match=r"faces\.json holds no faces of its model: 999"):
        colmap_edges.read_edges(tmp_path / "out")


def test_reconstruct_takes_and_returns_pycolmap_objects(meshed, scene, scene_model, result):
    count = len(scene_model.point3D_ids)
    assert scene.reconstruction.num_points3D() == count
    assert result.reconstruction.num_points3D() == count + len(set(result.point3D_ids.tolist()))
    written = load_model(meshed[0] / "sparse")
    distinct, places = result.edges.distinct()
    np.testing.assert_allclose(written.points3D_xyz[count:], distinct.points, rtol=1e-14)
    np.testing.assert_array_equal(distinct.points[places], result.edges.points)
    assert np.median(result.residuals_px) < 0.5
    names = ["read", "detect", "trace", "curves", "background", "round_faces"]
    names += ["faces", "patches"]
    assert [stage["name"] for stage in result.stages] == names
    assert result.curves.num_curves >= result.edges.num_edges
    mesh = colmap_edges.mesh(scene.reconstruction, result.edges)
    with_edge_points = colmap_edges.mesh(result.reconstruction)
    assert len(mesh.vertices) >= 0.8 * len(with_edge_points.vertices) > 0


def test_every_public_name_can_be_imported():
    for name in colmap_edges.__all__:
        assert getattr(colmap_edges, name)
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = colmap_edges.no_such_name


@pytest.mark.parametrize("method", ["chains", "paper"])
def test_colors_are_nearly_colmaps_own(scene, scene_paths, result, method):
    # Ours are interpolated along chains between colours of 8 bits.
    if method == "paper":  # which has no faint edges
        options = PipelineOptions(tracing=TracingOptions(method=method), use_faces=False)
        options = replace(options, detection=derived(options.detection, faint_noises=0.0))
        result = colmap_edges.reconstruct(scene.reconstruction, scene_paths[0], options)
    extended = pycolmap.Reconstruction(result.reconstruction)
    ours = np.array([extended.points3D[i].color for i in result.point3D_ids])
    np.testing.assert_array_equal(ours, result.edges.colors)
    extended.extract_colors_for_all_images(str(scene_paths[0]))
    theirs = np.array([extended.points3D[i].color for i in result.point3D_ids])
    apart = np.abs(ours.astype(int) - theirs).max(axis=1)
    assert np.median(apart) == 0
    assert (np.percentile(apart, [90, 99]) <= [2, 5]).all()


def test_threads_default_to_the_allowed_cores():
    cores = len(os.sched_getaffinity(0))
    assert thread_count(PipelineOptions(num_threads=3)) == 3
    assert thread_count(PipelineOptions()) == cores
    assert thread_count(PipelineOptions(num_threads=50_000)) == 4 * cores


def test_report_holds_nothing_but_json():
    stages = Stages()
    with stages.stage("read") as stage:
        stage.counts = {
            "whole": np.float64(3),
            "broken": np.array([0.5, np.nan, np.inf]),
            "inner": {"none": float("-inf"), "word": "nan", "pair": (1, np.int64(2))},
        }
    (record,) = stages.records()
    assert record["counts"] == {
        "whole": 3,
        "broken": [0.5, None, None],
        "inner": {"none": None, "word": "nan", "pair": [1, 2]},
    }
    json.dumps(record, allow_nan=False)


def test_without_edges_before_a_backdrop_the_points_are_meshed(small, tmp_path):
    options = PipelineOptions(report=False, tracing=TracingOptions(min_observations=100))
    report = run("mesh", paths_of(small, tmp_path / "out"), options)
    found = {stage["name"]: stage["counts"] for stage in report["stages"]}
    assert found["trace"]["edges"] == 0
    assert found["mesh"]["faces"] > 100
    assert any("--Tracing.min_observations" in finding["remedy"] for finding in report["findings"])


def test_meshing_works_when_threads_cannot_be_started():
    """Of thousands of threads a few get their stack in the memory that there is."""
    script = (
        "import resource, numpy as np\n"
        "from colmap_edges.surfaces.mesher import mesh_points\n"
        "from colmap_edges.options import MeshingOptions\n"
        "points = np.random.default_rng(0).normal(size=(3000, 3))\n"
        "rays = np.arange(3001), np.zeros(3000, np.int32), np.full((1, 3), 9.0)\n"
        "few = mesh_points(points, *rays, MeshingOptions(), num_threads=1)\n"
        "used = int(open('/proc/self/statm').read().split()[0]) * resource.getpagesize()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (used + 400_000_000,) * 2)\n"
        "many = mesh_points(points, *rays, MeshingOptions(), num_threads=5000)\n"
        "print(np.array_equal(few.faces, many.faces), len(few.faces) > 100)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stdout == "True True\n", done.stderr


@pytest.fixture(scope="module")
def dense_paths(scene_paths, scene_model, tmp_path_factory):
    """A dense workspace of the scene, with a cloud on its solids."""
    folder = tmp_path_factory.mktemp("dense")
    points, _, tracks = dense_clouds.on_solids(scene_model)
    order = {name: at for at, name in enumerate(image_names(scene_model.reconstruction))}
    numbers = [order[view.name] for view in scene_model.views]
    (folder / "fused.ply").write_bytes(dense_clouds.fused_ply(points))
    named = [[numbers[view] for view in track] for track in tracks]
    (folder / "fused.ply.vis").write_bytes(dense_clouds.fused_vis(named))
    (folder / "sparse").mkdir()
    scene_model.reconstruction.write(str(folder / "sparse"))
    return folder


def test_dense_workspaces_are_meshed_alone_and_with_edges(
    scene_paths, dense_paths, cache, tmp_path
):
    paths = replace(paths_of(scene_paths, tmp_path / "alone"), dense_path=dense_paths)
    options = PipelineOptions(use_edges=False, report=False)
    found = {stage["name"]: stage["counts"] for stage in run("mesh", paths, options)["stages"]}
    assert list(found) == ["read", "dense", "mesh"]
    assert found["dense"]["points_kept"] > 1000
    assert found["mesh"]["faces"] > 1000
    with_edges = replace(paths, output_path=tmp_path / "sharp", cache_path=cache)
    sharp = run("mesh", with_edges, PipelineOptions())
    assert [stage["name"] for stage in sharp["stages"]][:3] == ["read", "dense", "detect"]
    given = replace(paths_of(scene_paths, tmp_path / "given"), points=dense_paths / "fused.ply")
    given = replace(given, visibility=dense_paths / "fused.ply.vis")
    run("mesh", given, options)
    meshes = [(tmp_path / name / "mesh.ply").read_bytes() for name in ("alone", "given")]
    assert meshes[0] == meshes[1]


def test_paths_of_clouds_that_do_not_fit_are_refused(scene_paths, dense_paths, tmp_path):
    paths = paths_of(scene_paths, tmp_path / "out")
    cloud, none = dense_paths / "fused.ply", tmp_path / "none.ply"
    for wrong, message in (
        ({"points": none}, "is not a file"),
        ({"visibility": cloud}, "visibility is given without points"),
        ({"dense_path": dense_paths, "points": cloud}, "give one of them"),
        ({"dense_path": scene_paths[0]}, r"has no fused\.ply"),
    ):
        with pytest.raises(ColmapEdgesError, match=message):
            run("mesh", replace(paths, **wrong), PipelineOptions(use_edges=False))
        assert not (tmp_path / "out").exists()
