"""Summary of a run's results for users, shared by the terminal and the report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from colmap_edges.errors import counted
from colmap_edges.report.funnel import counts_by_stage

# Descriptions of output files, with programs that open them.
VIEWERS = {
    "sparse": "COLMAP model: colmap gui, or any program that reads COLMAP models",
    "edges.ply": "3D edges as points and segments: MeshLab, Blender",
    "edges.obj": "3D edges as polylines: Blender, CloudCompare",
    "edges.glb": "3D edges: glTF viewers, Blender, game engines",
    "edges.dxf": "3D edges as lines, arcs, circles, ellipses, splines: CAD programs",
    "edges.step": "3D edges as lines, circles, ellipses, splines: CAD programs",
    "svg": "3D edges drawn into each image: Inkscape, a web browser",
    "structures": "3D edges as lines: LIMAP, with the model in sparse/",
    "edges.json": "3D edges as data: IDs of points in sparse/, length, views, residual, curves",
    "mesh.ply": "triangle mesh: MeshLab, Blender, CloudCompare",
    "mesh.obj": "triangle mesh: MeshLab, Blender, CloudCompare",
    "mesh.glb": "triangle mesh: Blender, any glTF viewer",
    "alignment.json": "unit, and the transform from the frame of the run: any text editor",
    "faces.json": "planar faces between the edges, and round ones, with their views",
    "edge_graphs": "2D edge graphs: numpy.load",
    "overlays": "pictures of the 2D edge graphs: any viewer of pictures",
    "report.html": "report with all results, which needs no network: any web browser",
    "report.json": "options, versions, counts, times and memory of each stage",
}
# Generic folder names, unsuitable as a scene's name.
COMMON_NAMES = {
    *("images", "image", "photos", "input", "inputs", "sparse", "model", "models", "colmap"),
    *("output", "outputs", "out", "edges", "dense", "undistorted", "workspace", "data", "tmp"),
}


def outcome(record: Mapping[str, Any]) -> dict[str, str]:
    """The results of a run: one short text each for images, edges, points and mesh.

    Args:
        record: the contents of report.json.

    Returns:
        The texts by name, in display order; edges, faces or mesh are missing if the command
        makes none.
    """
    counts = counts_by_stage(record["stages"])
    read, detect = counts.get("read", {}), counts.get("detect", {})
    write, mesh = counts.get("write"), counts.get("mesh")
    unit = record.get("alignment", {}).get("unit") or "scene units"
    texts = {"Images": images_text(read, detect)}
    if write is not None:
        texts["Edges"] = edges_text(write, unit)
    elif detect:
        texts["Edges"] = (
            f"{counted(detect['polylines'], '2D polyline')} of "
            f"{counted(detect['edge_pixels'], 'pixel')}"
        )
    texts["Points"] = counted(read["points3D"], "SfM point")
    if (lenses := counts.get("lenses", {})) and lenses["refined"]:
        texts["Lenses"] = (
            "second coefficient of distortion refined: held-out SfM points fit "
            f"{lenses['held_out_gain']:.0%} better"
        )
    if "held_out_gain" in (poses := counts.get("trace", {}).get("poses", {})):
        texts["Poses"] = poses_text(poses)
    if write is not None:
        points = counted(write["edge_points"], "edge point")
        texts["Points"] += f" and {points} in the written model"
    if (faces := counts.get("faces")) is not None:
        texts["Faces"] = faces_text(faces, unit)
    if (found := counts.get("round_faces")) and found["round_faces"]:
        texts["Round faces"] = round_text(found)
    if (sky := counts.get("sky", {})) and sky["images_with_sky"]:
        texts["Sky"] = (
            f"sky or far backdrop in {sky['images_with_sky']:,} of "
            f"{counted(sky['images'], 'image')}: its rays keep the mesh open"
        )
    if mesh is not None:
        vertices = counted(mesh["vertices"], "vertex", "vertices")
        texts["Mesh"] = f"{counted(mesh['faces'], 'triangle')}, {vertices}"
        if not mesh["faces"]:
            texts["Mesh"] = "empty"
    return texts


def images_text(read: Mapping[str, Any], detect: Mapping[str, Any]) -> str:
    """Numbers of images used, unused and without edges."""
    parts = [f"{read['images_with_poses']:,} with poses"]
    if read.get("images_without_poses"):
        parts.append(f"{read['images_without_poses']:,} without (not used)")
    if detect.get("images_without_edges"):
        parts.append(f"{detect['images_without_edges']:,} in which no edge was detected")
    return ", ".join(parts)


def poses_text(poses: Mapping[str, Any]) -> str:
    """Whether poses were refined, and what held-out points say."""
    if poses["refined"]:
        return f"refined on edges: held-out points fit {poses['held_out_gain']:.0%} better"
    return "kept: held-out points do not fit better to poses that are refined on edges"


def edges_text(write: Mapping[str, Any], unit: str) -> str:
    """Number, total length in a unit and median residual of the 3D edges."""
    if not write["edges"]:
        return "no 3D edge was found"
    text = f"{write['edges']:,} in 3D, total length {write['length']:,.4g} {unit}"
    if (residual := write.get("median_residual_px")) is not None:
        text += f", median reprojection error {residual:.2g} px"
    return text


def faces_text(faces: Mapping[str, Any], unit: str) -> str:
    """Number and total area of the planar faces in a unit, and whether the mesh uses them."""
    if not faces["planar_faces"]:
        return "no planar face was found"
    if not faces.get("face_points"):
        used = "only in faces.json: SfM points on them suffice, or images are overexposed"
    else:
        used = f"{counted(faces['face_points'], 'point')} on them added to the mesh"
    area = f"{faces['area']:,.4g}"
    return f"{faces['planar_faces']:,} planar, total area {area} square {unit}; {used}"


def round_text(found: Mapping[str, Any]) -> str:
    """Number of the round faces, and of points on them in the mesh."""
    points = counted(found["round_points"], "point")
    return f"{found['round_faces']:,}; {points} on them added to the mesh"


def headline(record: Mapping[str, Any]) -> str:
    """The results in one line."""
    counts = counts_by_stage(record["stages"])
    parts = []
    if write := counts.get("write"):
        parts.append(
            f"{counted(write['edges'], '3D edge')}, total length {write['length']:,.4g} scene units"
            if write["edges"]
            else "no 3D edge"
        )
    if (faces := counts.get("faces")) and faces["planar_faces"]:
        parts.append(counted(faces["planar_faces"], "planar face"))
    if mesh := counts.get("mesh"):
        parts.append(f"a mesh of {counted(mesh['faces'], 'triangle')}")
    text = " and ".join(filter(None, [", ".join(parts[:-1]), *parts[-1:]])) or "A COLMAP model"
    text += f", from {counted(counts['read']['images_with_poses'], 'image')}."
    return text[:1].upper() + text[1:]


NEXT = ("mesh.glb", "mesh.obj", "mesh.ply", "edges.glb", "edges.ply")  # what to open, first best


def verdict(record: Mapping[str, Any], folder: Path) -> str:
    """Whether all went well, in one line, and what to do next.

    Args:
        record: the contents of report.json.
        folder: the output folder.
    """
    counts, findings = counts_by_stage(record["stages"]), record["findings"]
    read = counts["read"]
    posed = read["images_with_poses"]
    used = posed - counts.get("detect", {}).get("images_without_edges", 0)
    every = posed + (read.get("images_without_poses") or 0)
    parts = [f"{used:,} of {counted(every, 'image')} used"]
    residual = counts.get("write", {}).get("median_residual_px")
    if residual is not None:
        parts.append(f"median residual {residual:.2g} px")
    parts.append(f"{counted(len(findings), 'finding')} below" if findings else "no problems")
    found = next((name for name in NEXT if (folder / name).exists()), None)
    program = VIEWERS[found].rpartition(": ")[2].partition(", ")[0] if found else ""
    return f"{', '.join(parts)}." + (f" Next: open {found} in {program}." if found else "")


def scene_name(paths: Mapping[str, Any]) -> str:
    """A name for the scene: the innermost input folder whose name is not generic."""
    for path in filter(None, (paths.get("image_path"), paths.get("input_path"))):
        for name in reversed(Path(path).parts[1:]):
            if name.lower() not in COMMON_NAMES and not name.isdigit():
                return name
    return "scene"
