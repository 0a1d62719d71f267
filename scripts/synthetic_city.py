#!/usr/bin/env python3
"""Reconstruct the 3D edges of a synthetic city of any size, and record the cost of each stage.

Buildings with windows and round domes stand on a grid; cameras are above it on a denser grid and
look in four directions. The city grows with the number of cameras, so that every camera sees about
the same number of curves. No image is rendered: edge graphs are projections of the front-facing
3D curves. Other flags are those of `colmap-edges reconstruct`.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

import click
import numpy as np
import pycolmap
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from colmap_edges.cli.flags import make_flags, names_of_stages, normalize, options_from_flags
from colmap_edges.colmap.appending import NewPoints, append_points
from colmap_edges.colmap.model import Model, load_model, observation_residuals
from colmap_edges.colmap.writing import write_model
from colmap_edges.core.arrays import offsets_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View
from colmap_edges.edges2d.detection import Chains
from colmap_edges.edges2d.edge_graph import build_edge_graph
from colmap_edges.edges2d.graphs import Graphs
from colmap_edges.edges3d.curves.fitting import fit_curves
from colmap_edges.export.edges_json import write_json
from colmap_edges.export.ply import write_ply
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.detect import Detection
from colmap_edges.pipeline.read import model_counts
from colmap_edges.pipeline.trace import trace_stage
from colmap_edges.runtime.executors import open_workers, run_all
from colmap_edges.runtime.memory import reuse_freed_memory
from colmap_edges.runtime.stages import Stages

FloatArray = NDArray[np.float64]  # not the package's: benchmark.py runs this with older packages

FOCAL_RATIO = 0.875  # focal length in widths of an image
FLIGHT_HEIGHT, FLIGHT_STEP, TILT = 2.4, 0.6, np.radians(25)  # in sides of a block
REACH = 2.2  # visible radius around a camera's target, in sides of a block
MARGIN = 3  # blocks around the cameras
MIN_CHAIN = 10  # points
TRACK_RATIO = 0.5  # share of the views seeing an SfM point that observe it
CURVE_NOISE_PX, POINT_NOISE_PX = 0.15, 0.05  # of a curve in a view as a whole, and of each point


@dataclass(frozen=True, kw_only=True)
class City:
    """The curves, points and cameras of a city.

    Attributes:
        curves: (C, 4, 3) of each curve o, a, u, v: o + t a + cos(2 pi t) u + sin(2 pi t) v.
        normals: (C, 2, 3) of the two faces that a curve borders.
        sides: (C, 2) uint8 intensity on the dark and the bright side, which is to its left.
        points: (N, 3) SfM points.
        point_normals: (N, 3) of their faces.
        poses: (V, 3, 4) cam_from_world.
        targets: (V, 2) ground points at which the cameras look.
        size: width and height of an image, pixels.
    """

    curves: FloatArray
    normals: FloatArray
    sides: NDArray[np.uint8]
    points: FloatArray
    point_normals: FloatArray
    poses: FloatArray
    targets: FloatArray
    size: tuple[int, int]

    @cached_property
    def places(self) -> cKDTree:
        """A search tree of the midpoints of the curves seen from above."""
        return cKDTree((self.curves[:, 0] + self.curves[:, 1] / 2)[:, :2])


def make_city(num_views: int, points_per_view: int, size: tuple[int, int], windows: int) -> City:
    """Make the city that `num_views` cameras fly over; `windows` a row and column of a wall."""
    rng = np.random.default_rng(0)
    side = int(np.ceil(np.sqrt(num_views)))
    blocks = np.arange(-MARGIN, int(np.ceil(side * FLIGHT_STEP)) + MARGIN)
    walls, curves, normals = [], [], []
    for x in blocks:
        for y in blocks:
            faces = building(np.array([x, y, 0.0]), rng)
            walls += faces
            for face in faces:
                drawn, fronts = face_curves(face, faces, windows)
                curves += drawn
                normals += fronts
    dark = rng.integers(10, 120, len(curves))
    sides = np.column_stack([dark, dark + rng.integers(30, 120, len(curves))])
    poses, targets = flight(num_views, side, rng)
    low, high = targets.min(axis=0) - 0.5, targets.max(axis=0) + 0.5
    seen = [w for w in walls if (w[0, :2] > low).all() and (w[0, :2] < high).all()]
    points, point_normals = points_on(seen, num_views * points_per_view, rng)
    return City(
        curves=np.array(curves),
        normals=np.array(normals),
        sides=sides.astype(np.uint8),
        points=points,
        point_normals=point_normals,
        poses=poses,
        targets=targets,
        size=size,
    )


def building(corner: FloatArray, rng: np.random.Generator) -> list[FloatArray]:
    """Four walls and the roof of a building: corners (4, 3), counter-clockwise from outside."""
    low, high = rng.uniform(0.1, 0.3, 2), rng.uniform(0.6, 0.9, 2)
    outline = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    base = corner + np.column_stack([outline, np.zeros(4)])
    top = base + np.array([0, 0, rng.uniform(0.2, 1.0)])
    walls = [np.array([base[i], base[j], top[j], top[i]]) for i, j in pairwise([0, 1, 2, 3, 0])]
    return [*walls, top]


def face_curves(
    face: FloatArray, faces: list[FloatArray], windows: int
) -> tuple[list[Any], list[Any]]:
    """Curves of one face with the normals of the faces they border.

    A wall has its left edge and its windows, a roof its outline and two circles.
    """
    curves, fronts = [], []
    normal = face_normal(face)
    u, v = face[1] - face[0], face[3] - face[0]
    if normal[2] > 0.5:
        for wall, a, b in zip(faces, face, np.roll(face, -1, axis=0), strict=False):
            curves.append(straight(a, b))
            fronts.append((normal, face_normal(wall)))
        radius = 0.2 * min(np.linalg.norm(u), np.linalg.norm(v))
        across = (radius * u / np.linalg.norm(u), radius * v / np.linalg.norm(v))
        for at in (0.3, 0.7):
            curves.append(np.array([face[0] + at * u + 0.5 * v, 0 * u, *across]))
            fronts.append((normal, normal))
        return curves, fronts
    curves.append(straight(face[0], face[3]))
    fronts.append((normal, face_normal_before(face, faces)))
    step = 0.9 / windows
    for column in 0.15 + step * np.arange(windows):
        for row in 0.15 + step * np.arange(windows):
            corners = ((0, 0), (step / 1.8, 0), (step / 1.8, step / 1.8), (0, step / 1.8))
            window = [face[0] + (column + a) * u + (row + b) * v for a, b in corners]
            curves += [straight(a, b) for a, b in pairwise([*window, window[0]])]
            fronts += [(normal, normal)] * 4
    return curves, fronts


def straight(a: FloatArray, b: FloatArray) -> FloatArray:
    """The straight curve from a to b."""
    return np.array([a, b - a, 0 * a, 0 * a])


def face_normal(face: FloatArray) -> FloatArray:
    """(3,) unit normal of a face, outward."""
    normal = np.cross(face[1] - face[0], face[3] - face[0])
    return np.asarray(normal / np.linalg.norm(normal))


def face_normal_before(face: FloatArray, faces: list[FloatArray]) -> FloatArray:
    """(3,) normal of the wall whose right edge is the left edge of `face`."""
    return next(face_normal(wall) for wall in faces[:4] if np.allclose(wall[1], face[0]))


def points_on(
    faces: list[FloatArray], count: int, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """(N, 3) random points on faces, evenly by area, and (N, 3) their normals."""
    corners = np.array(faces)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    across = np.cross(u, v)
    areas = np.linalg.norm(across, axis=1)
    chosen = np.sort(rng.choice(len(faces), count, p=areas / areas.sum()))
    a, b = rng.random((2, count, 1))
    points = corners[chosen, 0] + a * u[chosen] + b * v[chosen]
    return points, (across / areas[:, None])[chosen]


def flight(num_views: int, side: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Poses (V, 3, 4) on a grid, looking in four directions, and (V, 2) points in their centres."""
    poses, targets = [], []
    for index in range(num_views):
        row, column = divmod(index, side)
        heading = np.pi / 2 * ((row + 2 * (column % 2) + column // 2) % 4) + rng.normal(0, 0.05)
        ahead = np.array([np.cos(heading), np.sin(heading)])
        center = np.array([column * FLIGHT_STEP, row * FLIGHT_STEP, FLIGHT_HEIGHT])
        center += rng.normal(0, 0.05, 3)
        forward = np.array([*(np.sin(TILT) * ahead), -np.cos(TILT)])
        right = np.array([ahead[1], -ahead[0], 0])
        rotation = np.array([right, np.cross(forward, right), forward])
        poses.append(np.column_stack([rotation, -rotation @ center]))
        targets.append(center[:2] + FLIGHT_HEIGHT * np.tan(TILT) * ahead)
    return np.array(poses), np.array(targets)


def without_points(poses: FloatArray, size: tuple[int, int]) -> Any:
    """A pycolmap.Reconstruction of images of one camera with (V, 3, 4) poses."""
    empty = pycolmap.Reconstruction()
    camera = pycolmap.Camera.create_from_model_name(
        1, "SIMPLE_PINHOLE", FOCAL_RATIO * size[0], *size
    )
    empty.add_camera_with_trivial_rig(camera)
    for index, pose in enumerate(poses):
        image = pycolmap.Image(f"view_{index:05d}.png", [], 1, index + 1)
        empty.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose))
    return empty


