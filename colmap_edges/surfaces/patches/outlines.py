"""Points on outlines of smooth bodies, beside patches: both are added where a mesh lacks them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from colmap_edges.core.outlines import Outlines
from colmap_edges.core.seen_points import joined_seen
from colmap_edges.surfaces.patches.finding import Patches


def with_outlines(patches: Patches, outlines: Outlines) -> Patches:
    """The patches, and the points of outlines as further ones."""
    return replace(
        patches,
        points=joined_seen([patches.points, outlines.seen]),
        normals=np.concatenate([patches.normals, outlines.normals]),
        sigmas=np.concatenate([patches.sigmas, outlines.sigmas]),
        tolerances=np.concatenate([patches.tolerances, outlines.sigmas]),
        grays=np.concatenate([patches.grays, outlines.colors.mean(axis=1).astype(np.uint8)]),
        num_outlines=patches.num_outlines + len(outlines.points),
    )
