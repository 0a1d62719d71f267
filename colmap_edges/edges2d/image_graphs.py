"""The 2D edge graph of an image file, detected or loaded from the cache."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    FloatArray,
    IntArray,
    Picture,
    flattened,
    unflattened,
)
from colmap_edges.core.checks import (
    MAX_COORDINATE,
    check_array,
    check_arrays,
    check_offsets,
    check_shape,
    check_values,
)
from colmap_edges.core.view import View
from colmap_edges.edges2d.block_borders import off_block_borders
from colmap_edges.edges2d.detection import Chains, detect_chains
from colmap_edges.edges2d.edge_graph import EdgeGraph, build_edge_graph
from colmap_edges.edges2d.edge_maps import pixel_chains_of
from colmap_edges.edges2d.masking import outside_mask, pieces_of
from colmap_edges.errors import ColmapEdgesError, ImageError
from colmap_edges.images.background import (
    NO_BACKGROUND_MASK,
    BackgroundMask,
    masked_background,
    plain_background,
)
from colmap_edges.images.edge_maps import decode_edge_map, read_edge_map
from colmap_edges.images.files import (
    CompanionFile,
    alpha_of,
    colors_at,
    decode_image,
    gray_of,
    path_of_image,
    read_bytes,
)
from colmap_edges.images.masks import read_mask, usable_pixels
from colmap_edges.options import DetectionOptions, EdgeGraphOptions
from colmap_edges.runtime.cache import Arrays, Cache, key_of

KIND = "edge_graphs"  # kind of the cache entries
NO_CHAINS = Chains(
    points=np.zeros((0, 2)),
    normals=np.zeros((0, 2)),
    sides=np.zeros((0, 2), np.uint8),
    offsets=np.zeros(1, np.int64),
)


@dataclass(frozen=True, kw_only=True)
class DetectedEdges:
    """The edges detected in one image.

    Attributes:
        graph: the 2D edge graph.
        dropped: (K, 2) points of chains that are not in the graph, image pixels.
        num_chains: number of detected chains, before joining.
        num_chain_pixels: number of their points.
        background_mask: the plain backdrop, if the image has one.
    """

    graph: EdgeGraph
    dropped: FloatArray
    num_chains: int
    num_chain_pixels: int
    background_mask: BackgroundMask = NO_BACKGROUND_MASK


class Visitor(Protocol):
    """Computes a value from every image while it is in memory."""

    def visit(
        self,
        index: int,
        view: View,
        read: Callable[[], Picture],
        found: DetectedEdges,
        usable: BoolArray | None,
    ) -> Any:
        """Compute the value of an image, in the process that works on it.

        Args:
            index: index of the view in the model.
            view: the view.
            read: returns the (H, W, 3) image, decoding it if necessary.
            found: its edges.
            usable: (H, W) false where it is masked or transparent; None without a mask.
        """

    def collect(self, index: int, kept: Any) -> None:
        """Receive the value returned by `visit`, in the main process."""


@dataclass(frozen=True)
class Visitors:
    """Several visitors combined."""

    visitors: tuple[Visitor, ...]

    @classmethod
    def of(cls, *visitors: Visitor | None) -> Visitor | None:
        """The combination of the given visitors; a single visitor itself; None without any."""
        found = tuple(visitor for visitor in visitors if visitor is not None)
        return cls(found) if len(found) > 1 else next(iter(found), None)

    def visit(
        self,
        index: int,
        view: View,
        read: Callable[[], Picture],
        found: DetectedEdges,
        usable: BoolArray | None,
    ) -> list[Any]:
        """Call all visitors; the image is decoded at most once."""
        return [visitor.visit(index, view, read, found, usable) for visitor in self.visitors]

    def collect(self, index: int, kept: list[Any]) -> None:
        """Pass to each visitor its value."""
        for visitor, own in zip(self.visitors, kept, strict=True):
            visitor.collect(index, own)


@dataclass(frozen=True, kw_only=True)
class ImageWork:
    """Parameters of the work on every image.

    Attributes:
        image_path: folder of the images.
        detection: options of the detector.
        edge_graph: options of the edge graph.
        mask_path: folder of masks, or one mask for all images; or None.
        edge_path: folder of edge images of another detector, or None.
        masks_are_background: whether masked pixels are the background, not a plain backdrop.
        cache: cache of earlier graphs, or None.
        visitor: called for every readable image, or None.
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
    """Numbers of detected items in one image."""

    chains: int
    chain_pixels: int
    polylines: int
    closed_polylines: int
    edge_pixels: int


