"""What came out of a run, in a user's words: the same in the terminal and on the page."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from colmap_edges.report.diagnosis import counts_by_stage

# What to open the files of an output folder with.
VIEWERS = {
    "sparse": "COLMAP model: colmap gui, or any program that reads COLMAP models",
    "edges.ply": "3D edges: MeshLab, Blender",
    "edges.obj": "3D edges as polylines: Blender, CloudCompare",
    "edges.glb": "3D edges: glTF viewers, Blender, game engines",
    "edges.dxf": "3D edges as lines, arcs, circles, ellipses, splines: CAD programs",
    "edges.json": "what each edge is: points in the model, length, views, residual, curves",
    "mesh.ply": "mesh: MeshLab, Blender, CloudCompare",
    "mesh.obj": "mesh: MeshLab, Blender, CloudCompare",
    "mesh.glb": "mesh: Blender, any glTF viewer",
    "edge_graphs": "2D edge graphs: numpy.load",
    "overlays": "pictures of the 2D edge graphs",
    "report.html": "all of it to look at: a web browser, no network needed",
    "report.json": "options, versions, counts, times and memory of every stage",
}
# Names of folders that do not tell one scene from another.
COMMON_NAMES = {
    *("images", "image", "photos", "input", "inputs", "sparse", "model", "models", "colmap"),
    *("output", "outputs", "out", "edges", "dense", "undistorted", "workspace", "data", "tmp"),
}


def outcome(record: Mapping[str, Any]) -> dict[str, str]:
    """What came out, one short text each for images, edges, points and mesh.

    Args:
        record: what report.json holds.

    Returns:
        The texts by their names, in the order in which they are said; a command that makes no
        edges or no mesh has no text for them.
    """
    counts = counts_by_stage(record["stages"])
    read, detect = counts.get("read", {}), counts.get("detect", {})
    write, mesh = counts.get("write"), counts.get("mesh")
    said = {"Images": images_text(read, detect)}
    if write is not None:
        said["Edges"] = edges_text(write)
    elif detect:
        said["Edges"] = f"{detect['polylines']:,} 2D polylines of {detect['edge_pixels']:,} pixels"
    said["Points"] = f"{read['points3D']:,} SfM points"
    if write is not None:
        said["Points"] += f" and {write['edge_points']:,} edge points in the written model"
    if mesh is not None:
        said["Mesh"] = f"{mesh['faces']:,} triangles with {mesh['vertices']:,} corners"
        if not mesh["faces"]:
            said["Mesh"] = "none: it came out empty"
    return said


def images_text(read: Mapping[str, Any], detect: Mapping[str, Any]) -> str:
    """How many images took part, and how many gave nothing."""
    parts = [f"{read['images_with_poses']:,} with poses"]
    if read.get("images_without_poses"):
        parts.append(f"{read['images_without_poses']:,} without (not used)")
    if detect.get("images_without_edges"):
        parts.append(f"{detect['images_without_edges']:,} in which no edge was detected")
    return ", ".join(parts)


def edges_text(write: Mapping[str, Any]) -> str:
    """How many 3D edges there are, how long they are and how well they fit the images."""
    if not write["edges"]:
        return "no 3D edge came out"
    text = f"{write['edges']:,} in 3D, {write['length']:,.4g} scene units long together"
    if (residual := write.get("median_residual_px")) is not None:
        text += f", {residual:.2g} px from where images show them (median)"
    return text


def headline(record: Mapping[str, Any]) -> str:
    """What came out in one line."""
    counts = counts_by_stage(record["stages"])
    parts = []
    if write := counts.get("write"):
        parts.append(
            f"{write['edges']:,} 3D edges, {write['length']:,.4g} scene units long together"
            if write["edges"]
            else "No 3D edge"
        )
    if mesh := counts.get("mesh"):
        parts.append(f"a mesh of {mesh['faces']:,} triangles")
    text = " and ".join(parts) or "A COLMAP model"
    text += f", from {counts['read']['images_with_poses']:,} images."
    return text[:1].upper() + text[1:]


def scene_name(paths: Mapping[str, Any]) -> str:
    """What to call the scene: the innermost folder of the input that is not named as all are."""
    for path in filter(None, (paths.get("image_path"), paths.get("input_path"))):
        for name in reversed(Path(path).parts[1:]):
            if name.lower() not in COMMON_NAMES and not name.isdigit():
                return name
    return "scene"
