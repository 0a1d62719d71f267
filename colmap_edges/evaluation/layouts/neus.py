"""A scan of DTU as NeuS and IDR repackage it: image/ and cameras*.npz."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from colmap_edges.errors import ColmapEdgesError
from colmap_edges.evaluation.layouts import dtu
from colmap_edges.evaluation.readers.arrays import read_arrays
from colmap_edges.evaluation.scenes import Scene, reference_of
from colmap_edges.evaluation.triangulation import PosedImage, posed_image


def is_layout(folder: Path) -> bool:
    """Whether `folder` has the layout."""
    return (folder / "image").is_dir() and any(folder.glob("cameras*.npz"))


def posed_images(folder: Path) -> tuple[Path, list[PosedImage]]:
    """Images and poses of a folder: image/NNN.png, world_mat_N of cameras*.npz.

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
    images = []
    for index, path in enumerate(paths):
        matrix = data.get(f"world_mat_{index}", np.empty(0))
        if matrix.ndim != 2 or min(matrix.shape) < 3 or matrix.shape[1] < 4:
            raise ColmapEdgesError(f"{cameras[0]} holds no matrix world_mat_{index}")
        parts = dtu.decompose_projection(matrix[:3, :4].astype(np.float64))
        images.append(posed_image(path, *parts))
    return folder / "image", images


def folder_scene(folder: Path, reference_path: Path | None) -> Scene:
    """The scene of a folder.

    Args:
        folder: With image/ and cameras*.npz; `{scan}` in paths of peers becomes its name.
        reference_path: Depth maps, mesh or cloud; or the official data's root, then the number in
            the folder's name is the scan; or none.

    Raises:
        ColmapEdgesError: Images or matrices are missing.
    """
    image_path, posed = posed_images(folder)
    digits = "".join(c for c in folder.name if c.isdigit())
    load = partial(reference_of, reference_path, ())
    if reference_path is not None and digits and dtu.find_optional(reference_path, "Points"):
        load = partial(dtu.reference_of, reference_path, int(digits))
    return Scene(
        name=folder.name,
        image_path=image_path,
        posed=posed,
        load_reference=load,
        scan=folder.name,
        unit="mm",
    )
