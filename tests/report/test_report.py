import dataclasses
import json
import time

import browser
import curves
import cv2
import numpy as np
import pycolmap
import pytest

from colmap_edges.colmap.model import load_model
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.edges2d.image_graphs import DetectedEdges
from colmap_edges.options import EdgeGraphOptions, PipelineOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run
from colmap_edges.report.contents import Contents
from colmap_edges.report.page import script_json, write_report
from colmap_edges.report.pictures import PictureTaker
from colmap_edges.report.tracks import residual_per_edge, views_per_edge

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

RECORD = {
    "command": "mesh",
    "findings": [],
    "funnel": [],
    "stages": [{"name": "read", "wall_s": 1.0, "peak_mb": 10.0, "counts": {"images": 3}}],
    "versions": {"colmap-edges": "0"},
    "paths": {"image_path": "a & b"},
    "options": {"tracing": {"method": "chains"}},
}
EVIL_NAMES = ["<img src=x onerror=window.hacked=1>.png", "a</script><script>window.hacked=1/b.png"]


@pytest.fixture(scope="module")
def evil_paths(scene, tmp_path_factory):
    """The scene with names of images that are HTML."""
    folder = tmp_path_factory.mktemp("evil <b>&amp;")
    image_path, input_path = folder / "images", folder / "sparse"
    input_path.mkdir()
    reconstruction = pycolmap.Reconstruction(scene.reconstruction)
    for image, evil in zip(reconstruction.images.values(), EVIL_NAMES, strict=False):
        picture = scene.images[image.name]
        image.name = evil
        write_image(image_path / evil, picture)
    for name, picture in scene.images.items():
        write_image(image_path / name, picture)
    reconstruction.write(str(input_path))
    return image_path, input_path


def write_image(path, picture):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(".png", picture)[1].tobytes())


@pytest.fixture(scope="module")
def report(evil_paths):
    """Output folder of `mesh` with some edges filtered, and its report.json."""
    output = evil_paths[0].parent / "out"
    options = PipelineOptions(edge_graph=EdgeGraphOptions(filter_regular_length=True))
    paths = Paths(image_path=evil_paths[0], input_path=evil_paths[1], output_path=output)
    return output, run("mesh", paths, options)


def test_script_json_cannot_end_its_element():
    text = script_json({"a": "</script><!-- & 'x'"})
    assert not set("<>&") & set(text)
    assert json.loads(text) == {"a": "</script><!-- & 'x'"}


def test_no_name_becomes_markup(report):
    page = (report[0] / "report.html").read_text(encoding="utf-8")
    assert "<img src=x" not in page
    assert "window.hacked=1</" not in page
    assert "&lt;img src=x onerror=window.hacked=1&gt;.png" in page
    assert "evil <b>" not in page


def test_report_json_names_findings_and_funnel(report):
    written = json.loads((report[0] / "report.json").read_text())
    assert written["funnel"][0]["count"] > written["funnel"][-1]["count"] > 0
    assert isinstance(written["findings"], list)
    assert written["stages"][-1]["name"] == "report"


def test_edge_figures_by_hand():
    edges = Edges3D(
        points=np.zeros((4, 3)),
        edge_offsets=np.array([0, 2, 4]),
        closed=np.zeros(2, bool),
        observations=Observations.of_pixels(
            offsets=np.array([0, 2, 4, 6, 7]),
            views=np.array([0, 1, 1, 2, 0, 2, 2], np.int32),
            pixels=np.zeros((7, 2)),
        ),
        sigmas=np.zeros(4),
        end_nodes=np.zeros((2, 2), np.int32),
        colors=np.zeros((4, 3), np.uint8),
    )
    assert views_per_edge(edges, 3).tolist() == [3, 2]
    residuals = np.array([1, 2, 3, 2, np.nan, 4, 6])
    assert residual_per_edge(edges, residuals).tolist() == [2, 5]


def many_edges(model, count, per_edge, views_each):
    """Edges that no compression makes smaller, each point observed in several views."""
    rng = np.random.default_rng(0)
    tracks = count * per_edge * views_each
    first = rng.integers(0, len(model.views) - views_each, count * per_edge)
    return Edges3D(
        points=rng.normal(0, 0.3, (count * per_edge, 3)),
        edge_offsets=np.arange(count + 1) * per_edge,
        closed=np.zeros(count, bool),
        observations=Observations.of_pixels(
            offsets=np.arange(count * per_edge + 1) * views_each,
            views=(first[:, None] + np.arange(views_each)).ravel().astype(np.int32),
            pixels=rng.uniform(0, 300, (tracks, 2)),
        ),
        sigmas=np.zeros(count * per_edge),
        end_nodes=np.full((count, 2), -1, np.int32),
        colors=np.zeros((count * per_edge, 3), np.uint8),
    )


