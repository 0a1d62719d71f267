"""Small valid inputs of every kind that the program reads."""

from __future__ import annotations

import json
import shutil
import struct
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import miniature
import numpy as np
import pycolmap
import scenes

from colmap_edges.colmap.model import Model, model_from_reconstruction
from colmap_edges.core.view import View
from colmap_edges.options import PipelineOptions
from colmap_edges.pipeline.paths import Paths
from colmap_edges.pipeline.run import run

SIZE = (96, 72)


@cache
def scene():
    return scenes.make_scene(num_views=8, width=SIZE[0], height=SIZE[1])


@cache
def view_model() -> Model:
    """The model that images and peers' results belong to; its image ids are 1 to 8."""
    return model_from_reconstruction(scene().reconstruction)


def view_named(name: str) -> View:
    """A view of the usual size whose image is called `name`."""
    return replace(view_model().views[0], name=name)


def remove(path: Path) -> None:
    shutil.rmtree(path, ignore_errors=True)


@cache
def rigged():
    """A model of two rigs of two cameras each, with distortion."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 2, 2, 2
    options.num_points3D = 40
    options.num_points2D_without_point3D = 3
    pycolmap.set_random_seed(0)
    return pycolmap.synthesize_dataset(options)


def write_model(reconstruction, folder: Path, text: bool = False) -> None:
    folder.mkdir()
    (reconstruction.write_text if text else reconstruction.write_binary)(str(folder))


def write_old_model(folder: Path) -> None:
    """Before rigs came, a model was three files."""
    write_model(scene().reconstruction, folder)
    for name in ("rigs", "frames"):
        (folder / f"{name}.bin").unlink(missing_ok=True)


def write_pictures(folder: Path, of: scenes.Scene | None = None) -> None:
    """The images of the views; JPEG, whatever the names say: PNG's checksums let little through."""
    folder.mkdir(parents=True)
    for name, image in (of or scene()).images.items():
        (folder / name).write_bytes(cv2.imencode(".jpg", image)[1].tobytes())


def write_all(folder: Path) -> None:
    """A model, as text for the same reason, and its images; so few that it is soon meshed."""
    few = scenes.make_scene(num_views=5, width=SIZE[0], height=SIZE[1])
    write_pictures(folder / "images", few)
    write_model(few.reconstruction, folder / "sparse", text=True)


def write_picture_formats(folder: Path) -> None:
    folder.mkdir()
    image = next(iter(scene().images.values()))
    color = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    for suffix in ("jpg", "png", "bmp", "tiff", "webp", "ppm", "jp2", "gif"):
        if cv2.haveImageWriter(f"a.{suffix}"):
            cv2.imwrite(str(folder / f"color.{suffix}"), color)
    for suffix in ("png", "tiff"):
        cv2.imwrite(str(folder / f"deep.{suffix}"), image.astype(np.uint16) * 257)
    cv2.imwrite(str(folder / "alpha.png"), np.dstack([color, image]))


def write_config(folder: Path) -> None:
    folder.mkdir()
    (folder / "config.toml").write_text(
        'num_threads = 2\nrandom_seed = 7\nuse_edges = true\noutput_type = "TXT"\n'
        'method = "chains"\n[EdgeGraph]\nmax_gap_points = 2.5\nfilter_regular_length = true\n'
        '[Tracing]\nmin_observations = 4\n[Meshing]\nmethod = "carve"\n'
        "quality_weight = 1e0\n"
    )


def write_curves(folder: Path) -> None:
    """3D edges as PLY in both encodings, NPZ, OBJ and Line3D++'s text."""
    folder.mkdir()
    points = np.arange(18.0).reshape(6, 3)
    edges = np.array([(0, 1), (1, 2), (3, 4), (4, 5)], np.int32)
    np.savez(folder / "curves.npz", points=points, edges=edges)
    header = (
        "ply\nformat {}\nelement vertex 6\nproperty double x\nproperty double y\n"
        "property double z\nelement edge 4\nproperty int vertex1\nproperty int vertex2\n"
        "end_header\n"
    )
    binary = header.format("binary_little_endian 1.0").encode() + points.tobytes() + edges.tobytes()
    (folder / "binary.ply").write_bytes(binary)
    rows = [" ".join(map(str, row)) for row in [*points.tolist(), *edges.tolist()]]
    (folder / "text.ply").write_text(header.format("ascii 1.0") + "\n".join(rows) + "\n")
    (folder / "lines.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in points.tolist()) + "l 1 2 3\nl 4 5 -1\n"
    )
    (folder / "lines.txt").write_text(line3dpp_rows())


def write_meshes(folder: Path) -> None:
    import trimesh

    folder.mkdir()
    for name in ("mesh.ply", "mesh.obj", "mesh.off", "mesh.stl", "mesh.glb"):
        trimesh.creation.icosphere(subdivisions=1).export(folder / name)
    trimesh.creation.box().export(folder / "text.ply", encoding="ascii")


def write_dtu(folder: Path) -> None:
    miniature.write(folder, cameras=3)


def write_repackaged_dtu(folder: Path) -> None:
    (folder / "image").mkdir(parents=True)
    matrices = {}
    for number, (rotation, translation) in enumerate(miniature.poses(3)):
        matrix = np.eye(4)
        matrix[:3] = miniature.CALIBRATION @ np.column_stack([rotation, translation])
        matrices[f"world_mat_{number}"] = matrix
        cv2.imwrite(str(folder / "image" / f"{number:03d}.png"), np.zeros((20, 30), np.uint8))
    np.savez(folder / "cameras_sphere.npz", **matrices)


