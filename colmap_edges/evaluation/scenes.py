"""Scenes of the benchmarks: images, poses, references and results of other systems."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.colmap.triangulation import PosedImage
from colmap_edges.core.arrays import FloatArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics import depth, dtu_distances
from colmap_edges.evaluation.metrics.raycasting import RayCaster, load_geometry
from colmap_edges.evaluation.protocols import dtu, mvsnet, strecha
from colmap_edges.evaluation.protocols.scene import views_named


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
    """A scene with its images, poses and reference.

    Attributes:
        name: Name in the tables and of the output folder.
        image_path: Folder of the images.
        load_reference: Reads the reference, given the model.
        sparse_path: COLMAP model; None: triangulated from `posed`.
        posed: Images with poses.
        peers: Results of other systems by name, see `peers.load`.
        unit: Unit of its lengths.
        problem: Reason why it cannot be run, or empty.
    """

    name: str
    image_path: Path
    load_reference: Callable[[Model], Reference]
    sparse_path: Path | None = None
    posed: Sequence[PosedImage] = ()
    peers: Mapping[str, Path] = field(default_factory=dict)
    unit: str = "world unit"
    problem: str = ""


def file_reference(
    path: Path | None, view_names: Sequence[str] = ()
) -> Callable[[Model], Reference]:
    """Reader of a folder of depth maps, a mesh, a cloud (seen by the central view), or None.

    Args:
        path: File or folder of the reference, or None.
        view_names: Views that see a mesh, or `all`; default: the central one.
    """

    def read(model: Model) -> Reference:
        if path is None:
            return Reference()
        if path.is_dir():
            return Reference(depths=depth.load_reference_depths(path, model))
        geometry = load_geometry(path)
        vertices = np.asarray(geometry.vertices, dtype=np.float64)
        if len(getattr(geometry, "faces", ())):
            caster = RayCaster(vertices, geometry.faces)
            depths = depth.render_references(caster, views_named(model, view_names))
            return Reference(depths=depths, surface=geometry)
        central = depth.cloud_depth(vertices, depth.central_view(model))
        return Reference(depths=[central], points=vertices)

    return read


def dtu_reference(root: Path, scan: int) -> Callable[[Model], Reference]:
    """Reader of DTU's data: cloud, its depth from the central camera, mask and plane if there."""

    def read(model: Model) -> Reference:
        data = dtu.load_reference(root, scan)
        view = depth.central_view(model)
        depths = [depth.cloud_depth(data.points, view)]
        notes = dtu_distances.missing_data_notes(data)
        return Reference(depths=depths, points=data.points, dtu=data, notes=notes)

    return read


def mvsnet_reference(root: Path, scan: int) -> Callable[[Model], Reference]:
    """Reader of MVSNet's depth maps of the images that are used."""

    def read(model: Model) -> Reference:
        depths = mvsnet.load_depths(root, scan, model)
        missing = "This scan has neither Points nor Depths: no errors are measured."
        return Reference(depths=depths, notes=[] if depths else [missing])

    return read


def dtu_scene(
    root: Path,
    scan: int,
    *,
    light: str = "",
    positions: Container[int] = dtu.EVERY_POSITION,
    peer_paths: Mapping[str, str] | None = None,
    reference_root: Path | None = None,
) -> Scene:
    """A scan in the official or in MVSNet's layout.

    Args:
        root: The data's root.
        scan: Number of the scan.
        light: See `dtu.choose_images`.
        positions: See `dtu.choose_images`.
        peer_paths: See `peers_of`; `{scan}` becomes the scan's number.
        reference_root: Root with Points/, ObsMask/; default: `root`.

    Raises:
        ColmapEdgesError: Images or calibration are missing.
    """
    name = f"DTU-{scan:03d}"
    repackaged = mvsnet.is_layout(root)
    read = mvsnet.posed_images if repackaged else dtu.posed_images
    image_path, posed = read(root, scan, light=light, positions=positions)
    holder = reference_root or root
    has_cloud = dtu.find_optional(holder, f"Points/stl/stl{scan:03d}_total.ply") is not None
    depths_only = repackaged and not has_cloud and reference_root is None
    return Scene(
        name=name,
        image_path=image_path,
        posed=posed,
        load_reference=(mvsnet_reference if depths_only else dtu_reference)(holder, scan),
        peers=peers_of(peer_paths, scene=name, scan=scan),
        unit="mm",
    )


