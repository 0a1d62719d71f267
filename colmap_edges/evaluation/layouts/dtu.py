"""DTU: images, poses and references in the official layout.

Reference: Jensen, Dahl, Vogiatzis, Tola, Aanaes, Large scale multi-view stereopsis evaluation,
CVPR 2014. All lengths in millimetres.
"""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.linalg import rq

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import FloatArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics import depth, dtu_distances
from colmap_edges.evaluation.metrics.dtu_distances import DtuReference, ObservedMask
from colmap_edges.evaluation.readers.curves import columns
from colmap_edges.evaluation.scenes import Reference
from colmap_edges.evaluation.triangulation import PosedImage, posed_image
from colmap_edges.export.ply import read_ply
from colmap_edges.runtime.input_files import open_file, read_text

PARTS = ("", "SampleSet/MVS Data", "MVS Data")
EVERY_POSITION = range(1, 1000)


def decompose_projection(projection: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Split a projection matrix (3, 4) into calibration (3, 3), rotation (3, 3), translation (3,).

    Raises:
        ColmapEdgesError: The matrix is singular.
    """
    left = projection[:, :3]
    determinant = np.linalg.det(left)
    if not np.isfinite(determinant) or determinant == 0:
        raise ColmapEdgesError("a projection matrix is singular; check the calibration files")
    projection = projection * np.sign(determinant)
    calibration, rotation = rq(projection[:, :3])
    signs = np.diag(np.sign(np.diag(calibration)))
    calibration, rotation = calibration @ signs, signs @ rotation
    translation = np.linalg.solve(calibration, projection[:, 3])
    return calibration / calibration[2, 2], rotation, translation


def posed_images(
    root: Path, scan: int, *, light: str = "", positions: Container[int] = EVERY_POSITION
) -> tuple[Path, list[PosedImage]]:
    """Images and poses of a scan in the official layout.

    Pixel coordinates of the calibration are used unchanged, as by all other systems.

    Args:
        root: Folder with Rectified/ or Cleaned/ and Calibration/cal18/, also below SampleSet.
        scan: Number of the scan.
        light: See `choose_images`.
        positions: See `choose_images`.

    Returns:
        The folder of the images and the images with poses, by position.

    Raises:
        ColmapEdgesError: Images or calibration are missing.
    """
    calibration = find(root, "Calibration/cal18")
    for name in ("Rectified", "Cleaned"):
        folders = [root / part / name / f"scan{scan}" for part in PARTS]
        folder = next((f for f in folders if f.is_dir()), None)
        if folder is not None:
            break
    else:
        raise ColmapEdgesError(f"{root} holds no Rectified/scan{scan} or Cleaned/scan{scan}")
    images = []
    for position, path in choose_images(folder, light, positions).items():
        matrix_path = calibration / f"pos_{position:03d}.txt"
        if not matrix_path.is_file():
            raise ColmapEdgesError(f"{matrix_path} is missing; it calibrates {path.name}")
        images.append(posed_image(path, *decompose_projection(read_matrix(matrix_path))))
    return folder, images


def read_matrix(path: Path) -> FloatArray:
    """The projection matrix (3, 4) of a text file.

    Raises:
        ColmapEdgesError: The file holds something else.
    """
    try:
        values = np.array(read_text(path).split(), dtype=np.float64)
        return values.reshape(3, 4)
    except ValueError as error:
        raise ColmapEdgesError(f"{path} holds no 3 x 4 matrix: {error}") from error


def parse_positions(text: str) -> Container[int]:
    """Positions of the camera, counted from 1: `all`, `odd`, or a list such as `1,3,5-9`.

    Raises:
        ColmapEdgesError: The text is something else.
    """
    if text == "all":
        return EVERY_POSITION
    if text == "odd":
        return EVERY_POSITION[::2]
    chosen: set[int] = set()
    for part in text.split(","):
        found = re.fullmatch(r"\s*(\d{1,3})\s*(?:-\s*(\d{1,3})\s*)?", part)
        first, last = (int(found[1]), int(found[2] or found[1])) if found else (0, 0)
        if not 1 <= first <= last:
            raise ColmapEdgesError(
                f"positions are {text!r}; give all, odd, or a list such as 1,3,5-9"
            )
        chosen.update(range(first, last + 1))
    return frozenset(chosen)


def choose_images(
    folder: Path, light: str = "", positions: Container[int] = EVERY_POSITION
) -> dict[int, Path]:
    """One image for each position, named PREFIX_POSITION_LIGHT, such as rect_001_3_r5000.png.

    Args:
        folder: Images of one scan.
        light: LIGHT of the names: `0_r5000` to `6_r5000`, or `max` with all lamps on; default:
            `max` where there is one, else the first by name.
        positions: Positions to take; those of a set must all be there.

    Raises:
        ColmapEdgesError: There is no such image.
    """
    chosen: dict[int, Path] = {}
    lights = set()
    for path in sorted(folder.iterdir()):
        found = re.match(r"[a-z]+_(\d{3})_(.*)\.(png|jpg|jpeg)$", path.name)
        if not found:
            continue
        position = int(found[1])
        lights.add(found[2])
        if position not in positions or (light and light != found[2]):
            continue
        if position not in chosen or found[2] == "max":
            chosen[position] = path
    if light and light not in lights:
        raise ColmapEdgesError(
            f"{folder} holds no image of light {light}; its lights: {', '.join(sorted(lights))}"
        )
    missing = sorted(positions - set(chosen)) if isinstance(positions, frozenset) else []
    if missing or not chosen:
        of = f"position {missing[0]:03d}" if missing else "the requested positions"
        raise ColmapEdgesError(f"{folder} holds no image NAME_POSITION_{light or 'LIGHT'} of {of}")
    return dict(sorted(chosen.items()))


def find(root: Path, relative: str) -> Path:
    """`relative` below `root`, or below the SampleSet in it.

    Raises:
        ColmapEdgesError: In neither place.
    """
    path = find_optional(root, relative)
    if path is None:
        raise ColmapEdgesError(f"{root} holds no {relative}, nor does its 'SampleSet/MVS Data'")
    return path


def find_optional(root: Path, relative: str) -> Path | None:
    """`relative` below `root`, or below its SampleSet; None if neither exists."""
    return next((root / p / relative for p in PARTS if (root / p / relative).exists()), None)


def reference_of(root: Path, scan: int, model: Model) -> Reference:
    """DTU's data: cloud, its depth from the central camera, mask and plane if there.

    Raises:
        ColmapEdgesError: The cloud is missing, or a file holds something else.
    """
    data = load_reference(root, scan)
    depths = [depth.cloud_depth(data.points, depth.central_view(model))]
    notes = dtu_distances.missing_data_notes(data)
    return Reference(depths=depths, points=data.points, dtu=data, notes=notes)


def load_reference(root: Path, scan: int) -> DtuReference:
    """Read stlNNN_total.ply and, where they are there, ObsMaskN_10.mat and PlaneN.mat.

    Raises:
        ColmapEdgesError: The cloud is missing, or a file holds something else.
    """
    path = find(root, f"Points/stl/stl{scan:03d}_total.ply")
    points = columns(read_ply(path).get("vertex"), ("x", "y", "z"), path).astype(np.float64)
    mask_path = find_optional(root, f"ObsMask/ObsMask{scan}_10.mat")
    plane_path = find_optional(root, f"ObsMask/Plane{scan}.mat")
    return DtuReference(
        points=points,
        mask=None if mask_path is None else read_mask(mask_path),
        plane=None if plane_path is None else read_plane(plane_path),
    )


def read_mask(path: Path) -> ObservedMask:
    """Read an ObsMaskN_10.mat.

    Raises:
        ColmapEdgesError: The file holds something else.
    """
    with reading_matlab(path) as data:
        mask = ObservedMask(
            cells=data["ObsMask"].astype(bool),
            box=data["BB"].astype(np.float64).reshape(2, 3),
            resolution=float(np.squeeze(data["Res"])),
        )
        if mask.cells.ndim != 3 or not np.isfinite(mask.box).all():
            raise ValueError("absurd values")
        if not 0 < mask.resolution < np.inf:
            raise ValueError(f"cells of {mask.resolution} mm")
    return mask


def read_plane(path: Path) -> FloatArray:
    """Read the plane (4,) of a PlaneN.mat.

    Raises:
        ColmapEdgesError: The file holds something else.
    """
    with reading_matlab(path) as data:
        plane: FloatArray = data["P"].astype(np.float64).reshape(4)
        if not np.isfinite(plane).all():
            raise ValueError("absurd values")
    return plane


@contextmanager
def reading_matlab(path: Path) -> Iterator[dict[str, Any]]:
    """The arrays of a .mat; any error within becomes one that names the file."""
    try:
        with open_file(path) as file:
            yield loadmat(file)
    except Exception as error:  # the exceptions of SciPy's reader are not documented
        reason = " ".join(str(error).split())[:200]
        raise ColmapEdgesError(f"{path} is not DTU's: {reason}") from error


def scan_numbers(root: Path) -> Sequence[int]:
    """The paper's scans that `root` holds images of, in the official or in MVSNet's layout.

    Raises:
        ColmapEdgesError: None of them.
    """
    places = [
        root / part / name
        for part in PARTS
        for name in ("Rectified", "Cleaned", "Rectified_raw")
        if (root / part / name).is_dir()
    ]
    names = {folder.name for place in places for folder in place.iterdir() if folder.is_dir()}
    paper = (6, 23, 28, 37, 98, 118)
    found = [scan for scan in paper if names & {f"scan{scan}", f"scan{scan}_train"}]
    if not found:
        raise ColmapEdgesError(f"{root} holds none of the scans {paper}; give --scans")
    return found
