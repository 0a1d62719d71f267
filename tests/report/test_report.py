import dataclasses
import itertools
import json
import re
import shutil
import subprocess
import time

import browser
import curves
import cv2
import numpy as np
import pycolmap
import pytest
from scenes import EDGES_ALONE

from colmap_edges.colmap.model import load_model
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.observations import Observations
from colmap_edges.edges2d.image_graphs import DetectedEdges
from colmap_edges.options import EdgeGraphOptions, PipelineOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run
from colmap_edges.report.contents import Contents
from colmap_edges.report.page import write_report
from colmap_edges.report.pictures import PictureVisitor
from colmap_edges.report.tracks import residual_per_edge
from colmap_edges.surfaces.faces.outlines import Face
from colmap_edges.surfaces.mesh import Mesh

pytestmark = pytest.mark.pipeline  # runs of the whole pipeline

READ = {"images_with_poses": 10, "images_without_poses": 0, "points3D": 200}
RECORD = {
    "command": "mesh",
    "date": "2026-11-23T18:20:00+00:00",
    "findings": [],
    "funnel": [],
    "stages": [{"name": "read", "wall_s": 1.0, "peak_mb": 10.0, "counts": READ}],
    "versions": {"colmap-edges": "0"},
    "paths": {"image_path": "/a & b/images"},
    "options": {"tracing": {"method": "chains"}},
}
WIDTHS = (400, 500, 800, 1000, 1500)
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


def test_no_name_becomes_markup(report):
    page = (report[0] / "report.html").read_text(encoding="utf-8")
    assert "<img src=x" not in page
    assert "window.hacked=1</" not in page
    assert "&lt;img src=x onerror=window.hacked=1&gt;.png" in page
    assert "evil <b>" not in page
    assert page.count("</script>") == 3
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', page)[1]
    assert "unsafe-eval" not in policy and policy.startswith("default-src 'none'")


def test_report_json_names_findings_and_funnel(report):
    written = json.loads((report[0] / "report.json").read_text())
    assert written["funnel"][0]["count"] > written["funnel"][-1]["count"] > 0
    assert isinstance(written["findings"], list)
    assert written["stages"][-1]["name"] == "report"


def test_edge_figures_by_hand():
    observations = Observations.of_pixels(
        offsets=np.array([0, 2, 4, 6, 7]),
        views=np.array([0, 1, 1, 2, 0, 2, 2], np.int32),
        pixels=np.zeros((7, 2)),
    )
    edges = Edges3D.of_polylines(np.zeros((4, 3)), np.array([2, 2]), observations)
    assert edges.num_views.tolist() == [3, 2]
    residuals = np.array([1, 2, 3, 2, np.nan, 4, 6])
    assert residual_per_edge(edges, residuals).tolist() == [2, 5]


def many_edges(model, count, per_edge, views_each):
    """Edges that no compression makes smaller, each point observed in several views."""
    rng = np.random.default_rng(0)
    tracks = count * per_edge * views_each
    first = rng.integers(0, len(model.views) - views_each, count * per_edge)
    points = rng.normal(0, 0.3, (count * per_edge, 3))
    observations = Observations.of_pixels(
        offsets=np.arange(count * per_edge + 1) * views_each,
        views=(first[:, None] + np.arange(views_each)).ravel().astype(np.int32),
        pixels=rng.uniform(0, 300, (tracks, 2)),
    )
    return Edges3D.of_polylines(points, np.full(count, per_edge), observations)


