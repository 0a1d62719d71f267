"""The picture of an atlas: pixels of photographs copied to the places of their charts."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from colmap_edges.core.arrays import FloatArray, IntArray, Picture
from colmap_edges.core.view import View, rows_by_view
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.runtime.executors import in_threads
from colmap_edges.surfaces.mesh import Mesh
from colmap_edges.texture.charts import Charts
from colmap_edges.texture.gains import gained
from colmap_edges.texture.packing import MARGIN_PX, Packing, packed
from colmap_edges.texture.pictures import Images, resized, scaled_pixels

BORDER_PX = MARGIN_PX + 2  # by which charts may reach beyond their image; rounding adds to it


class Atlas:
    """A picture that is filled with charts, and the places of their points.

    Attributes:
        packing: the places of the charts.
        pixels: (N, 2) points of the charts in the picture.
        picture: (H, W, 3) BGR.
    """

    def __init__(self, mesh: Mesh, charts: Charts, views: Sequence[View], max_side: int) -> None:
        """Pack the charts; the picture is black."""
        self.mesh, self.charts, self.views = mesh, charts, views
        image_pixels = self.project()
        self.packing: Packing = packed(boxes_of(image_pixels, charts), max_side)
        scaled = image_pixels
        for view, rows in self.points_by_view():
            scaled[rows] = scaled_pixels(view, image_pixels[rows], self.packing.scale)
        moves = self.packing.places - self.packing.lows
        self.pixels: FloatArray = scaled + moves[charts.charts]
        plain = charts.views[charts.charts] < 0  # all at the middle of their colour
        middles = self.packing.places + self.packing.sizes / 2
        self.pixels[plain] = middles[charts.charts[plain]]
        self.picture: Picture = np.zeros((*self.packing.shape, 3), np.uint8)

    def points_by_view(self) -> list[tuple[View, IntArray]]:
        """Each view that has charts, and the points of these."""
        views = self.charts.views[self.charts.charts] + 1
        parts = rows_by_view(views, len(self.views) + 1)[1:]
        return [(view, rows) for view, rows in zip(self.views, parts, strict=True) if len(rows)]

    def project(self) -> FloatArray:
        """(N, 2) the points in their views' images; 0 of plain colours."""
        pixels = np.zeros((len(self.charts.charts), 2))
        for view, rows in self.points_by_view():
            pixels[rows] = view.project(self.mesh.vertices[self.charts.vertices[rows]])[0]
        return pixels

    def fill(self, images: Images, gains: FloatArray, num_threads: int) -> None:
        """Copy the charts from the images, whose exposures are balanced by gains (V, 3)."""
        for chart in np.flatnonzero(self.charts.views < 0).tolist():
            self.part(chart)[:] = self.charts.colors[chart]
        used = np.unique(self.charts.views[self.charts.views >= 0]).tolist()
        in_threads(lambda view: self.fill_from(view, images, gains[view]), used, num_threads)

    def part(self, chart: int) -> Picture:
        """The part of the picture that a chart has."""
        (x, y), (width, height) = self.packing.places[chart], self.packing.sizes[chart]
        return self.picture[y : y + height, x : x + width]

    def fill_from(self, view: int, images: Images, gain: FloatArray) -> None:
        """Copy the charts of one view."""
        image = resized(images.full(self.views[view]), self.packing.scale)
        table = gained(np.arange(256.0)[:, None], gain)
        levels = np.clip(np.rint(table), 0, 255).astype(np.uint8)
        image = np.asarray(cv2.LUT(image, levels[None]))
        around = cv2.copyMakeBorder(image, *4 * (BORDER_PX,), cv2.BORDER_REPLICATE)
        for chart in np.flatnonzero(self.charts.views == view).tolist():
            (x, y), (width, height) = (
                self.packing.lows[chart] + BORDER_PX,
                self.packing.sizes[chart],
            )
            self.part(chart)[:] = around[y : y + height, x : x + width]
        self.straighten(view, image)

    def straighten(self, view: int, image: Picture) -> None:
        """Project the pixels of those triangles that are not straight in an image."""
        faces = np.flatnonzero(self.charts.views[self.charts.owners] == view)
        corners, triangles = self.pixels[self.charts.corners[faces]], self.mesh.faces[faces]
        vertices, posed = self.mesh.vertices, self.views[view]
        moves = (self.packing.places - self.packing.lows)[self.charts.owners[faces]]
        bends = np.zeros(len(faces))
        for a, b in ((0, 1), (1, 2), (2, 0)):
            middles = (vertices[triangles[:, a]] + vertices[triangles[:, b]]) / 2
            there = scaled_pixels(posed, posed.project(middles)[0], self.packing.scale) + moves
            away = there - (corners[:, a] + corners[:, b]) / 2
            bends = np.maximum(bends, np.linalg.norm(away, axis=1))
        # A side bends by more than a pixel, by perspective or distortion.
        bent = bends > 1.0
        places, owners, weights = _kernels.pixels_of_triangles(
            corners[bent], *self.packing.shape, MARGIN_PX - 1.0
        )
        if not len(places):
            return
        points = np.einsum("nk,nkd->nd", weights, vertices[triangles[bent][owners]])
        there = scaled_pixels(posed, posed.project(points)[0], self.packing.scale)
        known = np.isfinite(there).all(axis=1)
        values = _kernels.bilinear(image, there[known] - 0.5)
        self.picture.reshape(-1, 3)[places[known]] = np.rint(values).astype(np.uint8)


def boxes_of(pixels: FloatArray, charts: Charts) -> FloatArray:
    """(K, 4) least and largest x and y of the points of each chart."""
    order = np.argsort(charts.charts, kind="stable")
    starts = np.searchsorted(charts.charts[order], np.arange(len(charts.views)))
    if not len(order):
        return np.zeros((0, 4))
    limits = (
        np.minimum.reduceat(pixels[order], starts),
        np.maximum.reduceat(pixels[order], starts),
    )
    return np.column_stack(limits)