def test_hundred_images_and_hundred_thousand_points_stay_small(scene_model, tmp_path):
    views = tuple(
        dataclasses.replace(scene_model.views[i % 10], name=f"{i:03d}.png") for i in range(100)
    )
    model = dataclasses.replace(scene_model, views=views)
    rng = np.random.default_rng(0)
    taker, graph = PictureTaker(100), curves.bare_graph(rng.uniform(0, 360, (20_000, 2)), [20_000])
    found = DetectedEdges(graph=graph, dropped=np.zeros((0, 2)), num_chains=1, num_chain_pixels=0)
    noise = rng.integers(0, 255, (1500, 2000, 3), np.uint8)
    for index, view in enumerate(views):
        taker.collect(index, taker.visit(index, view, lambda: noise, found))
    edges = many_edges(model, count=5000, per_edge=20, views_each=8)
    contents = Contents(model=model, pictures=taker.pictures(), edges=edges)
    started = time.perf_counter()
    counts = write_report(tmp_path / "report.html", contents, RECORD)
    assert time.perf_counter() - started < 30
    assert counts["pictures"] >= 20
    assert counts["bytes"] == (tmp_path / "report.html").stat().st_size < 30e6


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """One page of a browser for every test."""
    if browser.CHROMIUM is None:
        pytest.skip("chromium is not installed")
    with browser.Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


def test_page_works_in_a_browser(report, page):
    page.open((report[0] / "report.html").as_uri())
    assert page.evaluate("window.hacked") is None
    assert page.evaluate("document.querySelectorAll('#pictures figure').length") == 10
    assert page.evaluate("document.querySelectorAll('#pictures .dropped').length") > 0
    check_canvas(page)
    check_click(page)
    page.evaluate("document.getElementById('colour').value = 'residual'")
    page.evaluate("colourEdges().then(() => 1)")
    page.evaluate("document.getElementById('show-detected').click()")
    shown = "getComputedStyle(document.querySelector('.detected')).visibility"
    assert page.evaluate(shown) == "hidden"
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    assert page.complaints() == []
    assert [url for url in page.requests() if not url.startswith("file:")] == []


def test_page_without_edges(scene_model, tmp_path, page):
    write_report(tmp_path / "report.html", Contents(model=scene_model), RECORD)
    page.open((tmp_path / "report.html").as_uri())
    assert page.evaluate("document.getElementById('edge-controls').hidden")
    check_canvas(page)
    assert page.complaints() == []


def scene_box(page):
    box = "document.querySelector('#scene canvas').getBoundingClientRect()"
    return [page.evaluate(f"{box}.{key}") for key in ("x", "y", "width", "height")]


def check_canvas(page):
    """The 3D view shows many colours, not one."""
    x, y, width, height = map(int, scene_box(page))
    seen = page.screenshot()[y + 40 : y + height, x : x + width]
    assert len(np.unique(seen.reshape(-1, 3), axis=0)) > 50


def check_click(page):
    """A click on a line chooses its edge and shows figures and reprojections."""
    page.evaluate(
        "window.under = null; scene.on('plotly_hover', (e) => { window.under = e.points[0]; })"
    )
    x, y, width, height = scene_box(page)
    for at in np.random.default_rng(0).uniform(0.3, 0.7, (200, 2)) * (width, height) + (x, y):
        page.mouse("mouseMoved", *at)
        time.sleep(0.05)
        if page.evaluate("window.under?.data.meta") == "edges":
            page.mouse("mousePressed", *at)
            page.mouse("mouseReleased", *at)
            break
    chosen = page.evaluate("document.getElementById('chosen').innerText")
    assert "mean residual, px" in chosen
    edge = page.evaluate("lineEdges[window.under.pointNumber]")
    assert chosen.split()[:2] == ["id", str(edge)]
    assert page.evaluate("document.querySelectorAll('#chosen-pictures canvas').length") >= 2


def test_no_report_when_not_wanted(evil_paths, tmp_path):
    paths = Paths(image_path=evil_paths[0], input_path=evil_paths[1], output_path=tmp_path / "out")
    run("reconstruct", paths, PipelineOptions(report=False))
    assert not (tmp_path / "out" / "report.html").exists()
    assert len(load_model(tmp_path / "out" / "sparse").views) == 10