def test_hundred_images_and_hundred_thousand_points_stay_small(scene_model, tmp_path):
    views = tuple(
        dataclasses.replace(scene_model.views[i % 10], name=f"{i:03d}.png") for i in range(100)
    )
    model = dataclasses.replace(scene_model, views=views)
    rng = np.random.default_rng(0)
    taker, graph = (
        PictureVisitor(100),
        curves.bare_graph(rng.uniform(0, 360, (20_000, 2)), [20_000]),
    )
    found = DetectedEdges(graph=graph, dropped=np.zeros((0, 2)), num_chains=1, num_chain_pixels=0)
    noise = rng.integers(0, 255, (1500, 2000, 3), np.uint8)
    for index, view in enumerate(views):
        taker.collect(index, taker.visit(index, view, lambda: noise, found))
    edges = many_edges(model, count=5000, per_edge=20, views_each=8)
    contents = Contents(model=model, pictures=taker.pictures(), edges=edges)
    started = time.process_time()
    counts = write_report(tmp_path / "report.html", contents, RECORD)
    assert time.process_time() - started < 15
    assert counts["pictures"] >= 20
    assert counts["bytes"] == (tmp_path / "report.html").stat().st_size < 12e6


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """One page of a browser for every test."""
    if browser.CHROMIUM is None:
        pytest.skip("chromium is not installed")
    with browser.Browser(tmp_path_factory.mktemp("profile")) as opened:
        yield opened


@pytest.fixture(scope="module")
def shown(report, page):
    """The page of the report, loaded once; tests resize it."""
    page.resize(1400, 1100)
    page.open((report[0] / "report.html").as_uri())
    return page


def test_page_works_in_a_browser(shown):
    assert shown.evaluate("window.hacked") is None
    assert shown.evaluate("document.querySelectorAll('#pictures figure').length") == 10
    assert shown.evaluate("document.querySelectorAll('#pictures .dropped').length") > 0
    check_canvas(shown)
    shown.evaluate("document.getElementById('colour').value = 'residual'")
    shown.evaluate("colourEdges()")
    assert shown.evaluate("document.getElementById('least').textContent") == "0"
    shown.evaluate("document.getElementById('show-detected').click()")
    visibility = "getComputedStyle(document.querySelector('.detected')).visibility"
    assert shown.evaluate(visibility) == "hidden"
    assert shown.complaints() == []
    assert [url for url in shown.requests() if not url.startswith("file:")] == []


def test_up_stays_up_through_a_loop_of_the_mouse(shown):
    shown.resize(500)  # each step is drawn, without a GPU
    shown.evaluate("view.reset()")
    x, y, width, height = scene_box(shown)
    before = shown.evaluate(SCREEN_UP)
    turns = np.linspace(0, 2 * np.pi, 25)
    center, radius = np.array([x + width / 2, y + height / 2]), 0.35 * min(width, height)
    loop = center + radius * np.column_stack([np.cos(turns), np.sin(turns)])
    eye = shown.evaluate("view.camera.position.toArray()")
    shown.drag(*loop[:9].tolist())
    assert np.linalg.norm(np.subtract(shown.evaluate("view.camera.position.toArray()"), eye)) > 0.1
    shown.evaluate("view.reset()")
    shown.drag(*loop.tolist())
    after = shown.evaluate(SCREEN_UP)
    assert before[0] == pytest.approx(0, abs=1e-3) and before[1] > 0
    assert after[0] == pytest.approx(0, abs=1e-3) and after[1] > 0
    shown.resize(1400, 1100)


# The scene's upward direction as the eye sees it: to the right, up and towards the eye.
SCREEN_UP = """(() => { view.camera.updateMatrixWorld();
  const turn = view.camera.matrixWorldInverse;
  return view.camera.up.clone().transformDirection(turn).toArray(); })()"""


def visible_edge(page, px):
    """An edge with the pixel of the window that is `px` beside its middle, and nearest to it."""
    x, y, *_ = scene_box(page)
    offset, edge = page.evaluate(BESIDE % px)
    return edge, (x + offset[0], y + offset[1])


BESIDE = """(() => {
  const px = %s, pixels = view.project(edges.segments), box = view.canvas;
  for (let i = 0; i < edges.owners.length; ++i) {
    const [ax, ay, az, bx, by, bz] = pixels.subarray(6 * i, 6 * i + 6);
    const size = Math.hypot(bx - ax, by - ay);
    const at = [(ax + bx) / 2 - (by - ay) / size * px, (ay + by) / 2 + (bx - ax) / size * px];
    const inside = at[0] > 20 && at[1] > 20 && at[0] < box.clientWidth - 20
      && at[1] < box.clientHeight - 20;
    if (size > 0 && inside && edgeAt(...at)?.edge === edges.owners[i]) return [at, edges.owners[i]];
  }
})()"""


