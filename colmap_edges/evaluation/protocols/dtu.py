"""DTU: the official layout, the NeuS/IDR repackaging, and the benchmark's distances.

Reference: Jensen, Dahl, Vogiatzis, Tola, Aanaes, Large scale multi-view stereopsis evaluation,
CVPR 2014. All lengths in millimetres.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from scipy.io import loadmat
from scipy.linalg import rq
from scipy.spatial import cKDTree

from colmap_edges.colmap.triangulation import PosedImage, posed_image
from colmap_edges.core.arrays import BoolArray, FloatArray
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.metrics.clouds import cloud_to_cloud
from colmap_edges.evaluation.readers.arrays import read_arrays
from colmap_edges.evaluation.readers.curves import columns
from colmap_edges.evaluation.readers.ply import read_ply
from colmap_edges.runtime.input_files import open_file, read_text

PAPER_SCANS = (6, 23, 28, 37, 98, 118)
THINNING_MM = 0.2
MAX_DISTANCE_MM = 20.0
_BLOCK_MM = 60.0
PARTS = ("", "SampleSet/MVS Data", "MVS Data")


@dataclass(frozen=True, kw_only=True)
class DtuReference:
    """Structured-light reference of one scan.

    Attributes:
        points: (N, 3) surface points.
        mask: (X, Y, Z) cells in which the cameras and the scanner see the scene.
        box: (2, 3) lowest and highest corner of the mask's box.
        resolution: Side of a cell.
        plane: (4,) the table; points with plane . (x, y, z, 1) > 0 are above it.
    """

    points: FloatArray
    mask: BoolArray
    box: FloatArray
    resolution: float
    plane: FloatArray


@dataclass(frozen=True, kw_only=True)
class DtuErrors:
    """The benchmark's figures in mm, over distances below 20 mm.

    Attributes:
        accuracy: Mean distance of the result inside the mask to the reference.
        completeness: Mean distance of the reference above the plane to the result.
        overall: Mean of the two.
        accuracy_median: Median of the first.
        completeness_median: Median of the second.
        points: Points of the result after thinning and inside the mask.
    """

    accuracy: float
    completeness: float
    overall: float
    accuracy_median: float
    completeness_median: float
    points: int


def is_repackaged(folder: Path) -> bool:
    """Whether `folder` has the NeuS/IDR layout: image/ and cameras*.npz."""
    return (folder / "image").is_dir() and bool(list(folder.glob("cameras*.npz")))


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


def posed_images(root: Path, scan: int, *, light: str = "") -> tuple[Path, list[PosedImage]]:
    """Images and poses of a scan in the official layout.

    Pixel coordinates of the calibration are taken as they are, as all peers take them.

    Args:
        root: Folder with Rectified/ or Cleaned/ and Calibration/cal18/, also below SampleSet.
        scan: Number of the scan.
        light: Part of the file name that chooses the light, such as `max` or `3_r5000`; default:
            `max` where there is one, else the first of each position.

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
    for position, path in sorted(_choose_light(folder, light).items()):
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


def _choose_light(folder: Path, light: str) -> dict[int, Path]:
    chosen: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        found = re.match(r"[a-z]+_(\d{3})_(.*)\.(png|jpg|jpeg)$", path.name)
        if not found:
            continue
        position = int(found[1])
        if light and light != found[2]:
            continue
        if position not in chosen or found[2] == "max":
            chosen[position] = path
    if not chosen:
        raise ColmapEdgesError(f"{folder} holds no image NAME_POSITION_{light or 'LIGHT'}.png")
    return chosen