def dtu_scenes(root: Path, scans: Sequence[int], **choices: Any) -> list[Scene]:
    """Scenes of several scans; one that cannot be read becomes a scene that fails when run.

    Args:
        root: See `dtu_scene`.
        scans: Their numbers.
        choices: The other arguments of `dtu_scene`.
    """
    scenes = []
    for scan in scans:
        try:
            scenes.append(dtu_scene(root, scan, **choices))
        except ColmapEdgesError as error:
            scenes.append(
                Scene(
                    name=f"DTU-{scan:03d}",
                    image_path=root,
                    load_reference=file_reference(None),
                    unit="mm",
                    problem=str(error),
                )
            )
    return scenes


def repackaged_scene(
    folder: Path, reference_path: Path | None, peer_paths: Mapping[str, str] | None = None
) -> Scene:
    """A folder in the NeuS/IDR layout.

    Args:
        folder: With image/ and cameras*.npz.
        reference_path: Depth maps, mesh or cloud; or the official data's root, then the number in
            the folder's name is the scan; or none.
        peer_paths: See `peers_of`; `{scan}` becomes the folder's name.

    Raises:
        ColmapEdgesError: Images or matrices are missing.
    """
    image_path, posed = dtu.repackaged_images(folder)
    digits = "".join(c for c in folder.name if c.isdigit())
    reader = file_reference(reference_path)
    if reference_path is not None and digits and dtu.find_optional(reference_path, "Points"):
        reader = dtu_reference(reference_path, int(digits))
    return Scene(
        name=folder.name,
        image_path=image_path,
        posed=posed,
        load_reference=reader,
        peers=peers_of(peer_paths, scene=folder.name, scan=folder.name),
        unit="mm",
    )


def strecha_scene(
    image_path: Path,
    reference_path: Path | None,
    *,
    name: str,
    camera_path: Path | None = None,
    peer_paths: Mapping[str, str] | None = None,
) -> Scene:
    """Images with Strecha's .camera files.

    Args:
        image_path: Folder of the images, and of K.txt if there is one.
        reference_path: See `file_reference`.
        name: Name of the scene.
        camera_path: Folder of NAME.camera; default: that of the images.
        peer_paths: See `peers_of`.

    Raises:
        ColmapEdgesError: No image has a camera, or one cannot be read.
    """
    return Scene(
        name=name,
        image_path=image_path,
        posed=strecha.posed_images(image_path, camera_path),
        load_reference=file_reference(reference_path),
        peers=peers_of(peer_paths, scene=name),
        unit="m",
    )


def parse_peers(entries: Sequence[str]) -> dict[str, str]:
    """Split NAME=PATH entries.

    Raises:
        ColmapEdgesError: One is of another form.
    """
    found = {}
    for entry in entries:
        name, sign, path = entry.partition("=")
        if not (name and sign and path):
            raise ColmapEdgesError(f"{entry!r} is not of the form NAME=PATH")
        found[name] = path
    return found


def peers_of(peer_paths: Mapping[str, str] | None, **values: Any) -> dict[str, Path]:
    """Paths of peers' results for one scene, `{scene}` and `{scan}` in them filled in.

    Raises:
        ColmapEdgesError: Something else is in braces.
    """
    found = {}
    for name, path in (peer_paths or {}).items():
        try:
            found[name] = Path(path.format(**values))
        except (KeyError, IndexError, ValueError, AttributeError) as error:
            known = " and ".join(f"{{{key}}}" for key in values)
            raise ColmapEdgesError(
                f"the path of {name}, {path}, has an unknown placeholder; use {known}"
            ) from error
    return found