def test_a_click_beside_an_edge_chooses_it(shown):
    shown.evaluate("view.reset()")
    edge, at = visible_edge(shown, 6)
    shown.click(*at)
    text = shown.evaluate("document.getElementById('chosen').innerText")
    words = text.split()
    assert words[:2] == ["number", str(edge)]
    for name in ("length, scene units", "mean residual, px", "start", "end", "neighbours", "views"):
        assert name in text
    assert any(kind in words for kind in ("line", "arc", "circle", "spline"))
    assert shown.evaluate("document.querySelectorAll('#chosen-pictures canvas').length") >= 2
    color = shown.screenshot().astype(int)
    assert (np.abs(color - (168, 0, 255)).max(axis=2) < 60).sum() > 50  # drawn in its colour
    before = shown.evaluate("view.camera.position.toArray()")
    shown.evaluate("document.getElementById('frame').click()")
    assert shown.evaluate("view.camera.position.toArray()") != before
    target = shown.evaluate("view.controls.target.toArray()")
    middle = shown.evaluate("sphereOfChosen().center.toArray()")
    np.testing.assert_allclose(target, middle, atol=1e-5)
    shown.evaluate("view.reset()")
    x, y, *_ = scene_box(shown)
    number = shown.evaluate("document.getElementById('number').value")
    shown.click(x + 2, y + 2)  # where there is nothing
    assert shown.evaluate("document.getElementById('number').value") == number


def test_a_distance_is_measured_between_two_clicks(shown):
    shown.evaluate("view.reset()")
    shown.evaluate("document.getElementById('measure').click()")
    _, first = visible_edge(shown, 0)
    x, y, *_ = scene_box(shown)
    last = shown.evaluate(FAR_VERTEX)
    shown.click(*first)
    assert shown.evaluate("document.getElementById('distance').innerText") == (
        "Click the second point."
    )
    shown.click(x + last[0], y + last[1])
    shown_distance = float(
        shown.evaluate("document.getElementById('distance').innerText").split()[0]
    )
    points = shown.evaluate("measured.map((point) => point.toArray())")
    assert shown_distance == pytest.approx(np.linalg.norm(np.subtract(*points)), rel=1e-4)
    assert shown_distance > 0
    pixels = shown.evaluate("[...view.project(measured.flatMap((point) => point.toArray()))]")
    np.testing.assert_allclose(pixels[:2], np.subtract(first, (x, y)), atol=1.5)
    np.testing.assert_allclose(pixels[3:5], last, atol=1.5)
    shown.evaluate("document.getElementById('measure').click()")
    assert shown.evaluate("document.getElementById('distance').innerText") == ""
    assert shown.complaints() == []


FAR_VERTEX = """(() => {
  const points = view.layers.edges.children[0].geometry.attributes.instanceEnd.array;
  const pixels = view.project(edges.segments), box = view.canvas;
  let best = null;
  for (let i = 0; i < pixels.length; i += 6) {
    const inside = pixels[i] > 20 && pixels[i + 1] > 20 && pixels[i] < box.clientWidth - 20
      && pixels[i + 1] < box.clientHeight - 20;
    if (inside && (!best || pixels[i] > best[0])) best = [pixels[i], pixels[i + 1]];
  }
  return best;
})()"""


def test_edges_are_filtered_by_kind_and_length(shown):
    count = shown.evaluate("edges.length.length")
    assert shown.evaluate("edges.shown.reduce((a, b) => a + b)") == count
    shown.evaluate("byId('kind').value = '0'; byId('kind').dispatchEvent(new Event('change'))")
    lines = shown.evaluate("edges.shown.reduce((a, b) => a + b)")
    straight = "new Set([...edges.curve_edges].filter((_, i) => edges.curve_kinds[i] === 0)).size"
    assert lines == shown.evaluate(straight) and lines > 0
    longest = shown.evaluate("Math.max(...edges.length)")
    shown.evaluate(
        f"byId('kind').value = '-1'; byId('least-length').value = {0.99 * longest};"
        "byId('least-length').dispatchEvent(new Event('input'))"
    )
    few = shown.evaluate("edges.shown.reduce((a, b) => a + b)")
    assert 1 <= few < count
    assert shown.evaluate("byId('filtered').innerText") == f"{few} shown"
    hidden = shown.evaluate("edges.shown.indexOf(0)")
    assert hidden >= 0
    shown.evaluate("byId('least-length').value = ''; filterEdges()")
    assert shown.evaluate("byId('filtered').innerText") == ""


