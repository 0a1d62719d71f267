"""Search of patches in all views, and what views agree on.

A patch is a small plane that a window of an image shows where it has texture (Furukawa and Ponce,
2010). Depths and normals are searched on a grid of sites as in PatchMatch stereo (Bleyer et al.,
2011). Windows hold no traced edge: they do not straddle edges, where the surface is known anyway.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import (
    BoolArray,
    ByteArray,
    FloatArray,
    Int32Array,
    IntArray,
    entries_of,
    offsets_of,
)
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.polylines import unit
from colmap_edges.core.seen_points import NO_POINTS, SeenPoints
from colmap_edges.core.view import rows_by_view
from colmap_edges.edges3d.chains.view_selection import Neighborhood, select_views
from colmap_edges.errors import ColmapEdgesError, check_type
from colmap_edges.kernels import _kernels  # type: ignore[attr-defined]
from colmap_edges.options import ViewSelectionOptions
from colmap_edges.runtime.executors import in_threads
from colmap_edges.surfaces.faces.grids import Grid, arrays_of, blank_grid
from colmap_edges.surfaces.information import MIN_COSINE
from colmap_edges.surfaces.patches.depths import NO_DEPTHS, Depths, depths_of
from colmap_edges.surfaces.patches.sites import (
    LEAST_VARIANCE,
    STEP_PX,
    hypotheses_at,
    places_in,
    textured_sites,
)
from colmap_edges.surfaces.patches.smoothing import smoothed

NUM_NEIGHBORS = 4  # views that windows are compared with
MAX_ANGLE_DEG = 40.0  # between the views of a patch
NUM_SWEEPS = 3  # over all sites; a fourth finds 0.5 % more
BELIEVED = 0.75  # correlation of windows of one place
MAX_OFF_PX = 1.0  # maximum distance of the patches of two views that agree, in pixels of parallax
MIN_AGREEING = 2  # other views
MAX_THROUGH = 0.5  # views that see through a patch, per agreeing view
# Share of accepted patches of all sites with texture, below which most texture is on no surface
# (reflections, shading, noise), and windows agree by accident: 0 to 0.24 in plain rooms and on
# glossy parts, 0.27 to 0.84 where surfaces have texture. Then a patch needs others around it: in a
# square of so many sites at least so many, and such a share of those with texture.
MIN_AGREED_SHARE = 0.25
SQUARE_SITES = 9
MIN_AROUND = 15
MIN_AROUND_SHARE = 0.5
MAX_COLUMNS = 256  # cells along the longer side of a picture, of 4 pixels each
MAX_BYTES = 1e9  # of all pictures


@dataclass(frozen=True, kw_only=True)
class Patches:
    """Points where images have texture.

    Attributes:
        points: the points, with the views that agree on them; first that of its picture.
        normals: (P, 3) float64 unit normals, towards the views.
        sigmas: (P,) float64 standard deviations along the first view's ray, world units.
        tolerances: (P,) float64 the same of a single measurement there, such as of edges, and of
            the point together.
        grays: (P,) uint8 gray in the first view.
        num_sites: number of windows with texture and without edge, in all views.
        num_found: number of those that neighbours show, too.
        num_agreed: number of those that views agree on.
        num_outlines: number of points, the last ones, that are on outlines of smooth bodies
            instead: their views see the surface there, but no texture.
        depths: depths by all windows that views agree on.
    """

    points: SeenPoints
    normals: FloatArray
    sigmas: FloatArray
    tolerances: FloatArray
    grays: ByteArray
    num_sites: int = 0
    num_found: int = 0
    num_agreed: int = 0
    num_outlines: int = 0
    depths: Depths = NO_DEPTHS

    @property
    def textured(self) -> SeenPoints:
        """The points where images have texture."""
        return self.points.chosen(np.arange(len(self.points.points) - self.num_outlines))

    def check(self, name: str = "patches", num_views: int | None = None) -> None:
        """Check shapes, dtypes and values, as all functions of the Python interface do.

        Raises:
            ColmapEdgesError: naming the first array that does not fit.
        """
        check_type(f"{name}.points", self.points, (SeenPoints,))
        self.points.check(f"{name}.points", num_views)
        check_type(f"{name}.depths", self.depths, (Depths,))
        self.depths.check(f"{name}.depths", num_views)
        count = len(self.points.points)
        for key in ("normals", "sigmas", "tolerances", "grays"):
            if len(getattr(self, key)) != count:
                raise ColmapEdgesError(
                    f"{name}.{key} has {len(getattr(self, key))} rows for {count} points; give as "
                    "many"
                )


NO_PATCHES = Patches(
    points=NO_POINTS,
    normals=np.zeros((0, 3)),
    sigmas=np.zeros(0),
    tolerances=np.zeros(0),
    grays=np.zeros(0, np.uint8),
)


def picture_columns(model: Model) -> int:
    """Cells along the longer side of the pictures of a model's views: fewer if there are many."""
    pixels = MAX_BYTES / max(len(model.views), 1)
    sides = [max(view.width, view.height) for view in model.views]
    return max(8, min(MAX_COLUMNS, int(np.sqrt(pixels)) // 4, max(sides, default=0) // 4))


def find_patches(
    model: Model, edges: Edges3D, pictures: Mapping[int, Grid], seed: int, num_threads: int
) -> Patches:
    """Find patches where views have texture and no edges.

    Args:
        model: gives the V views and the SfM points.
        edges: its 3D edges.
        pictures: pictures of the views by their index; views without one show nothing.
        seed: of random depths.
        num_threads: threads; the result does not depend on them.
    """
    grids = [pictures.get(v) or blank_grid(view) for v, view in enumerate(model.views)]
    agreed, active, num_found = find_agreed(model, edges, grids, seed, num_threads)
    accepted, num_sites = are_accepted(agreed), sum(int(of.sum()) for of in active)
    if accepted.sum() < MIN_AGREED_SHARE * num_sites:
        accepted &= are_among_others(accepted, agreed, active)
    chosen = np.flatnonzero(accepted & (agreed.rows[:, 3] > 0))
    return replace(
        patches_of(model, grids, agreed, chosen),
        num_sites=num_sites,
        num_found=num_found,
        num_agreed=int(accepted.sum()),
        depths=depths_of(
            grids,
            agreed.rows[accepted],
            agreed.values[accepted],
            np.diff(agreed.offsets)[accepted],
        ),
    )


def find_agreed(
    model: Model, edges: Edges3D, grids: Sequence[Grid], seed: int, num_threads: int
) -> tuple[Agreed, list[BoolArray], int]:
    """Search the patches of all views.

    Returns:
        The patches with what other views say of them, per view (rows, columns) whether sites have
        texture and no edge, and the number of patches.
    """
    neighborhood = select_views(model, ViewSelectionOptions(max_angle_deg=MAX_ANGLE_DEG))
    known = SeenPoints.of_model(model), SeenPoints.of_edges(edges)
    sfm, on_edges = (places_in(model, grids, of) for of in known)
    scene = make_scene(model, grids, neighborhood)
    steps = (LEAST_VARIANCE, MIN_COSINE, NUM_SWEEPS, BELIEVED, seed)

    def search(view: int) -> tuple[BoolArray, int]:
        sites = textured_sites(grids[view], on_edges[view][0])
        places = (np.concatenate(of) for of in zip(sfm[view], on_edges[view], strict=True))
        given = (sites.view(np.uint8), hypotheses_at(sites, *places))
        return sites, scene.search(view, *given, *neighborhood.ranges[view].of_points, *steps)

    searched = in_threads(search, range(len(grids)), num_threads)
    active, num_found = [sites for sites, _ in searched], sum(count for _, count in searched)
    others = around(neighborhood.observing_views)
    return Agreed(*scene.agreed(*others, MAX_OFF_PX, num_threads)), active, num_found


class Agreed(NamedTuple):
    """Patches of all views, with what other views say of them.

    Attributes:
        rows: (P, 5) int32 view, row and column of the site, whether no agreeing view sees it with
            more pixels, and number of views that see through it.
        values: (P, 7) float64 pixel, inverse depth, its slopes, its standard deviation, and its
            change that moves the patch a pixel in neighbours.
        offsets: (P + 1,) of the agreeing views.
        views: (T,) int32 agreeing views.
    """

    rows: Int32Array
    values: FloatArray
    offsets: IntArray
    views: Int32Array


def are_accepted(agreed: Agreed) -> BoolArray:
    """(P,) whether enough views agree on a patch, and few see through it."""
    agreeing = np.diff(agreed.offsets)
    accepted: BoolArray = agreeing >= MIN_AGREEING
    return accepted & (agreed.rows[:, 4] <= MAX_THROUGH * agreeing)


def are_among_others(accepted: BoolArray, agreed: Agreed, active: Sequence[BoolArray]) -> BoolArray:
    """(P,) whether patches have enough accepted ones around them.

    Args:
        accepted: (P,) whether views agree on a patch.
        agreed: the patches.
        active: (V,) per view (rows, columns) whether sites have texture and no edge.
    """
    among = np.zeros_like(accepted)
    view, row, column = agreed.rows[:, :3].T
    for own, sites in zip(rows_by_view(view, len(active)), active, strict=True):
        have = np.zeros(sites.shape, np.float32)
        have[row[own], column[own]] = accepted[own]
        found, textured = (
            cv2.boxFilter(of, -1, (SQUARE_SITES,) * 2, None, (-1, -1), False, cv2.BORDER_CONSTANT)
            for of in (have, sites.astype(np.float32))
        )
        enough = (found >= MIN_AROUND) & (found >= MIN_AROUND_SHARE * textured)
        among[own] = enough[row[own], column[own]]
    return among


def patches_of(model: Model, grids: Sequence[Grid], agreed: Agreed, chosen: IntArray) -> Patches:
    """The chosen patches as points in the world, their noise averaged on planes."""
    rows, values = agreed.rows[chosen], agreed.values[chosen]
    planes, sigmas, single = smoothed(rows, values)
    points, normals, lengths = in_world(model, grids, rows, values, planes)
    counts = np.diff(agreed.offsets)[chosen]
    others = agreed.views[entries_of(agreed.offsets, chosen)]
    grays = np.zeros(len(rows), np.uint8)
    columns, lines = np.rint(values[:, :2]).astype(np.int64).T
    for grid, own in zip(grids, rows_by_view(rows[:, 0], len(grids)), strict=True):
        grays[own] = grid.gray[lines[own], columns[own]]
    return Patches(
        points=SeenPoints(
            points,
            offsets_of(counts + 1),
            np.insert(others, offsets_of(counts)[:-1], rows[:, 0]).astype(np.int32),
        ),
        normals=normals,
        sigmas=sigmas * lengths,
        tolerances=np.hypot(sigmas, single) * lengths,
        grays=grays,
    )


def make_scene(model: Model, grids: Sequence[Grid], neighborhood: Neighborhood) -> Any:
    """The kernel's scene."""
    near = [of[:NUM_NEIGHBORS] for of in neighborhood.neighbors]
    return _kernels.PatchScene(
        *arrays_of(model.views, grids),
        offsets_of(np.array([len(of) for of in near])),
        np.concatenate([np.zeros(0, np.int32), *near]).astype(np.int32),
        STEP_PX,
    )


def around(near: Sequence[IntArray]) -> tuple[IntArray, Int32Array]:
    """Offsets and views of each view's neighbours and of those whose neighbour it is."""
    sets = [set(of.tolist()) for of in near]
    for v, of in enumerate(near):
        for other in of.tolist():
            sets[other].add(v)
    rows = [np.array(sorted(of), np.int32) for of in sets]
    return offsets_of(np.array([len(of) for of in rows])), np.concatenate(rows)


def in_world(
    model: Model, grids: Sequence[Grid], rows: Int32Array, values: FloatArray, planes: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(P, 3) points, (P, 3) unit normals, and (P,) their movement per change of inverse depth."""
    points, normals, lengths = (
        np.zeros((len(rows), 3)),
        np.zeros((len(rows), 3)),
        1 / planes[:, 0] ** 2,
    )
    for v, own in enumerate(rows_by_view(rows[:, 0], len(grids))):
        view, grid = model.views[v], grids[v]
        rays = np.ones((len(own), 3))
        rays[:, :2] = (values[own, :2] + 0.5 - grid.principal) / grid.focal_px
        inverse, slopes = planes[own, 0], grid.focal_px * planes[own, 1:]
        points[own] = (rays / inverse[:, None] - view.translation) @ view.rotation
        last = inverse - np.einsum("ij,ij->i", slopes, rays[:, :2])
        normals[own] = -np.column_stack([slopes, last]) @ view.rotation
        lengths[own] *= np.linalg.norm(rays, axis=1)
    return points, unit(normals), lengths
