"""The detection stage: the 2D edge graph of every view."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from io import BytesIO
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray
from colmap_edges.core.view import View
from colmap_edges.edges2d.graphs import CacheBackend, Graphs
from colmap_edges.edges2d.image_graphs import (
    DetectedEdges,
    ImageCounts,
    ImageRecord,
    ImageWork,
    Visitor,
    work_in_cache,
    work_on_image,
)
from colmap_edges.edges2d.topology import topology_of
from colmap_edges.errors import ColmapEdgesError, ImageError
from colmap_edges.images.background import BackgroundMask
from colmap_edges.images.files import encoded, path_of_image, single_threaded_opencv
from colmap_edges.options import EdgeGraphOptions, PipelineOptions
from colmap_edges.report.overlay import draw_edge_graph
from colmap_edges.runtime.executors import Workers, open_workers, run_all
from colmap_edges.runtime.output import write_whole
from colmap_edges.runtime.stages import Stage, Stages

logger = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class Detection:
    """The edges detected in the images of all views.

    Attributes:
        graphs: the 2D edge graph of each view.
        keys: (V,) keys of the graphs in the cache; empty without a cache.
        background_masks: (V,) the background in each image.
    """

    graphs: Graphs
    keys: tuple[str, ...] = ()
    background_masks: tuple[BackgroundMask, ...] = ()


def detect_stage(
    model: Model,
    image_path: Path,
    options: PipelineOptions,
    stages: Stages,
    visitor: Visitor | None = None,
    workers: Workers | None = None,
    mask_path: Path | None = None,
    edge_path: Path | None = None,
) -> Detection:
    """Detect the 2D edge graph of every view, in the views' order.

    Each thread holds one image in memory. Damaged images get an empty graph and are counted. Graphs
    beyond the memory limit are kept on disk.

    Raises:
        ColmapEdgesError: if fewer than two images can be read.
    """
    if workers is None:
        with open_workers(options) as workers:
            return detect_stage(
                model, image_path, options, stages, visitor, workers, mask_path, edge_path
            )
    work = ImageWork(
        image_path=image_path,
        detection=options.detection,
        edge_graph=options.edge_graph,
        mask_path=mask_path,
        edge_path=edge_path,
        masks_are_background=options.masks_are_background,
        cache=workers.cache,
        visitor=visitor,
    )
    with stages.stage("detect", len(model.views)) as stage, single_threaded_opencv():
        graphs, records = find_graphs(work, model.views, options, workers, stage)
        damaged = {i: r.damage for i, r in enumerate(records) if r.damage}
        report_damaged(damaged, len(records))
        names = [model.views[index].name for index in damaged]
        stage.counts = detection_counts([record.counts for record in records], names)
        stage.counts["image_scale"] = model.scale
        masked = sum(record.masked for record in records)
        if mask_path or masked:
            stage.counts["images_masked"] = masked
        if edge_path:
            stage.counts["edge_images"] = len(records) - len(damaged)
        if workers.cache:
            stage.counts["images_reused"] = sum(record.reused for record in records)
    return Detection(
        graphs=graphs,
        keys=tuple(record.key for record in records if record.key),
        background_masks=tuple(record.background_mask for record in records),
    )


def find_graphs(
    work: ImageWork,
    views: Sequence[View],
    options: PipelineOptions,
    workers: Workers,
    stage: Stage,
) -> tuple[Graphs, list[ImageRecord]]:
    """Process every image; returns the graphs and the records of the images."""
    # Tracing also holds the search indices, which take as much memory again.
    max_bytes = options.max_graph_memory_gb * 1e9 / 2
    if workers.remote and workers.cache:
        calls = [(work_in_cache, (work, i, view)) for i, view in enumerate(views)]
        records = run_all(workers.images, calls, stage.advance, workers.check)
        keys = {i: record.key for i, record in enumerate(records)}
        graphs = Graphs(max_bytes, CacheBackend(workers.cache, keys))
    else:
        graphs = Graphs(max_bytes)

        def put(index: int, view: View) -> ImageRecord:
            graph, record = work_on_image(work, index, view)
            graphs.put(index, graph)
            return record

        records = run_all(workers.images, ((put, pair) for pair in enumerate(views)), stage.advance)
    for index, record in enumerate(records):
        if work.visitor and record.visited is not None:
            work.visitor.collect(index, record.visited)
    return graphs, records


def detection_counts(found: Sequence[ImageCounts], damaged: list[str]) -> dict[str, Any]:
    """Counts of detection.

    Args:
        found: the counts of each image.
        damaged: names of the images that could not be read.
    """
    return {
        "images": len(found),
        "images_damaged": len(damaged),
        "images_without_edges": sum(image.edge_pixels == 0 for image in found) - len(damaged),
        **{entry.name: sum(getattr(i, entry.name) for i in found) for entry in fields(ImageCounts)},
        "damaged": damaged,
    }


def report_damaged(damaged: Mapping[int, ImageError], num_images: int) -> None:
    """Log unreadable images; raise an error if fewer than two are readable."""
    errors = [damaged[index] for index in sorted(damaged)]
    if errors and num_images - len(errors) < 2:
        raise ColmapEdgesError(f"{errors[0]} ({len(errors)} of {num_images} images are unreadable)")
    for error in errors:
        logger.warning("%s; it is left out", error)


@dataclass(frozen=True)
class GraphWriter:
    """Writes each view's edge graph as .npz and overlay PNG into a folder."""

    folder: Path
    options: EdgeGraphOptions

    def visit(
        self,
        _index: int,
        view: View,
        read: Callable[[], Any],
        found: DetectedEdges,
        _usable: BoolArray | None,
    ) -> None:
        """Write the files of a view."""
        arrays = path_of_image(self.folder / "edge_graphs", view.name + ".npz")
        picture = path_of_image(self.folder / "overlays", view.name + ".png")
        for path in (arrays, picture):
            path.parent.mkdir(parents=True, exist_ok=True)
        packed = BytesIO()  # np.savez raises again on deletion if the disk is full
        topology = topology_of(found.graph, view, self.options)
        np.savez(packed, **vars(found.graph), **vars(topology))
        overlay = encoded(".png", draw_edge_graph(read(), found.graph, topology))
        write_whole(arrays, packed.getvalue(), "edge graph")
        write_whole(picture, overlay, "overlay")

    def collect(self, index: int, kept: None) -> None:
        """Do nothing."""


def check_file_names(views: Sequence[View]) -> None:
    """Check that no output file of an image has the name of the folder of others.

    Raises:
        ColmapEdgesError: naming two images whose files collide.
    """
    names = {PurePosixPath(view.name + ".npz"): view.name for view in views}
    for path, name in names.items():
        inside = next((names[parent] for parent in path.parents if parent in names), None)
        if inside:
            raise ColmapEdgesError(
                f"the folder of image {name} has the name of the output file of image {inside}; "
                "rename one"
            )
