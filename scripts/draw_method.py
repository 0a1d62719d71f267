#!/usr/bin/env python3
"""Draw the figure of docs/method.md that explains how depths along a chain are estimated.

It shows a chain with its samples in one image of the demo scene, the epipolar line of one sample in
a neighbouring image with the chains that it intersects, and the depth hypotheses of all samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click
import cv2
import numpy as np

from colmap_edges.colmap.model import load_model
from colmap_edges.core.view import lift
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges2d.image_graphs import ImageWork, graph_of_image
from colmap_edges.edges2d.working_scale import at_working_scale
from colmap_edges.edges3d.chains.depths import ChainDepths, compute_chain_depths
from colmap_edges.edges3d.chains.tracing import with_side_likelihoods
from colmap_edges.edges3d.chains.tracing_input import TracingInput, make_input
from colmap_edges.edges3d.chains.view_selection import select_views
from colmap_edges.errors import exit_on_error
from colmap_edges.images.files import read_image
from colmap_edges.options import PipelineOptions, resolved
from colmap_edges.report.still import WEBP

HEIGHT, WIDTH, GAP = 720, 880, 32  # of a panel; the picture is halved at the end
TITLE = 64  # height of a panel's title
MARGIN = 0.35  # around what a panel shows, relative to its extent
MAX_CHORD = 0.85  # chord of a bent chain, relative to its number of pixels
BLUE, ORANGE, GRAY, BLACK = (200, 110, 40), (0, 120, 255), (170, 170, 170), (30, 30, 30)
WHITE = (255, 255, 255)
FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class Chain:
    """One chain of the reference view with its depths.

    Attributes:
        given: the views with their graphs.
        view: the reference view.
        ranges: (S, 2) range of inverse depths of each sample.
        pixels: (S, 2) undistorted pixels of the samples.
        points: (N, 2) undistorted pixels of the whole chain.
        inverse_depths: (S,) estimated; 0 where there is none.
        chosen: the sample whose epipolar line is drawn.
        neighbor: the view that it is drawn in.
    """

    given: TracingInput
    view: int
    ranges: np.ndarray
    pixels: np.ndarray
    points: np.ndarray
    inverse_depths: np.ndarray
    chosen: int
    neighbor: int


@click.command(help=__doc__)
@click.option("--image_path", type=Path, default=Path("tests/data/demo/images"), show_default=True)
@click.option("--input_path", type=Path, default=Path("tests/data/demo/sparse"), show_default=True)
@click.option("--image_name", default="view04.jpg", show_default=True, help="Reference image.")
@click.option("--output_path", type=Path, default=Path("docs/depths.webp"), show_default=True)
@exit_on_error()
def main(image_path: Path, input_path: Path, image_name: str, output_path: Path) -> None:
    chain = chain_of(image_path, input_path, image_name)
    gap = np.full((HEIGHT, GAP, 3), 255, np.uint8)
    panels = [reference_panel(chain, image_path), neighbor_panel(chain, image_path), plot(chain)]
    picture = np.hstack([panels[0], gap, panels[1], gap, panels[2]])
    size = picture.shape[1] // 2, HEIGHT // 2
    cv2.imwrite(str(output_path), cv2.resize(picture, size, interpolation=cv2.INTER_AREA), WEBP)
    click.echo(output_path)


def chain_of(image_path: Path, input_path: Path, image_name: str) -> Chain:
    """The bent chain of an image on which most samples have a depth."""
    options = PipelineOptions()
    model = at_working_scale(load_model(input_path), image_path, options.detection)
    settings = resolved(options, model.scale)
    work = ImageWork(
        image_path=image_path, detection=settings.detection, edge_graph=settings.edge_graph
    )
    graphs = Graphs.of([graph_of_image(work, i, view)[0] for i, view in enumerate(model.views)])
    near = select_views(model, settings.view_selection)
    given = with_side_likelihoods(make_input(model, graphs, near), near, settings)
    view = [each.name for each in model.views].index(image_name)
    depths = compute_chain_depths(given, view, near.ranges[view], settings.chain_depth, 1)
    graph = given.graph(view)
    first, last = graph.polyline_offsets[:-1], graph.polyline_offsets[1:] - 1
    chords = np.linalg.norm(graph.points[last] - graph.points[first], axis=1)
    bent = chords * model.scale < MAX_CHORD * (last - first)
    counts = np.add.reduceat(depths.found.astype(int), depths.sample_offsets[:-1])
    best = int(np.where(bent, counts, -1).argmax())
    rows = np.arange(*depths.sample_offsets[best : best + 2])
    pixels = graph.undistorted[depths.samples[rows]]
    return Chain(
        given=given,
        view=view,
        ranges=near.ranges[view].at(pixels),
        pixels=pixels,
        points=graph.undistorted[slice(*graph.polyline_offsets[best : best + 2])],
        inverse_depths=depths.inverse_depths[rows],
        **chosen_sample(depths, rows),
    )


def chosen_sample(depths: ChainDepths, rows: np.ndarray) -> dict[str, int]:
    """The sample nearest to the middle of the chain that has a depth, and a supporting view."""
    with_depth = np.flatnonzero(depths.found[rows])
    chosen = int(with_depth[np.abs(with_depth - len(rows) / 2).argmin()])
    first = depths.support_offsets[rows[chosen]]
    return {"chosen": chosen, "neighbor": int(depths.support_views[first])}


def hypotheses(chain: Chain, sample: int, neighbor: int) -> tuple[np.ndarray, ...]:
    """Intersections of a sample's epipolar line with the chains of a neighbour.

    Returns:
        (2, 2) ends of the line, (H, 2) intersections, both in undistorted pixels of the neighbour,
        and (H,) inverse depths in the reference view.
    """
    view, other = (chain.given.views[index] for index in (chain.view, neighbor))
    pixel = np.repeat(chain.pixels[sample : sample + 1], 2, axis=0)
    ends = other.cam_from_world(lift(view, pixel, chain.ranges[sample]))
    line = other.focal_px * ends[:, :2] / ends[:, 2:]
    direction, graph = line[1] - line[0], chain.given.graph(neighbor)
    points = graph.undistorted
    side = (points - line[0]) @ (-direction[1], direction[0])
    crossed = np.flatnonzero((side[:-1] * side[1:] < 0) & (np.diff(graph.polyline_ids) == 0))
    share = side[crossed] / (side[crossed] - side[crossed + 1])
    pixels = points[crossed] + share[:, None] * (points[crossed + 1] - points[crossed])
    along = (pixels - line[0]) @ direction / (direction @ direction)
    pixels = pixels[(along >= 0) & (along <= 1)]
    # Times inverse depth, a point on the ray is linear in it: start + inverse depth * step.
    scaled = chain.ranges[sample][:, None] * ends
    step = np.diff(scaled, axis=0)[0] / np.diff(chain.ranges[sample])
    start = scaled[0] - chain.ranges[sample][0] * step
    top = other.focal_px * start[:2] - pixels * start[2]
    bottom = pixels * step[2] - other.focal_px * step[:2]
    return line, pixels, (top @ direction) / (bottom @ direction)


def box_around(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre of the points, and width of a panel that holds them with a margin."""
    low, high = points.min(axis=0), points.max(axis=0)
    height = HEIGHT - TITLE
    extent = max(high[0] - low[0], (high[1] - low[1]) * WIDTH / height)
    return (low + high) / 2, (1 + MARGIN) * extent