def test_the_view_jumps_to_a_camera(shown, report):
    model = load_model(report[0] / "sparse")
    name = model.views[3].name
    options = shown.evaluate("[...byId('camera').options].map((option) => option.text)")
    assert options[1:] == [view.name for view in model.views]
    shown.evaluate("byId('camera').value = '3'; byId('camera').dispatchEvent(new Event('change'))")
    origin = shown.evaluate("data.scene.origin")
    eye = shown.evaluate("view.camera.position.toArray()")
    np.testing.assert_allclose(np.add(eye, origin), model.views[3].center, atol=2e-3)
    way = np.subtract(shown.evaluate("view.controls.target.toArray()"), eye)
    np.testing.assert_allclose(
        way / np.linalg.norm(way), model.views[3].rotation[2], atol=1e-3, err_msg=name
    )
    shown.evaluate("document.getElementById('reset').click()")


def test_dark_mode_follows_the_system(shown):
    colour = "getComputedStyle(document.body).backgroundColor"
    assert shown.evaluate(colour) == "rgb(245, 246, 248)"
    dark = {"features": [{"name": "prefers-color-scheme", "value": "dark"}]}
    shown.call("Emulation.setEmulatedMedia", **dark)
    try:
        assert shown.evaluate(colour) == "rgb(21, 24, 28)"
        for text in set(shown.evaluate(TEXT_COLOURS)):
            assert contrast(text, "rgb(21, 24, 28)") >= 4.5, text
    finally:
        shown.call("Emulation.setEmulatedMedia", features=[])


TEXT_COLOURS = """[...document.querySelectorAll('p, th, td, figcaption, .unit, b, caption, a')]
  .map((e) => getComputedStyle(e).color)"""


def test_mesh_is_shown_and_layers_are_switched(shown):
    visible = "view.layers.mesh.visible"
    assert shown.evaluate(visible) is True
    shown.evaluate("document.getElementById('layer-mesh').click()")
    assert shown.evaluate(visible) is False
    shown.evaluate("document.getElementById('layer-mesh').click()")
    assert shown.evaluate("view.layers.cameras.visible") is False
    names = "[...document.querySelectorAll('#layers label')].map((l) => l.innerText.trim())"
    assert re.match(r"[\d,]+ 3D edges\|mesh of", "|".join(shown.evaluate(names)))


@pytest.mark.parametrize("width", WIDTHS)
def test_nothing_overlaps_or_overflows(shown, width):
    shown.resize(width)
    assert shown.evaluate("document.documentElement.scrollWidth") <= width
    assert shown.evaluate("document.getElementById('stage').clientHeight") >= 280
    assert shown.evaluate("document.getElementById('stage').clientWidth") >= min(0.55 * width, 900)
    boxes = shown.evaluate(BOXES)
    assert len(boxes) > 12
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        apart = a[2] <= b[0] + 1 or b[2] <= a[0] + 1 or a[3] <= b[1] + 1 or b[3] <= a[1] + 1
        assert apart, (one, a, other, b)
    assert all(box[0] >= 0 and box[2] <= width for _, box in boxes)
    assert shown.evaluate(BROKEN) == []


# Boxes of what must stand side by side, and counts that are broken over two lines.
BOXES = """[...document.querySelectorAll(
  'h1, .headline, .made, #controls label, #controls button, #scale, #stage, #side, .chart, '
  + '#facts tr, #files tr, #funnel tr, #funnel caption, #layer-choices label')]
  .map((e) => [e.id || e.textContent.slice(0, 30), e.getBoundingClientRect()])
  .filter(([_, r]) => r.width * r.height > 0)
  .map(([name, r]) => [name, [r.left, r.top, r.right, r.bottom]])"""
BROKEN = """[...document.querySelectorAll('.count')]
  .filter((e) => new Set([...e.getClientRects()].map((r) => Math.round(r.top))).size > 1)
  .map((e) => e.textContent)"""


