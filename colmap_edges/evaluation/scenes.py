"""Scenes of any layout: images with a sparse model or poses, and a reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics import depth, dtu_distances
from colmap_edges.evaluation.metrics.raycasting import RayCaster, load_geometry
from colmap_edges.evaluation.triangulation import PosedImage


@dataclass(frozen=True, kw_only=True)
class Reference:
    """The reference of a scene; any part can be missing.

    Attributes:
        depths: Depth maps, for meshes, and for points if there is no cloud.
        points: (N, 3) dense cloud, for points.
        surface: Mesh, for points if there is no cloud.
        dtu: DTU's benchmark data.
        notes: Sentences on missing figures and their reasons.
    """

    depths: Sequence[depth.ReferenceDepth] = ()
    points: FloatArray | None = None
    surface: Any = None
    dtu: dtu_distances.DtuReference | None = None
    notes: Sequence[str] = ()


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A scene with its images, poses and reference, which every layout is converted to.

    Attributes:
        name: Name in the tables and of the output folder; `{scene}` in paths of peers.
        image_path: Folder of the images.
        load_reference: Reads the reference, given the model.
        sparse_path: COLMAP model; None: triangulated from `posed`.
        posed: Images with poses.
        scan: `{scan}` in paths of peers; empty: none.
        unit: Unit of its lengths.
        problem: Reason why it cannot be run, or empty.
    """

    name: str
    image_path: Path
    load_reference: Callable[[Model], Reference] = lambda _: Reference()
    sparse_path: Path | None = None
    posed: Sequence[PosedImage] = ()
    scan: str = ""
    unit: str = "world unit"
    problem: str = ""

    def peers(self, paths: dict[str, str]) -> dict[str, Path]:
        """Paths of other systems' results by name, `{scene}` and `{scan}` in them filled in.

        Raises:
            ColmapEdgesError: Something else is in braces.
        """
        values = {"scene": self.name} | ({"scan": self.scan} if self.scan else {})
        found = {}
        for name, path in paths.items():
            try:
                found[name] = Path(path.format(**values))
            except (KeyError, IndexError, ValueError, AttributeError) as error:
                known = " and ".join(f"{{{key}}}" for key in values)
                raise ColmapEdgesError(
                    f"the path of {name}, {path}, has an unknown placeholder; use {known}"
                ) from error
        return found


def model_scene(
    name: str,
    image_path: Path,
    sparse_path: Path,
    reference_path: Path | None,
    view_names: Sequence[str] = (),
    unit: str = "world unit",
) -> Scene:
    """A scene of a COLMAP model; see `reference_of` for its reference."""
    return Scene(
        name=name,
        image_path=image_path,
        sparse_path=sparse_path,
        load_reference=partial(reference_of, reference_path, view_names),
        unit=unit,
    )


def reference_of(path: Path | None, view_names: Sequence[str], model: Model) -> Reference:
    """Read a folder of depth maps, a mesh, a cloud (seen by the central view), or nothing.

    Args:
        path: File or folder of the reference, or None.
        view_names: Views that see a mesh, or `all`; default: the central one.
        model: The model with the views.

    Raises:
        ColmapEdgesError: There is no such file or view, or the file is damaged.
    """
    if path is None:
        return Reference()
    if path.is_dir():
        return Reference(depths=depth.load_reference_depths(path, model))
    geometry = load_geometry(path)
    vertices = np.asarray(geometry.vertices, dtype=np.float64)
    if len(getattr(geometry, "faces", ())):
        caster = RayCaster(vertices, geometry.faces)
        depths = [depth.render_reference(caster, v) for v in views_named(model, view_names)]
        return Reference(depths=depths, surface=geometry)
    return Reference(
        depths=[depth.cloud_depth(vertices, depth.central_view(model))], points=vertices
    )


def views_named(model: Model, names: Sequence[str]) -> list[View]:
    """The views called `names`, `all` of them, or (none named) the central one.

    Raises:
        ColmapEdgesError: The model holds no view of that name.
    """
    if not names:
        return [depth.central_view(model)]
    if list(names) == ["all"]:
        return list(model.views)
    views = {view.name: view for view in model.views}
    missing = [name for name in names if name not in views]
    if missing:
        raise ColmapEdgesError(f"the model holds no image {', '.join(missing)}")
    return [views[name] for name in names]