def write_city(city: City, folder: Path) -> None:
    """Write the model with its SfM points, binary."""
    empty = without_points(city.poses, city.size)
    camera = empty.cameras[1]
    folder.mkdir(parents=True, exist_ok=True)
    empty.write_binary(str(folder))
    owners, images, pixels = observations(city, camera)
    counts = np.bincount(owners, minlength=len(city.points))
    kept = counts >= 2
    rows = kept[owners]
    order = np.argsort(owners[rows], kind="stable")
    append_points(
        folder,
        NewPoints(
            ids=np.arange(1, kept.sum() + 1),
            xyz=city.points[kept],
            rgb=np.full((kept.sum(), 3), 128, np.uint8),
            errors=np.full(kept.sum(), 0.5),
            track_offsets=offsets_of(counts[kept]),
            track_image_ids=images[rows][order],
            track_points2D=pixels[rows][order],
        ),
    )


def observations(
    city: City, camera: Any
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """The (T,) points, (T,) image ids and (T, 2) pixels of all observations of SfM points."""
    tree = cKDTree(city.points[:, :2])
    owners, images, pixels = [], [], []
    for index, pose in enumerate(city.poses):
        rng = np.random.default_rng([0, index])
        near = np.sort(tree.query_ball_point(city.targets[index], REACH))
        near = near[rng.random(len(near)) < TRACK_RATIO].astype(np.int64)
        rotation, translation = pose[:, :3], pose[:, 3]
        toward = -rotation.T @ translation - city.points[near]
        near = near[np.einsum("ij,ij->i", toward, city.point_normals[near]) > 0]
        seen = np.asarray(camera.img_from_cam(city.points[near] @ rotation.T + translation))
        inside = (seen > 0).all(axis=1) & (seen < city.size).all(axis=1)
        owners.append(near[inside])
        images.append(np.full(inside.sum(), index + 1))
        pixels.append(seen[inside] + rng.normal(0, 0.5, (inside.sum(), 2)))
    return np.concatenate(owners), np.concatenate(images), np.concatenate(pixels)


def see_city(city: City, view: View) -> Chains:
    """The chains of a view: its front-facing curves, one point per pixel."""
    index = view.image_id - 1
    rng = np.random.default_rng([0, index])
    near = np.sort(city.places.query_ball_point(city.targets[index], REACH)).astype(np.int64)
    middles = city.curves[near, 0] + city.curves[near, 1] / 2
    facing = np.einsum("cfk,ck->cf", city.normals[near], view.center - middles) > 0
    near = near[facing.any(axis=1)]
    pieces = np.array([view.project(curve_at(city.curves[near], t))[0] for t in EIGHTHS])
    lengths = np.linalg.norm(np.diff(pieces, axis=0), axis=2).sum(axis=0)
    counts = np.ceil(lengths).astype(np.int64) + 1
    own = np.repeat(np.arange(len(near)), counts)
    rank = np.arange(len(own)) - np.repeat(np.cumsum(counts) - counts, counts)
    t = rank / counts[own]
    points = view.project(curve_at(city.curves[near[own]], t))[0]
    tangents = view.project(curve_at(city.curves[near[own]], t + 1e-4))[0] - points
    left = np.column_stack([tangents[:, 1], -tangents[:, 0]])
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    noise = rng.normal(0, CURVE_NOISE_PX, len(near))[own]
    points += (noise + rng.normal(0, POINT_NOISE_PX, len(own)))[:, None] * left
    gray = city.sides[near[own]] + rng.integers(-3, 4, (len(own), 2))
    inside = (points > 2).all(axis=1) & (points < np.array(city.size) - 2).all(axis=1)
    broken = np.ones(len(own), bool)
    broken[1:] = (own[1:] != own[:-1]) | (inside[1:] != inside[:-1])
    runs = np.cumsum(broken) - 1
    kept = inside & (np.bincount(runs)[runs] >= MIN_CHAIN)
    return Chains(
        points=points[kept],
        normals=left[kept],
        sides=np.clip(gray[kept], 0, 255).astype(np.uint8),
        offsets=offsets_of(np.unique(runs[kept], return_counts=True)[1]),
    )


EIGHTHS = np.linspace(0, 1, 9)


def curve_at(curves: FloatArray, t: FloatArray | float) -> FloatArray:
    """(C, 3) points of (C, 4, 3) curves at (C,) parameters."""
    t = np.broadcast_to(t, len(curves))
    weights = [np.ones(len(t)), t, np.cos(2 * np.pi * t), np.sin(2 * np.pi * t)]
    return np.asarray(np.einsum("wc,cwk->ck", weights, curves))


def reconstruct_city(city: City, folder: Path, options: PipelineOptions) -> Stages:
    """Run the stages on a city whose model is in `folder`."""
    stages = Stages()
    with stages.stage("read") as stage:
        model = load_model(folder / "input")
        stage.counts = model_counts(model)
    with stages.stage("make edge graphs") as stage:
        graphs, num_pixels = make_graphs(city, model, options)
        stage.counts = {"edge_pixels": num_pixels}
    edges = trace_stage(model, Detection(graphs=graphs), options, stages)[1].edges
    with stages.stage("write") as stage:
        write_results(model, edges, folder)
    return stages


def make_graphs(city: City, model: Model, options: PipelineOptions) -> tuple[Graphs, int]:
    """The edge graph of each view of the city, and the number of their pixels."""
    graphs = Graphs(options.max_graph_memory_gb * 1e9 / 2)

    def make(index: int) -> int:
        view = model.views[index]
        graph, _ = build_edge_graph(see_city(city, view), view, options.edge_graph)
        graphs.put(index, graph)
        return len(graph.points)

    with open_workers(options) as workers:
        return graphs, sum(run_all(workers.images, ((make, (v,)) for v in range(len(model.views)))))


def write_results(model: Model, edges: Edges3D, folder: Path) -> None:
    """Write the model with edge points, and the edges as PLY and JSON."""
    ids = write_model(model, edges, folder / "sparse")
    write_ply(edges, folder / "edges.ply")
    residuals = observation_residuals(model, edges)
    write_json(edges, fit_curves(edges), model, ids, residuals, folder / "edges.json")


def parse_options(flags: list[str]) -> PipelineOptions:
    """Options from the flags of `colmap-edges reconstruct`."""
    command = click.Command(
        "reconstruct",
        params=[*make_flags(names_of_stages("detect", "trace", "write"))],
        context_settings={"token_normalize_func": normalize},
    )
    return options_from_flags(command.make_context("reconstruct", flags).params)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--num_views", type=int, required=True)
    parser.add_argument("--points_per_view", type=int, default=650)
    parser.add_argument("--size", type=int, nargs=2, default=(800, 600), help="size of the images")
    parser.add_argument("--windows", type=int, default=2, help="windows per side of a wall")
    parser.add_argument("--folder", type=Path, help="folder in which model and results are kept")
    parser.add_argument("--only_write", action="store_true", help="only write the model")
    parser.add_argument("--report", type=Path, help="JSON file to write; default: print")
    arguments, flags = parser.parse_known_args()
    reuse_freed_memory()  # as the command line does
    try:
        options = parse_options(flags)
    except click.ClickException as error:
        sys.exit(f"error: {error.format_message()}")
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or Path(temporary)
        look = (tuple(arguments.size), arguments.windows)
        if not (folder / "input").is_dir():
            city = make_city(arguments.num_views, arguments.points_per_view, *look)
            write_city(city, folder / "input")
        if arguments.only_write:
            return
        city = make_city(arguments.num_views, 0, *look)  # the model's points are in its files
        stages = reconstruct_city(city, folder, options)
    text = json.dumps({"stages": stages.records()}, indent=2, default=str) + "\n"
    if arguments.report:
        arguments.report.write_text(text, encoding="utf-8")
    else:
        print(text, end="")


if __name__ == "__main__":
    main()