def test_labels_of_charts_stay_within_and_apart(shown):
    shown.resize(800)
    outside = """[...document.querySelectorAll('.chart svg')].flatMap((svg) => {
      const frame = svg.getBoundingClientRect();
      const boxes = [...svg.querySelectorAll('text')].map((t) => t.getBoundingClientRect());
      const over = (a, b) => a.left < b.right - 1 && b.left < a.right - 1
        && a.top < b.bottom - 4 && b.top < a.bottom - 4;
      return boxes.filter((r, i) => r.left < frame.left - 1 || r.right > frame.right + 1
        || boxes.some((other, k) => k !== i && over(r, other))).length;
    })"""
    assert shown.evaluate(outside) == [0, 0, 0]


def test_print_has_the_scene_and_all_charts(shown, tmp_path):
    shown.resize(800)
    (tmp_path / "report.pdf").write_bytes(shown.pdf())
    if shutil.which("pdftoppm") is None:
        pytest.skip("pdftoppm is not installed")
    command = ["pdftoppm", "-r", "80", "-png", tmp_path / "report.pdf", tmp_path / "page"]
    subprocess.run(command, check=True)
    pages = [cv2.imread(str(path)) for path in sorted(tmp_path.glob("page-*.png"))]
    first = pages[0][: int(0.6 * len(pages[0]))]
    spread = np.ptp(first.astype(int), axis=2)
    assert (spread > 40).mean() > 0.002  # the 3D edges, in colours; all else is gray
    inked = (first < 200).any(axis=2)
    assert inked.mean() > 0.05
    assert not inked[:, -4:].any()  # nothing runs off the paper
    bars = [(np.abs(page.astype(int) - (181, 109, 47)).max(axis=2) < 30).sum() for page in pages]
    assert sum(bars) > 500


def test_keys_turn_the_view_and_choose_edges(shown):
    shown.resize(1400, 1100)
    eye = "[view.camera.position, view.controls.target].map((v) => v.toArray())"
    shown.evaluate("document.getElementById('reset').click()")
    shown.evaluate("document.getElementById('view').focus()")
    before = [np.array(v) for v in shown.evaluate(eye)]
    shown.press("ArrowLeft")
    after = [np.array(v) for v in shown.evaluate(eye)]
    radii = [np.linalg.norm(a - b) for a, b in (before, after)]
    assert np.linalg.norm(after[0] - before[0]) > 0.02 * radii[0]
    assert radii[1] == pytest.approx(radii[0])
    shown.press("+")
    nearer = [np.array(v) for v in shown.evaluate(eye)]
    assert np.linalg.norm(nearer[0] - nearer[1]) == pytest.approx(0.85 * radii[1])
    shown.evaluate(
        "{const n = document.getElementById('number'); n.value = 1;"
        " n.dispatchEvent(new Event('change')); 1}"
    )
    chosen = shown.evaluate("document.getElementById('chosen').innerText").split()
    assert chosen[:2] == ["number", "1"]


def test_page_is_accessible_to_screen_readers(shown):
    unnamed = """[...document.querySelectorAll('input, select, button, img, .chart svg, #view')]
      .filter((e) => !(e.labels?.length || e.textContent.trim() || e.hasAttribute('alt')
        || e.getAttribute('aria-label')) || (e.tagName === 'BUTTON' && !e.textContent.trim()))
      .map((e) => e.outerHTML.slice(0, 80))"""
    assert shown.evaluate(unnamed) == []
    assert shown.evaluate("document.querySelectorAll('main, h1').length") == 2
    assert shown.evaluate("document.documentElement.lang") == "en"
    assert shown.evaluate("document.getElementById('view').tabIndex") == 0
    assert shown.evaluate("document.querySelectorAll('td:first-child').length") == 0  # heads are th
    colours = """[...document.querySelectorAll('p, th, td, figcaption, .unit, button, b, caption')]
      .map((e) => getComputedStyle(e).color)"""
    for colour in set(shown.evaluate(colours)):
        assert contrast(colour, "rgb(245, 246, 248)") >= 4.5, colour


