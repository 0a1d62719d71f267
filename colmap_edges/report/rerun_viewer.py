"""Live display of a run in the rerun viewer, or a recording for it (rerun.io)."""

from __future__ import annotations

import logging
import os
import shutil
import socket
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from colmap_edges.colmap.model import Model
from colmap_edges.core.arrays import ByteArray, IntArray
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.core.upright import up_direction
from colmap_edges.core.view import View
from colmap_edges.errors import ColmapEdgesError
from colmap_edges.export.upright import nearest_axis
from colmap_edges.report.contents import ImagePicture
from colmap_edges.report.faces3d import closed_rings, largest, triangulated
from colmap_edges.report.scene3d import pyramid_depth
from colmap_edges.report.viewpoint import bounds
from colmap_edges.runtime.output import check_apart, check_file, one_line, write_whole
from colmap_edges.surfaces.faces.outlines import Face
from colmap_edges.surfaces.mesh import Mesh

logger = logging.getLogger(__name__)

PORT = 9876  # rerun's default
REMEDY = "run: pip install 'colmap-edges[rerun]'"


class Viewer:
    """Interface of viewers, called by a run with its results; shows nothing."""

    def show_model(self, model: Model) -> None:
        """Show cameras and SfM points; called again after pose refinement."""

    def show_picture(self, view: View, picture: ImagePicture) -> None:
        """Show the reduced picture of an image at its camera."""

    def show_edges(self, edges: Edges3D) -> None:
        """Show the 3D edges."""

    def show_faces(self, faces: Sequence[Face]) -> None:
        """Show the planar faces between the edges."""

    def show_mesh(self, mesh: Mesh) -> None:
        """Show the mesh."""


NO_VIEWER = Viewer()


class RerunViewer(Viewer):
    """Logs results to a rerun.RecordingStream."""

    def __init__(self, rerun: Any, stream: Any) -> None:
        """Log to `stream`; `rerun` is the module."""
        from rerun import blueprint

        self.rerun = rerun
        self.stream = stream
        self.sizes: dict[str, tuple[int, int]] = {}  # of the pictures, by the views' names
        # A single 3D view; by default rerun adds views of the first images.
        view = blueprint.Spatial3DView(origin="/", name="colmap-edges")
        stream.send_blueprint(blueprint.Blueprint(view, collapse_panels=True))

    def log(self, *path: str, **archetypes: Any) -> None:
        """Log archetypes, named with their arguments, at an entity, for all times."""
        made = [getattr(self.rerun, name)(**values) for name, values in archetypes.items()]
        self.stream.log(list(path), *made, static=True)

    def show_model(self, model: Model) -> None:
        """Show cameras as pyramids and SfM points in their colours."""
        low, high = bounds(model, None)
        depth = pyramid_depth(model, float(np.linalg.norm(high - low)))
        up = getattr(self.rerun.ViewCoordinates, up_axis(model))
        self.stream.log("/", up, static=True)
        for view in model.views:
            self.log(
                "cameras",
                view.name,
                Transform3D={"translation": view.center, "mat3x3": view.rotation.T},
                Pinhole={**self.pinhole(view), "image_plane_distance": depth},
            )
        radii = self.rerun.Radius.ui_points(1.5)
        points = {"positions": model.points3D_xyz, "colors": model.points3D_rgb, "radii": radii}
        self.log("points", Points3D=points)

    def show_picture(self, view: View, picture: ImagePicture) -> None:
        """Show the picture of an image within its camera's pyramid."""
        height, width = picture.shape
        self.sizes[view.name] = width, height
        self.log("cameras", view.name, Pinhole=self.pinhole(view))
        encoded = {"contents": picture.photo, "media_type": "image/jpeg"}
        self.log("cameras", view.name, EncodedImage=encoded)

    def pinhole(self, view: View) -> dict[str, Any]:
        """The camera of a view without distortion, in the pixels of its picture."""
        width, height = self.sizes.get(view.name, (view.width, view.height))
        scale = width / view.width
        return {
            "focal_length": float(view.camera.mean_focal_length()) * scale,
            "principal_point": view.image_from_undistorted(np.zeros((1, 2)))[0] * scale,
            "width": width,
            "height": height,
        }

    def show_edges(self, edges: Edges3D) -> None:
        """Show the 3D edges as lines coloured by the number of views that observe them."""
        self.log(
            "edges",
            LineStrips3D={
                "strips": edges.polylines(),
                "colors": colors_of(edges.num_views),
                "labels": [f"edge {i}, {n} views" for i, n in enumerate(edges.num_views)],
                "show_labels": False,
                "radii": self.rerun.Radius.ui_points(1.0),
            },
        )

    def show_faces(self, faces: Sequence[Face]) -> None:
        """Show planar faces as translucent polygons, one colour a plane, with their outlines."""
        shown = largest(faces)
        corners, triangles, colors = triangulated(shown)
        shades = np.column_stack([colors, np.full(len(colors), 128, np.uint8)])
        mesh = {"vertex_positions": corners, "triangle_indices": triangles}
        self.log("faces", Mesh3D={**mesh, "vertex_colors": shades})
        radii = self.rerun.Radius.ui_points(1.0)
        self.log("faces", "outlines", LineStrips3D={"strips": closed_rings(shown), "radii": radii})

    def show_mesh(self, mesh: Mesh) -> None:
        """Show the mesh in its colours."""
        self.log(
            "mesh",
            Mesh3D={
                "vertex_positions": mesh.vertices,
                "triangle_indices": mesh.faces,
                "vertex_colors": mesh.colors,
            },
        )


