"""Image file -> 2D edge graph: the work on one image, unless an earlier run has done it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from colmap_edges.core.arrays import BoolArray, ByteArray, FloatArray, Picture
from colmap_edges.core.view import View
from colmap_edges.edges2d.detection import Chains, detect_chains
from colmap_edges.edges2d.edge_graph import EdgeGraph, build_edge_graph
from colmap_edges.edges2d.edge_maps import pixel_chains_of
from colmap_edges.edges2d.masking import outside_mask
from colmap_edges.errors import ColmapEdgesError, ImageError
from colmap_edges.images.background import (
    NO_BACKGROUND_MASK,
    BackgroundMask,
    masked_background,
    plain_background,
)
from colmap_edges.images.edge_maps import EdgeMapFile, decode_edge_map, read_edge_map
from colmap_edges.images.files import colors_at, decode_image, gray_of, path_of_image, read_bytes
from colmap_edges.images.masks import MaskFile, decode_mask, read_mask
from colmap_edges.options import DetectionOptions, EdgeGraphOptions
from colmap_edges.runtime.cache import Arrays, Cache, key_of

KIND = "edge_graphs"  # of cache entries
NO_CHAINS = Chains(
    points=np.zeros((0, 2)),
    normals=np.zeros((0, 2)),
    sides=np.zeros((0, 2), np.uint8),
    offsets=np.zeros(1, np.int64),
)


@dataclass(frozen=True, kw_only=True)
class DetectedEdges:
    """What was detected in one image.

    Attributes:
        graph: the 2D edge graph.
        dropped: (K, 2) points of chains that are not in the graph, image pixels.
        num_chains: chains of the detector, before they are joined.
        num_chain_pixels: their points.
        background_mask: the plain backdrop, where the image has one.
    """

    graph: EdgeGraph
    dropped: FloatArray
    num_chains: int
    num_chain_pixels: int
    background_mask: BackgroundMask = NO_BACKGROUND_MASK


class Visitor(Protocol):
    """Makes something of every image while it is at hand."""

    def visit(
        self, index: int, view: View, read: Callable[[], Picture], found: DetectedEdges
    ) -> Any:
        """Look at an image, which `read` gives, wherever it is worked on; give back what to keep.

        Args:
            index: place of the view among the model's.
            view: the view.
            read: gives the (H, W, 3) image; it may have to be decoded first.
            found: its edges.
        """

    def collect(self, index: int, kept: Any) -> None:
        """Take what `visit` gave back, in the process that started the work."""


@dataclass(frozen=True)
class Visitors:
    """Several visitors as one."""

    visitors: tuple[Visitor, ...]

    @classmethod
    def of(cls, *visitors: Visitor | None) -> Visitor | None:
        """Those that there are; the one itself if it is alone."""
        found = tuple(visitor for visitor in visitors if visitor is not None)
        return cls(found) if len(found) > 1 else next(iter(found), None)

    def visit(
        self, index: int, view: View, read: Callable[[], Picture], found: DetectedEdges
    ) -> list[Any]:
        """Have all look at an image, which is decoded at most once for each."""
        return [visitor.visit(index, view, read, found) for visitor in self.visitors]

    def collect(self, index: int, kept: list[Any]) -> None:
        """Have each take what it gave back."""
        for visitor, own in zip(self.visitors, kept, strict=True):
            visitor.collect(index, own)


@dataclass(frozen=True, kw_only=True)
class ImageWork:
    """What is to be done with every image.

    Attributes:
        image_path: folder of the images.
        detection: options of the detector.
        edge_graph: options of the edge graph.
        mask_path: folder of masks, or one for all images; none without it.
        edge_path: folder of edge images of another detector; none without it.
        masks_are_background: whether the background is what masks hide, not a plain backdrop.
        cache: graphs of earlier runs, if they are kept.
        visitor: looks at every image that can be read.
    """

    image_path: Path
    detection: DetectionOptions
    edge_graph: EdgeGraphOptions
    mask_path: Path | None = None
    edge_path: Path | None = None
    masks_are_background: bool = False
    cache: Cache | None = None
    visitor: Visitor | None = None


@dataclass(frozen=True, kw_only=True)
class ImageCounts:
    """How much was detected in one image."""

    chains: int
    chain_pixels: int
    polylines: int
    closed_polylines: int
    edge_pixels: int


@dataclass(frozen=True, kw_only=True)
class ImageRecord:
    """What is said of one image when it is done.

    Attributes:
        counts: how much was detected.
        key: key of its graph in the cache; empty without a cache.
        masked: whether it has a mask.
        reused: whether its graph was there.
        background_mask: what the image shows of the background.
        damage: why the image could not be read; none when it could.
        visited: what the visitor gave back.
    """

    counts: ImageCounts
    key: str = ""
    masked: bool = False
    reused: bool = False
    background_mask: BackgroundMask = NO_BACKGROUND_MASK
    damage: ImageError | None = field(default=None)
    visited: Any = None


def work_on_image(work: ImageWork, index: int, view: View) -> tuple[EdgeGraph, ImageRecord]:
    """Find the edge graph of a view, in the cache or in its image; empty when that is damaged.

    Raises:
        ColmapEdgesError: when the image, its mask or its edge image is not of its camera's size, or
            one of the latter cannot be read.
    """
    try:
        return graph_of_image(work, index, view)
    except ImageError as error:
        graph, dropped = build_edge_graph(NO_CHAINS, view, work.edge_graph)
        key = graph_key(np.zeros(0, np.uint8), None, None, view, work) if work.cache else ""
        found = DetectedEdges(graph=graph, dropped=dropped, num_chains=0, num_chain_pixels=0)
        if work.cache:
            work.cache.save(KIND, key, arrays_of(found))
        return graph, ImageRecord(counts=counts_of(found), key=key, damage=error)


def work_in_cache(work: ImageWork, index: int, view: View) -> ImageRecord:
    """Like `work_on_image`, but leave the graph in the cache, for another process.

    Raises:
        ColmapEdgesError: when it cannot be written there.
    """
    _, record = work_on_image(work, index, view)
    if work.cache is None or not work.cache.path(KIND, record.key).is_file():
        raise ColmapEdgesError(f"the edge graph of {view.name} could not be written to the cache")
    return record


def graph_of_image(work: ImageWork, index: int, view: View) -> tuple[EdgeGraph, ImageRecord]:
    """Find the edge graph of a view whose image can be read."""
    path = path_of_image(work.image_path, view.name)
    data, mask = read_bytes(path), read_mask(work.mask_path, view.name)
    edge_map = read_edge_map(work.edge_path, view.name)
    key = graph_key(data, mask, edge_map, view, work) if work.cache else ""
    entry = work.cache.load(KIND, key) if work.cache else None
    usable = None
    if mask and (entry is None or work.masks_are_background):
        usable = decode_mask(mask, view)
    if entry is None:
        image = decode_image(data, path, view)
        found = detect_edges(image, usable, edge_map, view, work)
        if work.cache:
            work.cache.save(KIND, key, arrays_of(found))
    else:
        found = edges_from(entry)
    visited = None
    if work.visitor:

        def read() -> Picture:
            return image if entry is None else decode_image(data, path, view)

        visited = work.visitor.visit(index, view, read, found)
    background_mask = found.background_mask
    if work.masks_are_background:
        background_mask = NO_BACKGROUND_MASK if usable is None else masked_background(usable)
    record = ImageRecord(
        counts=counts_of(found),
        key=key,
        masked=mask is not None,
        reused=entry is not None,
        visited=visited,
        background_mask=background_mask,
    )
    return found.graph, record


def detect_edges(
    image: Picture,
    mask: BoolArray | None,
    edge_map: EdgeMapFile | None,
    view: View,
    work: ImageWork,
) -> DetectedEdges:
    """Detect the edges of one image, where its mask has them looked for; or take an edge image's.

    Raises:
        ColmapEdgesError: when the edge image cannot be decoded, or is not of its camera's size.
    """
    linked = None
    if edge_map:
        strengths, size = decode_edge_map(edge_map, view), (view.width, view.height)
        linked = pixel_chains_of(strengths, size, view.scale, work.detection.min_chain_points)
    chains = detect_chains(gray_of(image), work.detection, view.scale, linked)
    if mask is not None:
        chains = outside_mask(chains, mask, view.scale, work.detection.min_chain_points)
    graph, dropped = build_edge_graph(chains, view, work.edge_graph)
    return DetectedEdges(
        graph=replace(graph, colors=colors_at(image, graph.points)),
        dropped=dropped,
        num_chains=len(chains.offsets) - 1,
        num_chain_pixels=len(chains.points),
        background_mask=plain_background(image),
    )


def counts_of(found: DetectedEdges) -> ImageCounts:
    """How much was detected."""
    return ImageCounts(
        chains=found.num_chains,
        chain_pixels=found.num_chain_pixels,
        polylines=found.graph.num_polylines,
        closed_polylines=int(found.graph.closed.sum()),
        edge_pixels=len(found.graph.points),
    )


def graph_key(
    data: ByteArray,
    mask: MaskFile | None,
    edge_map: EdgeMapFile | None,
    view: View,
    work: ImageWork,
) -> str:
    """The key of the edge graph of an image file: all that the graph depends on."""
    camera = [view.camera.model.name, view.width, view.height, *map(float, view.camera.params)]
    files = [file.data if file else None for file in (mask, edge_map)]
    return key_of(data, *files, camera, view.scale, work.detection, work.edge_graph)


def arrays_of(found: DetectedEdges) -> Arrays:
    """What a cache entry holds of an image."""
    arrays = {entry.name: getattr(found.graph, entry.name) for entry in fields(EdgeGraph)}
    counts = np.array([found.num_chains, found.num_chain_pixels])
    arrays |= {"dropped": found.dropped, "num_chains_and_pixels": counts}
    return arrays | {
        f"background_mask_{name}": array for name, array in vars(found.background_mask).items()
    }


def edges_from(arrays: Arrays) -> DetectedEdges:
    """What `arrays_of` took apart."""
    num_chains, num_chain_pixels = arrays["num_chains_and_pixels"].tolist()
    return DetectedEdges(
        graph=EdgeGraph(**{entry.name: arrays[entry.name] for entry in fields(EdgeGraph)}),
        dropped=arrays["dropped"],
        num_chains=num_chains,
        num_chain_pixels=num_chain_pixels,
        background_mask=BackgroundMask(
            **{e.name: arrays[f"background_mask_{e.name}"] for e in fields(BackgroundMask)}
        ),
    )


def load_graph(cache: Cache, key: str) -> EdgeGraph:
    """The edge graph of a cache entry that must be there.

    Raises:
        ColmapEdgesError: when it is not, or is damaged.
    """
    entry = cache.load(KIND, key)
    if entry is None:
        raise ColmapEdgesError(
            f"{cache.path(KIND, key)} is gone or damaged; leave the cache alone while runs use it"
        )
    return edges_from(entry).graph
