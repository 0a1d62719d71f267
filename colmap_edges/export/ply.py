"""Writing of edges and meshes as binary PLY, and reading of a PLY's elements."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from colmap_edges.core.checks import checked
from colmap_edges.core.edges3d import Edges3D
from colmap_edges.errors import ColmapEdgesError, extra
from colmap_edges.runtime.input_files import open_file
from colmap_edges.runtime.output import write_whole
from colmap_edges.surfaces.mesh import Mesh

EDGES_VERTEX = np.dtype([("xyz", "<f8", 3), ("rgb", "u1", 3)])
EDGES_HEADER = """ply
format binary_little_endian 1.0
comment 3D edges by colmap-edges
element vertex {vertices}
property double x
property double y
property double z
property uchar red
property uchar green
property uchar blue
element edge {edges}
property int vertex1
property int vertex2
end_header
"""
MESH_VERTEX = {
    number: np.dtype([("xyz", f"<{number}", 3), ("rgba", "u1", 4)]) for number in ("f4", "f8")
}
MESH_FACE = np.dtype([("count", "u1"), ("indices", "<i4", 3)])
MESH_HEADER = """ply
format binary_little_endian 1.0
comment mesh by colmap-edges
element vertex {vertices}
property {number} x
property {number} y
property {number} z
property uchar red
property uchar green
property uchar blue
property uchar alpha
element face {faces}
property list uchar int vertex_indices
end_header
"""


@checked
def write_ply(edges: Edges3D, path: Path | str, *, overwrite: bool = True) -> None:
    """Write a binary PLY with `vertex` and `edge` elements.

    Raises:
        ColmapEdgesError: if the file cannot be written, or exists and `overwrite` is false.
    """
    vertices = np.empty(edges.num_points, EDGES_VERTEX)
    vertices["xyz"], vertices["rgb"] = edges.points, edges.colors
    segments = edges.segments
    header = EDGES_HEADER.format(vertices=len(vertices), edges=len(segments))
    data = header.encode() + vertices.tobytes() + segments.astype("<i4").tobytes()
    write_whole(Path(path), data, "edges", overwrite=overwrite)


def mesh_as_ply(mesh: Mesh, number: str) -> bytes:
    """A binary PLY of the mesh, with coordinates of type f4, as most readers expect, or f8."""
    vertices = np.full(len(mesh.vertices), 255, MESH_VERTEX[number])
    vertices["xyz"], vertices["rgba"][:, :3] = mesh.vertices, mesh.colors
    faces = np.full(len(mesh.faces), 3, MESH_FACE)
    faces["indices"] = mesh.faces
    name = {"f4": "float", "f8": "double"}[number]
    header = MESH_HEADER.format(vertices=len(vertices), faces=len(faces), number=name)
    return header.encode() + vertices.tobytes() + faces.tobytes()


def read_ply(path: Path) -> dict[str, NDArray[Any]]:
    """Read the elements of a PLY file as structured arrays, one field a property.

    Raises:
        ColmapEdgesError: The file is not a PLY, or damaged; or plyfile is not installed.
    """
    with open_file(path) as file, extra("reading PLY files", "evaluation"):
        from plyfile import PlyData

        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of NaN, which readers check
                # Of a file, not of its bytes, plyfile reads an element without lists at once.
                elements = PlyData.read(file).elements
            return {element.name: np.array(element.data) for element in elements}
        except Exception as error:  # the exceptions of plyfile's parser are not documented
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise ColmapEdgesError(f"{path} is not a readable PLY file: {reason}") from error