@contextmanager
def open_viewer(
    target: str, output: Path, overwrite: bool, inputs: Sequence[Path] = ()
) -> Iterator[Viewer]:
    """Yield the viewer that `target` names.

    Args:
        target: "0" for none, "1" for the rerun viewer, otherwise the path of a recording (.rrd),
            which is written when the block succeeds.
        output: output folder of the run, which must not contain the recording.
        overwrite: whether an existing recording is replaced.
        inputs: input folders of the run, which must not contain the recording either.

    Raises:
        ColmapEdgesError: if rerun is not installed, there is no display for its viewer, or the
            recording cannot be written.
    """
    if target == "0":
        yield NO_VIEWER
        return
    if target != "1":
        check_recording_path(Path(target), output, overwrite, inputs)
    rerun = load_rerun()
    stream = rerun.RecordingStream("colmap-edges")
    if target == "1":
        spawn(rerun, stream)
        yield RerunViewer(rerun, stream)
        try:
            stream.flush(timeout_sec=60.0)
        except RuntimeError as error:  # the viewer was closed; the run continues
            logger.warning("the rerun viewer did not receive all data: %s", error)
    else:
        # Kept in memory, since rerun does not report a full disk.
        recording = stream.binary_stream()
        yield RerunViewer(rerun, stream)
        write_whole(Path(target), recording.read(), "recording", overwrite=overwrite)


def load_rerun() -> Any:
    """Import rerun.

    Raises:
        ColmapEdgesError: if it is not installed.
    """
    try:
        import rerun
    except ImportError:
        rerun = None
    if not hasattr(rerun, "RecordingStream"):  # another package has the same name
        raise ColmapEdgesError(f"--rerun needs rerun-sdk, which is not installed; {REMEDY}")
    return rerun


def spawn(rerun: Any, stream: Any) -> None:
    """Start the rerun viewer, or connect to a running one.

    Raises:
        ColmapEdgesError: if it cannot be started.
    """
    on_linux = sys.platform == "linux"
    has_display = not on_linux or any(map(os.environ.get, ("DISPLAY", "WAYLAND_DISPLAY")))
    if not has_display and not is_listening(PORT):
        raise ColmapEdgesError(
            "no display for rerun's viewer; record with --rerun FILE.rrd and open that where "
            f"there is one, or forward port {PORT} to a viewer (ssh -R {PORT}:localhost:{PORT})"
        )
    folders = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    try:
        rerun.spawn(
            port=PORT, executable_path=shutil.which("rerun", path=folders), recording=stream
        )
    except RuntimeError as error:
        raise ColmapEdgesError(f"cannot start rerun's viewer ({error}); {REMEDY}") from error


def is_listening(port: int) -> bool:
    """Whether a local program listens on a port."""
    with socket.socket() as connection:
        connection.settimeout(1)
        return connection.connect_ex(("127.0.0.1", port)) == 0


def check_recording_path(path: Path, output: Path, overwrite: bool, inputs: Sequence[Path]) -> None:
    """Check that a recording can be written.

    Raises:
        ColmapEdgesError: if it cannot.
    """
    place = Path(os.path.realpath(path))
    if not place.parent.is_dir():
        raise ColmapEdgesError(f"cannot write {path}: {path.parent} is not a folder; create it")
    check_apart("--rerun", place, [Path(os.path.realpath(source)) for source in inputs])
    if Path(os.path.realpath(output)) in place.parents:
        raise ColmapEdgesError(f"{path} is inside output_path {output}; choose another place")
    with one_line("cannot write", path):
        check_file(path, overwrite)
    if path.exists() and not is_recording(path):
        raise ColmapEdgesError(
            f"{path} is not a recording of rerun, so it is not replaced; choose another file"
        )


def is_recording(path: Path) -> bool:
    """Whether a file is a recording of rerun, by its first bytes, or empty."""
    with path.open("rb") as file:
        return file.read(3) in (b"RRF", b"")


def up_axis(model: Model) -> str:
    """Rerun's name of the world axis closest to the upward direction."""
    axis = nearest_axis(up_direction(model.views))
    return f"RIGHT_HAND_{axis[-1].upper()}_{'DOWN' if axis.startswith('-') else 'UP'}"


def colors_of(counts: IntArray) -> ByteArray:
    """(E, 3) RGB from dark (smallest count) to bright (largest count, without outliers)."""
    if not len(counts):
        return np.zeros((0, 3), np.uint8)
    low, high = float(counts.min()), float(np.percentile(counts, 95))
    shades = np.clip((counts - low) / max(high - low, 1.0), 0, 1)
    mapped = cv2.applyColorMap(np.rint(255 * shades).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    return np.ascontiguousarray(mapped.reshape(-1, 3)[:, ::-1])