def photograph(
    chain: Chain, view: int, image_path: Path, shown: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """A panel with part of an image, and the (2, 3) affine map of image pixels to it."""
    center, width = box_around(shown)
    zoom = WIDTH / width
    middle = np.array([WIDTH, HEIGHT + TITLE]) / 2
    affine = np.hstack([zoom * np.eye(2), (middle - zoom * center)[:, None]])
    posed = chain.given.views[view]
    image = read_image(posed, image_path)
    moved = affine + np.hstack([np.zeros((2, 2)), zoom * np.full((2, 1), 0.5)])
    panel = cv2.warpAffine(image, moved, (WIDTH, HEIGHT), borderValue=WHITE)
    return 255 - (255 - panel) // 2, affine


def titled(panel: np.ndarray, title: str) -> np.ndarray:
    """The panel with a title above its content."""
    panel[:TITLE] = 255
    cv2.putText(panel, title, (0, 40), FONT, 1.05, BLACK, 2, cv2.LINE_AA)
    return panel


def draw_line(panel: np.ndarray, points: np.ndarray, color: tuple[int, ...], width: int) -> None:
    """Draw a polyline of (N, 2) pixels of the panel."""
    fixed = np.rint(16 * points[np.isfinite(points).all(axis=1)]).astype(np.int32)
    cv2.polylines(panel, [fixed], False, color, width, cv2.LINE_AA, 4)


def draw_dots(panel: np.ndarray, points: np.ndarray, color: tuple[int, ...], radius: int) -> None:
    """Draw dots at (N, 2) pixels of the panel, below its title."""
    for x, y in np.rint(points[points[:, 1] > TITLE]).astype(int).tolist():
        cv2.circle(panel, (x, y), radius, color, -1, cv2.LINE_AA)


def reference_panel(chain: Chain, image_path: Path) -> np.ndarray:
    """The reference image with the chain, its samples and the chosen sample."""
    view = chain.given.views[chain.view]
    points, samples = (view.image_from_undistorted(x) for x in (chain.points, chain.pixels))
    title = f"{Path(view.name).stem}: samples on a chain"
    panel, affine = photograph(chain, chain.view, image_path, points)
    points, samples = (x @ affine[:, :2].T + affine[:, 2] for x in (points, samples))
    draw_line(panel, points, BLUE, 4)
    draw_dots(panel, samples, BLUE, 9)
    draw_dots(panel, samples[chain.chosen][None], ORANGE, 15)
    return titled(panel, title)


def neighbor_panel(chain: Chain, image_path: Path) -> np.ndarray:
    """A neighbouring image with its chains, the epipolar line and its intersections."""
    view, graph = chain.given.views[chain.neighbor], chain.given.graph(chain.neighbor)
    line, pixels, _ = hypotheses(chain, chain.chosen, chain.neighbor)
    ends = view.image_from_undistorted(line)
    title = f"{Path(view.name).stem}: epipolar line of one sample"
    panel, affine = photograph(chain, chain.neighbor, image_path, ends)
    for points in np.split(graph.undistorted, graph.polyline_offsets[1:-1]):
        drawn = view.image_from_undistorted(points) @ affine[:, :2].T + affine[:, 2]
        draw_line(panel, drawn, BLUE, 3)
    draw_line(panel, ends @ affine[:, :2].T + affine[:, 2], ORANGE, 4)
    found = view.image_from_undistorted(pixels) @ affine[:, :2].T + affine[:, 2]
    draw_dots(panel, found, BLACK, 11)
    return titled(panel, title)


def plot(chain: Chain) -> np.ndarray:
    """Hypotheses of all neighbours over the samples, and the selected inverse depths."""
    panel = titled(np.full((HEIGHT, WIDTH, 3), 255, np.uint8), "hypotheses of all neighbours")
    left, right, top, bottom = 70, WIDTH - 20, TITLE + 10, HEIGHT - 60
    low, high = chain.ranges[:, 0].min(), chain.ranges[:, 1].max()

    def at(samples: np.ndarray, inverse_depths: np.ndarray) -> np.ndarray:
        x = left + (right - left) * (samples + 0.5) / len(chain.pixels)
        y = bottom - (bottom - top) * (inverse_depths - low) / (high - low)
        return np.stack([x, y], axis=1)

    cv2.rectangle(panel, (left, top), (right, bottom), GRAY, 2)
    for sample in range(len(chain.pixels)):
        for neighbor in chain.given.neighbors[chain.view].tolist():
            _, _, found = hypotheses(chain, sample, neighbor)
            draw_dots(panel, at(np.full(len(found), sample), found), BLACK, 4)
    found = np.flatnonzero(chain.inverse_depths > 0)
    selected = at(found, chain.inverse_depths[found])
    draw_line(panel, selected, ORANGE, 4)
    draw_dots(panel, selected, ORANGE, 8)
    cv2.putText(panel, "position on the chain", (left, HEIGHT - 16), FONT, 1, BLACK, 2, cv2.LINE_AA)
    label = np.full((50, bottom - top, 3), 255, np.uint8)
    cv2.putText(label, "inverse depth", (0, 34), FONT, 1, BLACK, 2, cv2.LINE_AA)
    panel[top:bottom, 8:58] = cv2.rotate(label, cv2.ROTATE_90_COUNTERCLOCKWISE)
    return panel


if __name__ == "__main__":
    main()
