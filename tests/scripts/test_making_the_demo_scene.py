"""The scripts that make the demo scene and compare its meshes, at reduced size."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
import scenes
import trimesh
from project import DEMO, SCRIPTS, run_script

import colmap_edges
from colmap_edges.pipeline.paths import Paths

SCALE = ("--num_views", 4, "--size", "512x384")


def lengths_of(curves):
    return np.linalg.norm(np.diff(curves["points"][curves["edges"]], axis=1), axis=2)


def test_geometry_is_that_of_the_demo(tmp_path):
    pytest.importorskip("manifold3d", reason="the bodies are made with manifold3d")
    run_script("make_scene.py", "demo", "geometry", "--output_path", tmp_path, *SCALE)
    made, kept = (trimesh.load(path / "surface.ply", process=False) for path in (tmp_path, DEMO))
    assert made.is_watertight
    np.testing.assert_allclose(made.bounds, kept.bounds, atol=1e-5)
    assert made.volume == pytest.approx(kept.volume, rel=1e-4)
    with np.load(tmp_path / "curves.npz") as new, np.load(DEMO / "curves.npz") as old:
        assert lengths_of(new).sum() == pytest.approx(lengths_of(old).sum(), rel=1e-3)
    cameras, full = (
        json.loads((path / "true_cameras.json").read_text()) for path in (tmp_path, DEMO)
    )
    assert (cameras["width"], cameras["height"]) == (512, 384)
    assert cameras["params"] == [value / 2 for value in full["params"]]
    names = [f"view{i:02d}.jpg" for i in range(4)]
    assert list(cameras["cam_from_world"]) == names
    for name in names:
        np.testing.assert_allclose(cameras["cam_from_world"][name], full["cam_from_world"][name])


def test_sparse_model_of_few_small_images(tmp_path):
    pytest.importorskip("manifold3d", reason="the bodies are made with manifold3d")
    (tmp_path / "images").mkdir()
    for index in range(5):  # one more than is asked for
        image = cv2.imread(str(DEMO / "images" / f"view{index:02d}.jpg"))
        small = cv2.resize(image, (512, 384), interpolation=cv2.INTER_AREA)
        cv2.imwrite(str(tmp_path / "images" / f"view{index:02d}.jpg"), small)
    done = run_script("make_scene.py", "demo", "sparse", "--output_path", tmp_path, *SCALE)
    assert done.stdout.startswith("4 images, ")
    model, kept = (pycolmap.Reconstruction(path / "sparse") for path in (tmp_path, DEMO))
    (camera,) = model.cameras.values()
    assert camera.focal_length == pytest.approx(550, rel=0.05)
    assert model.num_points3D() > 50
    centres = {image.name: image.projection_center() for image in kept.images.values()}
    for image in model.images.values():  # as far from where they look as 12 m
        assert np.linalg.norm(image.projection_center() - centres[image.name]) < 0.3


def test_images_are_rendered(tmp_path):
    python = os.environ.get("BLENDER_PYTHON", sys.executable)
    found = subprocess.run(
        [python, "-c", "import bpy, manifold3d, embreex, scipy, trimesh"], capture_output=True
    )
    if found.returncode:
        pytest.skip("Blender's Python module is not there (set BLENDER_PYTHON)")
    arguments = ("--num_views", "2", "--size", "256x192", "--output_path", tmp_path)
    command = [python, SCRIPTS / "make_scene.py", "demo", "images", *arguments]
    environment = {k: v for k, v in os.environ.items() if not k.startswith("PYTHON")}
    subprocess.run(command, env=environment, capture_output=True, check=True)
    names = sorted(path.name for path in (tmp_path / "images").iterdir())
    assert names == ["view00.jpg", "view01.jpg"]
    for name in names:
        made, kept = (cv2.imread(str(path / "images" / name), 0) for path in (tmp_path, DEMO))
        assert made.shape == (192, 256)
        small = cv2.resize(kept, (256, 192), interpolation=cv2.INTER_AREA)
        assert np.median(np.abs(made.astype(float) - small)) < 8


def surface_of_scene():
    """The faces of the synthetic scene's bodies as triangles."""
    corners, triangles = [], []
    for face in (face for body in scenes.solids() for face in body):
        first, count = sum(map(len, corners)), len(face.corners)
        triangles += [(first, first + i, first + i + 1) for i in range(1, count - 1)]
        corners.append(face.corners)
    return trimesh.Trimesh(np.concatenate(corners), triangles, process=False)


@pytest.mark.pipeline
def test_meshes_are_compared_with_the_true_surface(small, tmp_path):
    pytest.importorskip("colmap_edges._mesher", reason="the CGAL mesher is not built")
    pytest.importorskip("PIL", reason="reading the texture of a GLB needs Pillow")
    from colmap_edges.options import PipelineOptions
    from colmap_edges.pipeline.run import run

    demo, output = tmp_path / "demo", tmp_path / "output"
    shutil.copytree(small[0], demo / "images")
    shutil.copytree(small[1], demo / "sparse")
    surface_of_scene().export(demo / "surface.ply")
    output.mkdir()
    for name, use_edges in (("without_edges", False), ("with_edges", True)):
        paths = Paths(image_path=small[0], input_path=small[1], output_path=output / name)
        run("mesh", paths, PipelineOptions(use_edges=use_edges, num_threads=1), exports=("glb",))
    lines = run_script("compare_demo.py", demo, output).stdout.splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[:4]]
    heads = ["depth error in all views", "mae", "rmse", "median", "p90", "coverage"]
    heads += [f"right {share} percent" for share in ("0 5", "1", "2")]
    heads += ["normals median deg", "normals 10 deg", "normals 30 deg"]
    assert rows[0] == heads
    assert [row[0] for row in rows[2:]] == ["without edges", "with edges"]
    without, with_edges = ([float(cell) for cell in row[1:]] for row in rows[2:])
    assert with_edges[0] < without[0]  # of solids that are edges and little else
    assert 0 < with_edges[2] < 0.02
    assert 0.9 < with_edges[-2] < with_edges[-1] < 1  # normals within 10 and 30 degrees
    pictures = sorted(output.glob("*.jpg"))
    assert len(pictures) == len(lines) - 4 >= 4
    height, width = cv2.imread(str(next(demo.glob("images/*")))).shape[:2]
    for path in pictures:
        assert cv2.imread(str(path)).shape == (2 * height, 3 * width, 3)


def test_the_demo_meshes_twice_and_compares(tmp_path):
    """With stand-ins for the setup and the program; the comparison starts as the demo starts it."""
    programs = {
        "scripts/setup": "",
        ".venv/bin/colmap-edges": 'echo "$@" >> runs.txt',
        ".venv/bin/python": f'exec "{sys.executable}" "$1" --help',
    }
    for name, text in programs.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"#!/usr/bin/env bash\n{text}\n")
        path.chmod(0o755)
    shutil.copy(SCRIPTS / "demo", tmp_path / "scripts")
    (tmp_path / "scripts" / "compare_demo.py").symlink_to(SCRIPTS / "compare_demo.py")
    package = os.fspath(Path(colmap_edges.__file__).parents[1])
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONSAFEPATH"}
    done = subprocess.run(
        [tmp_path / "scripts" / "demo"],
        env=environment | {"PYTHONPATH": package},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert "Print the errors of the demo's meshes" in done.stdout
    outputs = [line.split()[6] for line in (tmp_path / "runs.txt").read_text().splitlines()]
    assert outputs == ["demo_output/without_edges", "demo_output/with_edges"]