def contrast(one, other):
    """WCAG's contrast of two colours as CSS writes them."""
    levels = []
    for text in (one, other):
        parts = np.array([float(x) for x in re.findall(r"[\d.]+", text)[:3]]) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        levels.append(linear @ (0.2126, 0.7152, 0.0722) + 0.05)
    return max(levels) / min(levels)


def test_title_names_scene_and_date(shown):
    title = shown.evaluate("document.title")
    assert re.match(r"evil <b>&amp;\d*: 3D edges and mesh, \d{4}-\d\d-\d\d$", title), title
    assert "triangles, from 10 images" in shown.evaluate("document.body.innerText")


@pytest.mark.parametrize("edges", [None, Edges3D.none()], ids=["no edges wanted", "none found"])
def test_page_without_edges(scene_model, tmp_path, page, edges):
    page.resize(1400, 1100)
    write_report(tmp_path / "report.html", Contents(model=scene_model, edges=edges), RECORD)
    page.open((tmp_path / "report.html").as_uri())
    for name in ("#side", "#scale", "#charts", "#images", "label[for=colour]"):
        assert page.evaluate(f"document.querySelector('{name}').offsetHeight") == 0, name
    assert page.evaluate("document.querySelectorAll('#layers input:checked').length") == 2
    check_canvas(page, 8)  # dots of few grays
    assert page.complaints() == []


def test_faces_are_shown_instead_of_the_mesh(scene_model, tmp_path, page):
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    face = Face(
        normal=np.array([0.0, 0, 1]),
        offset=0.0,
        area=1.0,
        outline=corners,
        holes=(),
        views=np.arange(2),
        plane=0,
    )
    mesh = Mesh(
        vertices=corners,
        faces=np.array([[0, 1, 2]], np.int32),
        point3D_ids=np.full(4, -1),
        colors=np.full((4, 3), 99, np.uint8),
        stats={},
    )
    contents = Contents(model=scene_model, mesh=mesh, faces=[face])
    write_report(tmp_path / "report.html", contents, RECORD)
    page.resize(1400, 1100)
    page.open((tmp_path / "report.html").as_uri())
    visible = "['mesh', 'faces'].map((name) => view.layers[name].visible)"
    assert page.evaluate(visible) == [True, False]
    page.evaluate("document.getElementById('layer-faces').click()")
    assert page.evaluate(visible) == [False, True]
    assert page.evaluate("document.getElementById('layer-mesh').checked") is False
    page.evaluate("document.getElementById('layer-mesh').click()")
    assert page.evaluate(visible) == [True, False]
    assert "1 planar face" in page.evaluate("document.getElementById('layers').innerText")
    assert page.complaints() == []


def test_picture_stands_where_3d_does_not_work(scene_model, tmp_path, page):
    write_report(tmp_path / "report.html", Contents(model=scene_model), RECORD)
    without = page.call(
        "Page.addScriptToEvaluateOnNewDocument", source="delete window.DecompressionStream"
    )
    try:
        page.open((tmp_path / "report.html").as_uri())
    finally:
        page.call("Page.removeScriptToEvaluateOnNewDocument", **without)
    assert page.evaluate("document.getElementById('still').naturalWidth") == 1280
    assert "cannot show" in page.evaluate("document.getElementById('trouble').innerText")
    assert page.evaluate("document.getElementById('controls').offsetHeight") == 0


def scene_box(page):
    box = "document.getElementById('view').getBoundingClientRect()"
    return [page.evaluate(f"{box}.{key}") for key in ("x", "y", "width", "height")]


def check_canvas(page, least=50):
    """The 3D view shows many colours, not one."""
    x, y, width, height = map(int, scene_box(page))
    seen = page.screenshot()[y + 40 : y + height, x : x + width].astype(int)
    assert len(np.unique(seen @ (1, 1 << 8, 1 << 16))) > least


def test_no_report_when_not_wanted(evil_paths, tmp_path):
    paths = Paths(image_path=evil_paths[0], input_path=evil_paths[1], output_path=tmp_path / "out")
    run("reconstruct", paths, dataclasses.replace(EDGES_ALONE, report=False))
    assert not (tmp_path / "out" / "report.html").exists()
    assert len(load_model(tmp_path / "out" / "sparse").views) == 10