def repackaged_images(folder: Path) -> tuple[Path, list[PosedImage]]:
    """Images and poses of a NeuS/IDR folder: image/NNN.png, world_mat_N of cameras*.npz.

    World coordinates are those of world_mat (millimetres), not the unit sphere.

    Raises:
        ColmapEdgesError: Images or matrices are missing, or their numbers differ.
    """
    cameras = sorted(folder.glob("cameras*.npz"))
    paths = sorted(p for p in (folder / "image").iterdir() if p.suffix in (".png", ".jpg"))
    if not cameras or not paths:
        raise ColmapEdgesError(f"{folder} holds no cameras*.npz or no image/*.png")
    # cameras.npz and cameras_sphere.npz hold the same world_mat.
    data = read_arrays(cameras[0])
    matrices = []
    for i in range(len(paths)):
        matrix = data.get(f"world_mat_{i}", np.empty(0))
        if matrix.ndim != 2 or min(matrix.shape) < 3 or matrix.shape[1] < 4:
            raise ColmapEdgesError(f"{cameras[0]} holds no matrix world_mat_{i}")
        matrices.append(matrix[:3, :4].astype(np.float64))
    images = [
        posed_image(path, *decompose_projection(matrix))
        for path, matrix in zip(paths, matrices, strict=True)
    ]
    return folder / "image", images


def find(root: Path, relative: str) -> Path:
    """`relative` below `root`, or below the SampleSet in it.

    Raises:
        ColmapEdgesError: In neither place.
    """
    for part in PARTS:
        if (root / part / relative).exists():
            return root / part / relative
    raise ColmapEdgesError(f"{root} holds no {relative}, nor does its 'SampleSet/MVS Data'")


def load_points(path: Path) -> FloatArray:
    """Vertices (N, 3) of a PLY.

    Raises:
        ColmapEdgesError: The file is not a PLY with x, y, z.
    """
    vertices = read_ply(path).get("vertex")
    return columns(vertices, ("x", "y", "z"), path).astype(np.float64)


def load_reference(root: Path, scan: int) -> DtuReference:
    """Read stlNNN_total.ply, ObsMaskN_10.mat and PlaneN.mat.

    Raises:
        ColmapEdgesError: A file is missing or holds something else.
    """
    points = load_points(find(root, f"Points/stl/stl{scan:03d}_total.ply"))
    mask_path = find(root, f"ObsMask/ObsMask{scan}_10.mat")
    plane_path = find(root, f"ObsMask/Plane{scan}.mat")
    try:
        with open_file(mask_path) as mask_file, open_file(plane_path) as plane_file:
            mask, plane = loadmat(mask_file), loadmat(plane_file)
        reference = DtuReference(
            points=points,
            mask=mask["ObsMask"].astype(bool),
            box=mask["BB"].astype(np.float64).reshape(2, 3),
            resolution=float(np.squeeze(mask["Res"])),
            plane=plane["P"].astype(np.float64).reshape(4),
        )
    except Exception as error:  # SciPy's reader has no list of what it raises
        reason = " ".join(str(error).split())[:200]
        raise ColmapEdgesError(
            f"{mask_path} or {plane_path.name} is not DTU's: {reason}"
        ) from error
    finite = all(np.isfinite(values).all() for values in (reference.box, reference.plane))
    if reference.mask.ndim != 3 or not finite or not 0 < reference.resolution < np.inf:
        raise ColmapEdgesError(f"{mask_path} or {plane_path.name} is not DTU's: absurd values")
    return reference


def sample_mesh(
    mesh: trimesh.Trimesh, spacing: float = THINNING_MM, seed: int = 0, max_points: int = 20_000_000
) -> FloatArray:
    """Points all over a mesh, denser than one every `spacing`.

    Two random points for every square of side `spacing` (six within it of any place, on average),
    and the vertices.

    Raises:
        ColmapEdgesError: The mesh is so large that more than `max_points` were needed.
    """
    count = int(np.ceil(2 * mesh.area / spacing**2))
    if count > max_points:
        raise ColmapEdgesError(
            f"the mesh needs {count:,} samples every {spacing}; crop it to the scene first"
        )
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=seed)
    return np.concatenate([np.asarray(mesh.vertices), np.asarray(points)])


