"""Reduced pictures of the images, with layers of detected and reprojected edges."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import BoolArray, FloatArray, Picture, offsets_of, parts_of, ranks_of
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.view import View
from colmap_edges.edges2d.edge_graph import EdgeGraph
from colmap_edges.edges2d.image_graphs import DetectedEdges
from colmap_edges.images.files import encoded
from colmap_edges.report.contents import ImagePicture, evenly_spread
from colmap_edges.report.overlay import SHIFT, fixed_point, observed_segments

MAX_BYTES = 2_700_000  # maximum size of all pictures, before base 64


class PictureVisitor:
    """Makes reduced pictures while images are in memory, of as many views as a page can hold."""

    def __init__(self, num_views: int) -> None:
        """Choose evenly spread views and the size of their pictures."""
        self.chosen = set(evenly_spread(num_views, 120).tolist())
        # A picture with its layers takes about 0.35 bytes a pixel.
        side = np.sqrt(MAX_BYTES / 0.35 / max(len(self.chosen), 1) * 4 / 3)
        self.side_px = float(np.clip(side, 240, 960))
        self.taken: dict[int, ImagePicture] = {}

    def visit(
        self,
        index: int,
        view: View,
        read: Callable[[], Picture],
        found: DetectedEdges,
        usable: BoolArray | None = None,
    ) -> ImagePicture | None:
        """Make the picture of a view, its longer side at most `side_px`; None if not chosen."""
        if index not in self.chosen:
            return None
        image = read()
        height, width = image.shape[:2]
        scale = min(self.side_px / max(width, height), 1.0)
        size = max(round(width * scale), 1), max(round(height * scale), 1)
        photo, jpeg = reduced(image, size), [cv2.IMWRITE_JPEG_QUALITY, 75]
        jpeg += [cv2.IMWRITE_JPEG_OPTIMIZE, 1]
        lines = graph_lines(found.graph, scale)
        dots, shape = np.repeat(found.dropped[:, None], 2, axis=1), (size[1], size[0])
        return ImagePicture(
            view=index,
            photo=encoded(".jpg", photo, jpeg),
            detected=layer(lines, scale, shape, (0, 160, 255)) if lines else b"",
            dropped=layer([dots], scale, shape, (90, 60, 230)) if len(dots) else None,
            shape=shape,
        )

    def collect(self, index: int, kept: ImagePicture | None) -> None:
        """Store a picture."""
        if kept is not None:
            self.taken[index] = kept

    def pictures(self) -> list[ImagePicture]:
        """The pictures in the order of the views, as many as fit into `MAX_BYTES`."""
        pictures = [self.taken[index] for index in sorted(self.taken)]
        while sum(picture.num_bytes for picture in pictures) > MAX_BYTES and len(pictures) > 1:
            pictures = pictures[::2]
        return pictures


def reduced(image: Picture, size: tuple[int, int]) -> Picture:
    """A picture resized to a smaller size (width, height); halved first, which is fast."""
    height, width = image.shape[:2]
    if width >= 2 * size[0] and height >= 2 * size[1]:
        image = cv2.resize(image, (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), np.uint8)


def reprojected_layer(picture: ImagePicture, model: Model, edges: Edges3D | None) -> bytes:
    """The 3D edges that the view of a picture observes, transparent PNG of its size."""
    view = model.views[picture.view]
    lines: list[FloatArray] = []
    if edges is not None:
        segments = observed_segments(edges, picture.view)
        lines = [view.project(edges.points[segments.ravel()])[0].reshape(-1, 2, 2)]
    return layer(lines, picture.shape[1] / view.width, picture.shape, (255, 225, 0))


def graph_lines(graph: EdgeGraph, scale: float) -> list[FloatArray]:
    """The polylines of a graph, image pixels, thinned for drawing at `scale`."""
    step = max(int(0.7 / scale), 1)
    first, last = graph.polyline_offsets[:-1], graph.polyline_offsets[1:]
    counts = -(-(last - first) // step) + 1  # each step's first point, then the end
    offsets = offsets_of(counts)
    index = np.repeat(first, counts) + step * ranks_of(counts)
    index[offsets[1:] - 1] = np.where(graph.closed, first, last - 1)
    return parts_of(graph.points.take(index, axis=0), offsets)


def layer(
    lines: list[FloatArray], scale: float, shape: tuple[int, ...], color: tuple[int, int, int]
) -> bytes:
    """Lines, image pixels, drawn in one colour on a transparent PNG of `shape`."""
    mask: Picture = np.zeros(shape, np.uint8)
    pairs = lines and lines[0].ndim == 3
    drawn: list[Any] = []
    if lines:
        fixed = fixed_point(np.concatenate(lines) * scale)
        lengths = np.fromiter(map(len, lines), np.int64)
        drawn = list(fixed) if pairs else parts_of(fixed, offsets_of(lengths))
    cv2.polylines(mask, drawn, False, 255, 1, cv2.LINE_AA, SHIFT)
    return one_colored_png(mask // 64, 2, color)  # fewer shades of a line compress better


def one_colored_png(opacity: Picture, bits: int, color: tuple[int, int, int]) -> bytes:
    """A PNG of one colour (BGR) with (H, W) `opacity`, of `bits` (1, 2 or 4) a pixel.

    Its pixels are indices into a palette: a seventh of the time of an image with an alpha channel.
    """
    height, width = opacity.shape
    per_byte, most = 8 // bits, (1 << bits) - 1
    padded = np.pad(opacity, ((0, 0), (0, -width % per_byte)))
    rows = np.zeros((height, 1 + padded.shape[1] // per_byte), np.uint8)  # 0 first: not filtered
    for place in range(per_byte):
        rows[:, 1:] |= padded[:, place::per_byte] << (8 - bits * (place + 1))
    alphas = bytes(255 * index // most for index in range(most + 1))
    # Lines are runs of pixels: as small as with all of zlib's matches, in a seventh of the time.
    packer = zlib.compressobj(strategy=zlib.Z_RLE)
    parts = {
        b"IHDR": struct.pack(">IIBBBBB", width, height, bits, 3, 0, 0, 0),
        b"PLTE": bytes(color[::-1]) * (most + 1),
        b"tRNS": alphas,
        b"IDAT": packer.compress(rows.tobytes()) + packer.flush(),
        b"IEND": b"",
    }
    chunks = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts.items()
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)