def write_strecha(folder: Path) -> None:
    folder.mkdir()
    for number, (rotation, translation) in enumerate(miniature.poses(3)):
        cv2.imwrite(str(folder / f"{number:04d}.jpg"), np.zeros((20, 30), np.uint8))
        rows = [*miniature.CALIBRATION, np.zeros(3), *rotation.T, -rotation.T @ translation]
        text = "\n".join(" ".join(map(str, row)) for row in rows) + "\n320 240\n"
        (folder / f"{number:04d}.jpg.camera").write_text(text)
    np.savetxt(folder / "K.txt", miniature.CALIBRATION)


def write_depths(folder: Path) -> None:
    folder.mkdir()
    for view in view_model().views[:2]:
        depth = np.full((SIZE[1] // 2, SIZE[0] // 2), 4, np.float32)
        name = np.array(view.name)
        np.savez(folder / f"{view.name}.npz", depth=depth, scale=0.5, image_name=name)


def line_observations() -> tuple[np.ndarray, dict[int, np.ndarray]]:
    """The ends of a 3D line and its ends in each image."""
    ends = np.array([(-0.4, -0.2, 0.1), (0.4, 0.1, 0.2)])
    return ends, {view.image_id: view.project(ends)[0] for view in view_model().views}


def line3dpp_rows() -> str:
    ends, seen = line_observations()
    words = [1, *ends.ravel(), len(seen)]
    for image_id, pixels in seen.items():
        words += [image_id, 7, *pixels.ravel()]
    return (" ".join(map(str, words)) + "\n") * 3


def write_line3dpp(folder: Path) -> None:
    folder.mkdir()
    (folder / "lines.txt").write_text(line3dpp_rows())


def write_limap1(folder: Path) -> None:
    folder.mkdir()
    ends, seen = line_observations()
    rows = ["2"]
    for track in range(2):
        rows += [f"{track} {len(seen)} {len(seen)}", *(" ".join(map(str, end)) for end in ends)]
        rows += [" ".join(map(str, seen)), " ".join("0" for _ in seen)]
    (folder / "alltracks.txt").write_text("\n".join(rows) + "\n")


def write_limap1_tracks(folder: Path) -> None:
    folder.mkdir()
    ends, seen = line_observations()
    for track in range(2):
        rows = [" ".join(map(str, ends.ravel())), f"{len(seen)} {len(seen)}"]
        rows += ["image_id_list " + " ".join(map(str, seen)), "line_id_list" + " 0" * len(seen)]
        rows += ["line2d_list", *(" ".join(map(str, pixels.ravel())) for pixels in seen.values())]
        (folder / f"track_{track}.txt").write_text("\n".join(rows) + "\n")


def write_limap2(folder: Path) -> None:
    folder.mkdir()
    ends, seen = line_observations()
    track = np.array([(image_id, 0) for image_id in seen], "<u4")
    line = struct.pack("<Q6dQ", 5, *ends.ravel(), len(track)) + track.tobytes() + bytes(8)
    (folder / "lines3D.bin").write_bytes(struct.pack("<Q", 2) + 2 * line)
    images = b"".join(
        struct.pack("<IIQ5dQ", image_id, 0, 1, *pixels.ravel(), 1.0, 5) + bytes(16)
        for image_id, pixels in seen.items()
    )
    (folder / "structures2d.bin").write_bytes(struct.pack("<Q", len(seen)) + images)


def write_openmvg(folder: Path) -> None:
    folder.mkdir()
    ends, seen = line_observations()
    names = {view.image_id: view.name for view in view_model().views}
    views = [{"key": i, "value": {"ptr_wrapper": {"data": {"filename": names[i]}}}} for i in seen]
    points = [
        {
            "key": row,
            "value": {
                "X": ends[row].tolist(),
                "observations": [
                    {"key": i, "value": {"x": pixels[row].tolist()}} for i, pixels in seen.items()
                ],
            },
        }
        for row in range(2)
    ]
    (folder / "sfm.json").write_text(json.dumps({"views": views, "structure": points}, indent=0))


def write_output(folder: Path) -> None:
    """What `reconstruct` makes."""
    inputs = folder.with_name(folder.name + "-inputs")
    scene().write(inputs)
    paths = Paths(image_path=inputs / "images", input_path=inputs / "sparse", output_path=folder)
    run("reconstruct", paths, PipelineOptions(num_threads=1))
    shutil.rmtree(inputs)


WRITERS = {
    "model-bin": lambda folder: write_model(scene().reconstruction, folder),
    "model-bin-3.11": write_old_model,
    "model-bin-rigs": lambda folder: write_model(rigged(), folder),
    "model-txt": lambda folder: write_model(scene().reconstruction, folder, text=True),
    "model-txt-rigs": lambda folder: write_model(rigged(), folder, text=True),
    "pictures": write_pictures,
    "picture-formats": write_picture_formats,
    "config": write_config,
    "curves": write_curves,
    "meshes": write_meshes,
    "dtu": write_dtu,
    "dtu-repackaged": write_repackaged_dtu,
    "strecha": write_strecha,
    "depths": write_depths,
    "line3dpp": write_line3dpp,
    "limap1": write_limap1,
    "limap1-tracks": write_limap1_tracks,
    "limap2": write_limap2,
    "openmvg": write_openmvg,
    "output": write_output,
    "run": write_all,
}
