"""Edge images of other detectors, and of our own, through the whole pipeline."""

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pycolmap
import pytest
from mask_files import BLACK_LEFT, paths_of, write_masks
from project import DEMO, part_of_demo, run_script
from scenes import EDGES_ALONE
from scipy.spatial import cKDTree

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.masks import MARGIN_PX
from colmap_edges.options import DetectionOptions, PipelineOptions, preset
from colmap_edges.pipeline.reconstruct import reconstruct
from colmap_edges.pipeline.run import run

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

NOT_ENLARGED = replace(EDGES_ALONE, refine_poses=False, detection=DetectionOptions(min_blur_px=0))
CANNY = ("--detector", "canny")
CORNER_PX = 8  # by which chains are led on to their corners


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """(images, model) of the demo seen by every third of its views."""
    return DEMO / "images", part_of_demo(tmp_path_factory.mktemp("demo") / "sparse", 3)


@pytest.fixture(scope="module")
def default(demo):
    return edges_of(demo)


def edges_of(scene, edge_path=None):
    reconstruction = pycolmap.Reconstruction(str(scene[1]))
    return reconstruct(reconstruction, scene[0], NOT_ENLARGED, edge_path=edge_path).edges


def write_maps(scene, folder, *options):
    arguments = ("--image_path", scene[0], "--input_path", scene[1], "--output_path", folder)
    done = run_script("write_edge_maps.py", *arguments, *options)
    assert "edge images in" in done.stdout
    return folder


def length(edges):
    return np.linalg.norm(np.diff(edges.points[edges.segments], axis=1), axis=2).sum()


def along(points, segments):
    """Points on the segments; true ones are at most a centimetre long."""
    first, last = points[segments].swapaxes(0, 1)
    steps = np.linspace(0, 1, 10)[:, None, None]
    return (first + steps * (last - first)).reshape(-1, 3)


def share_near(edges, curves, distance):
    """Share of the length of edges that lies near curves."""
    return (cKDTree(along(*curves)).query(along(edges.points, edges.segments))[0] < distance).mean()


def test_edges_of_canny(demo, default, tmp_path):
    """Another detector's edges come to about as many 3D edges, and they are right."""
    found = edges_of(demo, write_maps(demo, tmp_path / "maps", *CANNY))
    assert 0.75 < length(found) / length(default) < 1.25
    truth = np.load(DEMO / "curves.npz")
    curves = truth["points"], truth["edges"]
    near = [share_near(edges, curves, 0.015) for edges in (default, found)]
    assert near[1] > 0.9
    assert near[1] > near[0] - 0.03


def test_own_edges_come_back(demo, default, tmp_path):
    found = edges_of(demo, write_maps(demo, tmp_path / "maps", "--min_blur_px", "0"))
    assert length(found) == pytest.approx(length(default), rel=0.05)
    # Chains at whole pixels differ by noise: a few pieces fall on the other side of the limit
    # between edges and contours: 0.93 of what is found was there before, and 0.91 is found again.
    for edges, others, least in ((found, default, 0.92), (default, found, 0.9)):
        assert share_near(edges, (others.points, others.segments), 0.01) > least


@pytest.mark.parametrize(("method", "least"), [("chains", 0.6), ("paper", 0.2)])
def test_meshes_by_both_methods(small, tmp_path, method, least):
    """Soft maps, such as learned detectors give, as good as lines; the same again from a cache."""
    pytest.importorskip("colmap_edges._mesher", reason="the CGAL mesher is not built")
    maps = write_maps(small, tmp_path / "maps", *CANNY)
    for path in maps.iterdir():
        lines = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(np.float32)
        soft = cv2.GaussianBlur(lines, (0, 0), 1.5)
        cv2.imwrite(str(path), np.rint(200 * soft / soft.max()).astype(np.uint8))
    options = preset("paper") if method == "paper" else PipelineOptions()
    options = replace(options, use_faces=False, use_patches=False, report=False)
    points = []
    for edge_path in (None, maps, maps):
        paths = paths_of(small, tmp_path, None)
        paths = replace(paths, edge_path=edge_path, cache_path=tmp_path / "cache")
        report = run("mesh", paths, options, overwrite=True)
        counts = {stage["name"]: stage["counts"] for stage in report["stages"]}
        points.append(counts["trace"]["edge_points"])
        assert counts["mesh"]["faces"] > 0
        assert counts["detect"].get("edge_images") == (6 if edge_path else None)
    assert counts["detect"]["images_reused"] == 6
    assert points[1] == points[2] != points[0]
    assert least < points[1] / points[0] < 1.5
    path = sorted(maps.iterdir())[0]
    cv2.imwrite(str(path), cv2.imread(str(path)) // 2 * 2)
    paths = replace(paths, output_path=tmp_path / "again")
    counts = run("detect", paths, options)["stages"][1]["counts"]
    assert counts["images_reused"] == 5  # the sixth is not found by its old edge image


def test_masks_hold_for_edge_images(small, tmp_path):
    maps = write_maps(small, tmp_path / "maps", *CANNY)
    masks = write_masks(tmp_path / "masks", small[0])
    reconstruction = pycolmap.Reconstruction(str(small[1]))
    paths = {"mask_path": str(masks), "edge_path": str(maps)}
    found = reconstruct(reconstruction, small[0], EDGES_ALONE, **paths)
    assert found.edges.num_points
    assert found.edges.observations.pixels[:, 0].min() >= BLACK_LEFT.shape[1] / 2 - (
        MARGIN_PX + CORNER_PX
    )


def test_wrong_edge_images_are_one_line(small, tmp_path):
    maps = write_maps(small, tmp_path / "maps", *CANNY)
    first = sorted(maps.iterdir())[0]
    whole = first.read_bytes()
    paths = replace(paths_of(small, tmp_path, None), edge_path=maps)

    def fails(message, paths=paths):
        with pytest.raises(ColmapEdgesError, match=message) as caught:
            run("detect", paths, PipelineOptions())
        assert "\n" not in str(caught.value)
        assert not paths.output_path.exists()

    cv2.imwrite(str(first), BLACK_LEFT[:90])
    fails(f"edge image .*{first.name} is 240x90, the camera of image {first.stem} 240x180")
    first.write_bytes(whole[:50])
    fails(f"cannot read edge image .*{first.name} of image {first.stem}; replace or delete it")
    first.unlink()
    fails(f"has no edge image of 1 of 6 images; .* that of {first.stem} is {first.name}")
    fails("edge_path .* is not a folder", replace(paths, edge_path=tmp_path / "nowhere"))
    shutil.rmtree(maps)
    maps.mkdir()
    fails("has no edge image of 6 of 6 images")
    fails("output_path", replace(paths, output_path=maps / "out", edge_path=maps))