@dataclass(frozen=True, kw_only=True)
class ImageRecord:
    """The record of the work on one image.

    Attributes:
        counts: numbers of detected items.
        key: key of its graph in the cache; empty without a cache.
        masked: whether it has a mask or transparent pixels.
        reused: whether its graph was in the cache.
        background_mask: the background in the image.
        damage: why the image could not be read, or None.
        visited: value returned by the visitor.
    """

    counts: ImageCounts
    key: str = ""
    masked: bool = False
    reused: bool = False
    background_mask: BackgroundMask = NO_BACKGROUND_MASK
    damage: ImageError | None = field(default=None)
    visited: Any = None


def work_on_image(work: ImageWork, index: int, view: View) -> tuple[EdgeGraph, ImageRecord]:
    """Load or detect the edge graph of a view; empty if the image is damaged.

    Raises:
        ColmapEdgesError: if the image, its mask or its edge image does not have its camera's size,
            or one of the latter cannot be read.
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
    """Like `work_on_image`, but leave the graph in the cache for other processes.

    Raises:
        ColmapEdgesError: if it cannot be written there.
    """
    _, record = work_on_image(work, index, view)
    if work.cache is None or not work.cache.path(KIND, record.key).is_file():
        raise ColmapEdgesError(
            f"the edge graph of {view.name} could not be written to the cache; free space there"
        )
    return record


def graph_of_image(work: ImageWork, index: int, view: View) -> tuple[EdgeGraph, ImageRecord]:
    """Load or detect the edge graph of a view with a readable image."""
    path = path_of_image(work.image_path, view.name)
    data, mask = read_bytes(path), read_mask(work.mask_path, view.name)
    edge_map = read_edge_map(work.edge_path, view.name)
    key = graph_key(data, mask, edge_map, view, work) if work.cache else ""
    kept = work.cache.load(KIND, key, lambda a: edges_from(a, view)) if work.cache else None
    alpha = alpha_of(data)
    if kept is None:
        image = decode_image(data, path, view)
    usable = None
    if (mask or alpha is not None) and (kept is None or work.visitor or work.masks_are_background):
        usable = usable_pixels(mask, alpha, view)
    if kept is None:
        found = detect_edges(image, data, usable, edge_map, view, work)
        if work.cache:
            work.cache.save(KIND, key, arrays_of(found))
    else:
        found = kept
    visited = None
    if work.visitor:

        def read() -> Picture:
            return image if kept is None else decode_image(data, path, view)

        visited = work.visitor.visit(index, view, read, found, usable)
    background_mask = found.background_mask
    if work.masks_are_background:
        background_mask = NO_BACKGROUND_MASK if usable is None else masked_background(usable)
    record = ImageRecord(
        counts=counts_of(found),
        key=key,
        masked=mask is not None or alpha is not None,
        reused=kept is not None,
        visited=visited,
        background_mask=background_mask,
    )
    return found.graph, record


def detect_edges(
    image: Picture,
    data: ByteArray,
    mask: BoolArray | None,
    edge_map: CompanionFile | None,
    view: View,
    work: ImageWork,
) -> DetectedEdges:
    """Detect the edges of one image outside its mask, or take them from its edge image.

    Steps of quantisation in a strongly compressed image, of bytes `data`, are left out.

    Raises:
        ColmapEdgesError: if the edge image cannot be decoded, or does not have its camera's size.
    """
    linked = None
    if edge_map:
        strengths, size = decode_edge_map(edge_map, view), (view.width, view.height)
        linked = pixel_chains_of(strengths, size, view.scale, work.detection.min_chain_points)
    chains = detect_chains(gray_of(image), work.detection, view.scale, linked)
    off_borders = off_block_borders(chains, data, view.scale)
    if off_borders is not None:
        chains = pieces_of(chains, off_borders, work.detection.min_chain_points)
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
    """The counts of detected edges."""
    return ImageCounts(
        chains=found.num_chains,
        chain_pixels=found.num_chain_pixels,
        polylines=found.graph.num_polylines,
        closed_polylines=int(found.graph.closed.sum()),
        edge_pixels=len(found.graph.points),
    )


def graph_key(
    data: ByteArray,
    mask: CompanionFile | None,
    edge_map: CompanionFile | None,
    view: View,
    work: ImageWork,
) -> str:
    """The cache key of an image's edge graph: a digest of everything that it depends on."""
    camera = [view.camera.model.name, view.width, view.height, *map(float, view.camera.params)]
    files = [file.data if file else None for file in (mask, edge_map)]
    return key_of(data, *files, camera, view.scale, work.detection, work.edge_graph)


