"""Scenes of DTU's scans, in the official layout, in MVSNet's, or as a NeuS/IDR folder."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.layouts import dtu, mvsnet
from colmap_edges.evaluation.scenes import Scene


def scan_scene(
    root: Path,
    scan: int,
    *,
    light: str = "",
    positions: Container[int] = dtu.EVERY_POSITION,
    reference_root: Path | None = None,
) -> Scene:
    """A scan in the official or in MVSNet's layout.

    Args:
        root: The data's root.
        scan: Number of the scan.
        light: See `dtu.choose_images`.
        positions: See `dtu.choose_images`.
        reference_root: Root with Points/, ObsMask/; default: `root`.

    Raises:
        ColmapEdgesError: Images or calibration are missing.
    """
    packed = mvsnet.is_layout(root)
    image_path, posed = (mvsnet if packed else dtu).posed_images(
        root, scan, light=light, positions=positions
    )
    holder = reference_root or root
    has_cloud = dtu.find_optional(holder, f"Points/stl/stl{scan:03d}_total.ply") is not None
    depths_only = packed and not has_cloud and reference_root is None
    return Scene(
        name=f"DTU-{scan:03d}",
        image_path=image_path,
        posed=posed,
        load_reference=partial((mvsnet if depths_only else dtu).reference_of, holder, scan),
        scan=str(scan),
        unit="mm",
    )


def scan_scenes(root: Path, scans: Sequence[int] = (), **choices: Any) -> list[Scene]:
    """Scenes of several scans; one that cannot be read becomes a scene that fails when run.

    Args:
        root: See `scan_scene`.
        scans: Their numbers; default: the paper's, where present.
        choices: The other arguments of `scan_scene`.

    Raises:
        ColmapEdgesError: None of the paper's scans is present.
    """
    scenes = []
    for scan in scans or dtu.scan_numbers(root):
        try:
            scenes.append(scan_scene(root, scan, **choices))
        except ColmapEdgesError as error:
            scene = Scene(name=f"DTU-{scan:03d}", scan=str(scan), image_path=root, unit="mm")
            scenes.append(replace(scene, problem=str(error)))
    return scenes
