"""Checks that all that a mesh follows was found in its model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.seen_points import SeenPoints
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.images.background import BackgroundRays
from colmap_edges.surfaces.faces.finding import Faces
from colmap_edges.surfaces.patches.finding import Patches

if TYPE_CHECKING:
    from colmap_edges.colmap.model import Model

# Largest median distance of edges' projections from their observations, in image sides. Those of
# edges of this model are below a hundredth of it, those of another are anywhere.
MAX_MISS = 0.01


def check_of_model(
    model: Model,
    curves: Mapping[str, Edges3D | None],
    background: BackgroundRays | None,
    faces: Faces | None,
    patches: Patches | None,
) -> None:
    """Check that all that a mesh follows was found in this model.

    Raises:
        ColmapEdgesError: naming the argument that was not.
    """
    num_views = len(model.views)
    SeenPoints.of_model(model).check("model", num_views)
    others = {"background": background, "faces": faces, "patches": patches}
    for name, given in {**curves, **others}.items():
        if given is not None:
            given.check(name, num_views)
    for name, edges in curves.items():
        if edges is not None and len(edges.observations.views):
            check_projections(model, name, edges)


def check_projections(model: Model, name: str, edges: Edges3D) -> None:
    """Check that edges project to where the images of a model observe them.

    Raises:
        ColmapEdgesError: if they do not.
    """
    from colmap_edges.colmap.model import observation_residuals

    sides = np.array([max(view.width, view.height) for view in model.views])
    misses = observation_residuals(model, edges)
    misses = np.where(np.isnan(misses), np.inf, misses) / sides[edges.observations.views]
    if np.median(misses) > MAX_MISS:
        raise ColmapEdgesError(
            f"{name} are not of this model: most points project more than "
            f"{MAX_MISS * sides.max():.0f} pixels away from their observations; give the model "
            "that they were found in"
        )