def arrays_of(found: DetectedEdges) -> Arrays:
    """The arrays of a cache entry."""
    arrays = flattened(found.graph)
    counts = np.array([found.num_chains, found.num_chain_pixels])
    arrays |= {"dropped": found.dropped, "num_chains_and_pixels": counts}
    return arrays | {
        f"background_mask_{name}": array for name, array in vars(found.background_mask).items()
    }


def edges_from(arrays: Arrays, view: View) -> DetectedEdges:
    """The inverse of `arrays_of`, for the image of a view.

    Raises:
        KeyError, ValueError, ColmapEdgesError: if the arrays are not those of such edges.
    """
    graph, mask = graph_from(arrays), unflattened(BackgroundMask, arrays, "background_mask_")
    check_arrays("background_mask", mask)
    if mask.packed_body.shape[1] != -(-int(mask.body_width[0]) // 8):
        raise ValueError("the mask has another width")
    dropped, counts = arrays["dropped"], arrays["num_chains_and_pixels"]
    check_shape("dropped", check_array("dropped", dropped, FloatArray).shape, ("K", 2), {})
    check_shape("counts", check_array("counts", counts, IntArray).shape, (2,), {})
    for points in (graph.points, dropped):
        check_values("points", points / (view.width, view.height), -0.01, 1.01)
    num_chains, num_chain_pixels = counts.tolist()
    return DetectedEdges(
        graph=graph,
        dropped=dropped,
        num_chains=num_chains,
        num_chain_pixels=num_chain_pixels,
        background_mask=mask,
    )


def graph_from(arrays: Arrays) -> EdgeGraph:
    """The edge graph among the arrays of a cache entry.

    Raises:
        KeyError, ValueError, ColmapEdgesError: if they are not those of a graph, or offsets lead
            out of them.
    """
    graph = unflattened(EdgeGraph, arrays)
    check_arrays("graph", graph)
    check_offsets("graph.polyline_offsets", graph.polyline_offsets, len(graph.points), least=1)
    check_values("graph.undistorted", graph.undistorted, -MAX_COORDINATE, MAX_COORDINATE)
    check_values("graph.normals", graph.normals, -1.01, 1.01)
    return graph


def save_graph(cache: Cache, key: str, graph: EdgeGraph) -> None:
    """Write an edge graph alone as a cache entry."""
    cache.save(KIND, key, flattened(graph))


def load_graph(cache: Cache, key: str) -> EdgeGraph:
    """The edge graph of a cache entry that must exist.

    Raises:
        ColmapEdgesError: if it is missing or damaged.
    """
    graph = cache.load(KIND, key, graph_from)
    if graph is None:
        raise ColmapEdgesError(
            f"{cache.path(KIND, key)} is missing or damaged; do not change the cache during a run"
        )
    return graph
