"""What rays to observed points say of a body: they pass through it, end on it or before it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from colmap_edges.core.arrays import BoolArray, FloatArray
from colmap_edges.surfaces.revolution.meridians import Axis
from colmap_edges.surfaces.revolution.profiles import Profile
from colmap_edges.surfaces.round_evidence import Rays, Sight

# Depths below the surface, in pixels, of the shell that a ray enters if it meets the body.
INSIDE_PX, DEEP_PX = 2.0, 6.0
MAX_RAYS = 4000  # through the ball around a body, more are left out
NUM_STEPS = 96  # along a ray through the ball around the body


@dataclass(frozen=True, kw_only=True)
class Shell:
    """The layer under a body's surface, in cells of a pixel along and across its axis.

    Attributes:
        axis: the axis.
        middle: place of the middle, pixels.
        reach: radius of the ball around the middle that holds the body, pixels.
        lowest: place of the first cell.
        inside: (m, n) whether a cell is clearly inside.
        below: (m, n) whether it is below the surface.
    """

    axis: Axis
    middle: float
    reach: float
    lowest: float
    inside: BoolArray
    below: BoolArray


def shell_of(profile: Profile) -> Shell:
    """The layer under the surface of a body."""
    lowest = profile.places[0] - 2 * DEEP_PX
    shape = (
        int(np.ceil(profile.places[-1] - lowest + 2 * DEEP_PX)) + 1,
        int(np.ceil(profile.radii.max() + 2 * DEEP_PX)) + 1,
    )
    fine = np.linspace(0, len(profile.places) - 1, 4 * shape[0] + 4 * shape[1])
    ranks = np.arange(len(profile.places))
    columns = np.column_stack([profile.places, profile.radii, profile.normals])
    line = np.column_stack([np.interp(fine, ranks, column) for column in columns.T])
    inside, below = np.zeros((2, *shape), bool)
    for depth in np.arange(0, DEEP_PX, 0.5):
        cells = np.floor(line[:, :2] - depth * line[:, 2:] - [lowest, 0]).astype(np.int64)
        cells = cells[(cells >= 0).all(axis=1) & (cells < shape).all(axis=1)]
        below[cells[:, 0], cells[:, 1]] = True
        if depth >= INSIDE_PX:
            inside[cells[:, 0], cells[:, 1]] = True
    half = np.ptp(profile.places) / 2
    return Shell(
        axis=profile.axis,
        middle=float(profile.places[0] + half),
        reach=float(np.hypot(half, profile.radii.max())),
        lowest=float(lowest),
        inside=inside,
        below=below,
    )


def entries_of(
    shell: Shell, starts: FloatArray, rays: FloatArray, skipped: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """(n,) lengths of rays to where they enter a body, inf if never, and (n,) places there.

    Args:
        shell: the layer under the surface.
        starts: (n, 3) starts of the rays.
        rays: (n, 3) unit directions.
        skipped: length at the start of the rays that does not count.
    """
    axis = shell.axis
    lengths, places = np.full(len(starts), np.inf), np.zeros(len(starts))
    away = (starts - axis.point) / axis.pixel
    to_middle = shell.middle * axis.direction - away
    along = np.einsum("ij,ij->i", to_middle, rays)
    half = shell.reach**2 - np.einsum("ij,ij->i", to_middle, to_middle) + along**2
    meets = np.flatnonzero((half > 0) & (along + np.sqrt(np.maximum(half, 0)) > skipped))
    half = np.sqrt(half[meets])
    first = np.maximum(along[meets] - half, skipped)
    steps = first[:, None] + np.linspace(0, 1, NUM_STEPS) * (along[meets] + half - first)[:, None]
    slopes, heights = rays[meets] @ axis.direction, away[meets] @ axis.direction
    at = heights[:, None] + steps * slopes[:, None]
    squares = np.einsum("ij,ij->i", away[meets], away[meets])[:, None] + steps**2
    squares += 2 * steps * np.einsum("ij,ij->i", away[meets], rays[meets])[:, None]
    rows = np.floor(at - shell.lowest).astype(np.int64)
    columns = np.floor(np.sqrt(np.maximum(squares - at**2, 0))).astype(np.int64)
    held = (rows >= 0) & (rows < len(shell.inside)) & (columns < shell.inside.shape[1])
    rows, columns = np.where(held, rows, 0), np.where(held, columns, 0)
    entered = np.flatnonzero((held & shell.inside[rows, columns]).any(axis=1))
    ranks = (held & shell.below[rows, columns])[entered].argmax(axis=1)
    lengths[meets[entered]] = steps[entered, ranks] * axis.pixel
    places[meets[entered]] = at[entered, ranks]
    return lengths, places


def rays_that_meet(shell: Shell, rays: Rays) -> Sight:
    """The rays to observed points that meet a body, no more than `MAX_RAYS` evenly chosen."""
    away = shell.axis.point + shell.middle * shell.axis.pixel * shell.axis.direction - rays.starts
    along = np.einsum("ij,ij->i", away, rays.directions)
    off = np.einsum("ij,ij->i", away, away) - along**2
    near = np.flatnonzero((along > 0) & (off < (shell.reach * shell.axis.pixel) ** 2))
    near = near[:: len(near) // MAX_RAYS + 1]
    reach, places = entries_of(shell, rays.starts[near], rays.directions[near])
    meets = np.flatnonzero(np.isfinite(reach))
    return rays.met(near[meets], reach[meets], places[meets])
