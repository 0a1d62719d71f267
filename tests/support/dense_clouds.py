"""Dense clouds of the synthetic scene, and miniatures of the files of COLMAP and OpenMVS."""

import numpy as np
from scenes import solids

PLY = (
    "ply\nformat {order} 1.0\ncomment a miniature\nelement vertex {count}\n{properties}end_header\n"
)
FUSED = [(name, "float") for name in ("x", "y", "z", "nx", "ny", "nz")]
FUSED += [(name, "uchar") for name in ("red", "green", "blue")]


def header(order, count, properties):
    """A PLY's header of vertices only."""
    lines = "".join(f"property {kind} {name}\n" for name, kind in properties)
    return PLY.format(order=order, count=count, properties=lines).encode()


def fused_ply(points, color=(10, 20, 30)):
    """The bytes of COLMAP's fused.ply."""
    rows = np.zeros(len(points), [("xyz", "<f4", 3), ("normal", "<f4", 3), ("rgb", "u1", 3)])
    rows["xyz"], rows["rgb"] = points, color
    return header("binary_little_endian", len(points), FUSED) + rows.tobytes()


def fused_vis(tracks):
    """The bytes of COLMAP's fused.ply.vis; a track is a list of images."""
    words = [word for track in tracks for word in (len(track), *track)]
    return np.array([len(tracks)], "<u8").tobytes() + np.array(words, "<u4").tobytes()


def openmvs_ply(points, tracks):
    """The bytes of an OpenMVS cloud, whose vertices have lists of views and of their weights."""
    properties = [("x", "float32"), ("y", "float32"), ("z", "float32")]
    properties += [(name, "uint8") for name in ("red", "green", "blue")]
    properties += [("view_indices", "list uint8 uint32"), ("view_weights", "list uint8 float32")]
    rows = b"".join(
        np.array(point, "<f4").tobytes()
        + bytes([1, 2, 3, len(track)])
        + np.array(track, "<u4").tobytes()
        + bytes([len(track)])
        + np.ones(len(track), "<f4").tobytes()
        for point, track in zip(points, tracks, strict=True)
    )
    return header("binary_little_endian", len(points), properties) + rows


def on_solids(model, spacing=0.04):
    """Points on a grid on the faces of the scene's solids, normals, and the views of each.

    A view sees a point of a face that faces it; the two solids hide little of each other.
    """
    points, normals = [], []
    for face in (face for body in solids() for face in body):
        first, second = face.corners[1] - face.corners[0], face.corners[-1] - face.corners[0]
        counts = [int(np.linalg.norm(side) / spacing) for side in (first, second)]
        u, v = np.meshgrid(*((np.arange(count) + 0.5) / count for count in counts))
        keep = (u + v < 1) if len(face.corners) == 3 else np.ones(u.shape, bool)
        grid = face.corners[0] + u[keep][:, None] * first + v[keep][:, None] * second
        points.append(grid)
        normals.append(np.broadcast_to(face.normal, grid.shape))
    points, normals = np.concatenate(points), np.concatenate(normals)
    tracks = [[] for _ in points]
    for index, view in enumerate(model.views):
        inside = view.holds(*view.project(points))
        facing = np.einsum("ni,ni->n", view.center - points, normals) > 0.3
        for row in np.flatnonzero(inside & facing):
            tracks[row].append(index)
    seen = np.array([len(track) > 1 for track in tracks])
    return points[seen], normals[seen], [track for track in tracks if len(track) > 1]