def thin(
    points: FloatArray, distance: float = THINNING_MM, seed: int = 0, chunk_size: int = 200_000
) -> FloatArray:
    """Drop points in random order until none is within `distance` of another.

    The same as walking the points in that order and keeping each that has no kept one near;
    `chunk_size` points at a time, which changes the memory used and nothing else.
    """
    shuffled = points[np.random.default_rng(seed).permutation(len(points))]
    kept = np.empty((0, 3))
    for chunk in np.array_split(shuffled, max(1, len(shuffled) // chunk_size)):
        if len(kept):
            chunk = chunk[cloud_to_cloud(chunk, kept) > distance]
        kept = np.concatenate([kept, chunk[_first_of_each(chunk, distance)]])
    return kept


def _first_of_each(points: FloatArray, distance: float) -> BoolArray:
    """Which points have no kept point near that comes before them."""
    keep = np.ones(len(points), dtype=bool)
    if len(points) < 2:
        return keep
    pairs = cKDTree(points).query_pairs(distance, output_type="ndarray")
    pairs = pairs[np.argsort(pairs[:, 0], kind="stable")]  # each pair is (i, j) with i < j
    starts = np.searchsorted(pairs[:, 0], np.arange(len(points) + 1))
    for index in np.unique(pairs[:, 0]):
        if keep[index]:
            keep[pairs[starts[index] : starts[index + 1], 1]] = False
    return keep


def evaluate_points(points: FloatArray, reference: DtuReference) -> DtuErrors:
    """Accuracy and completeness of thinned `points` (N, 3)."""
    inside = points[in_mask(points, reference)]
    accuracy = cloud_to_cloud(inside, reference.points)
    judged = reference.points[above_plane(reference)]
    completeness = cloud_to_cloud(judged, points)
    accuracy = accuracy[accuracy < MAX_DISTANCE_MM]
    completeness = completeness[completeness < MAX_DISTANCE_MM]
    means = [float(d.mean()) if len(d) else float("nan") for d in (accuracy, completeness)]
    medians = [float(np.median(d)) if len(d) else float("nan") for d in (accuracy, completeness)]
    return DtuErrors(
        accuracy=means[0],
        completeness=means[1],
        overall=sum(means) / 2,
        accuracy_median=medians[0],
        completeness_median=medians[1],
        points=len(inside),
    )


def in_mask(points: FloatArray, reference: DtuReference) -> BoolArray:
    """Which points (N, 3) fall into a true cell of the mask (cells are centred on box + i res)."""
    cells = np.floor((points - reference.box[0]) / reference.resolution + 0.5).astype(np.int64)
    inside = np.asarray(((cells >= 0) & (cells < reference.mask.shape)).all(axis=1))
    inside[inside] = reference.mask[tuple(cells[inside].T)]
    return inside


def above_plane(reference: DtuReference) -> BoolArray:
    """Which reference points are above the table and in the 60 mm blocks that cover the box."""
    low, high = reference.box
    end = low + (np.floor((high - low) / _BLOCK_MM) + 1) * _BLOCK_MM
    points = reference.points
    above = points @ reference.plane[:3] + reference.plane[3] > 0
    return np.asarray(above & ((points >= low) & (points < end)).all(axis=1))


def evaluate_mesh(mesh: trimesh.Trimesh, reference: DtuReference, seed: int = 0) -> DtuErrors:
    """Accuracy and completeness of a mesh: sampled in the mask's box and thinned to 0.2 mm."""
    low = reference.box[0] - MAX_DISTANCE_MM
    high = reference.box[1] + MAX_DISTANCE_MM
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)]
    near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    cropped = trimesh.Trimesh(mesh.vertices, np.asarray(mesh.faces)[near], process=False)
    samples = sample_mesh(cropped, seed=seed)
    samples = samples[((samples >= low) & (samples <= high)).all(axis=1)]
    return evaluate_points(thin(samples, seed=seed), reference)


def scan_numbers(root: Path) -> Sequence[int]:
    """The paper's scans that `root` holds images of.

    Raises:
        ColmapEdgesError: None of them.
    """
    found = [
        scan
        for scan in PAPER_SCANS
        if any(
            (root / part / name / f"scan{scan}").is_dir()
            for part in PARTS
            for name in ("Rectified", "Cleaned")
        )
    ]
    if not found:
        raise ColmapEdgesError(f"{root} holds none of the scans {PAPER_SCANS}; give --scans")
    return found
