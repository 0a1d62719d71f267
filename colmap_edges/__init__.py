"""3D edges, straight and curved, for COLMAP models, and meshes that follow them.

`reconstruct(reconstruction, image_path, options)` returns the edges of a pycolmap.Reconstruction,
and `mesh(reconstruction, edges)` a mesh that follows them. Names are imported on first use, so
that the command line starts fast.
"""

from __future__ import annotations

# pycolmap exports compression symbols that corrupt memory if they are found before those of zlib.
# Importing zlib here makes it come first, whichever module imports pycolmap.
import zlib  # noqa: F401
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from colmap_edges.core.curves3d import Curves3D
    from colmap_edges.core.edges3d import Edges3D
    from colmap_edges.edges3d.curves.fitting import fit_curves
    from colmap_edges.errors import ColmapEdgesError
    from colmap_edges.export.dxf import write_dxf, write_dxf_polylines
    from colmap_edges.export.edges import write_obj
    from colmap_edges.export.edges_json import write_json
    from colmap_edges.export.glb import write_glb
    from colmap_edges.export.graph import to_networkx
    from colmap_edges.export.limap import write_structures
    from colmap_edges.export.meshes import read_mesh, write_mesh
    from colmap_edges.export.ply import write_ply
    from colmap_edges.export.step import write_step
    from colmap_edges.export.svg import write_svg
    from colmap_edges.export.tables import EdgeTables, to_pandas
    from colmap_edges.export.written import WrittenEdges, read_edges
    from colmap_edges.options import PipelineOptions, preset
    from colmap_edges.pipeline.reconstruct import EdgeReconstruction, reconstruct
    from colmap_edges.surfaces.faces.finding import Faces
    from colmap_edges.surfaces.faces.outlines import Face
    from colmap_edges.surfaces.mesh import Mesh
    from colmap_edges.surfaces.mesher import mesh

__version__ = "0.1.0"
__all__ = [
    "ColmapEdgesError",
    "Curves3D",
    "EdgeReconstruction",
    "EdgeTables",
    "Edges3D",
    "Face",
    "Faces",
    "Mesh",
    "PipelineOptions",
    "WrittenEdges",
    "__version__",
    "fit_curves",
    "mesh",
    "preset",
    "read_edges",
    "read_mesh",
    "reconstruct",
    "to_networkx",
    "to_pandas",
    "write_dxf",
    "write_dxf_polylines",
    "write_glb",
    "write_json",
    "write_mesh",
    "write_obj",
    "write_ply",
    "write_step",
    "write_structures",
    "write_svg",
]
_MODULES = {
    "ColmapEdgesError": "errors",
    "Curves3D": "core.curves3d",
    "EdgeReconstruction": "pipeline.reconstruct",
    "EdgeTables": "export.tables",
    "Edges3D": "core.edges3d",
    "Face": "surfaces.faces.outlines",
    "Faces": "surfaces.faces.finding",
    "Mesh": "surfaces.mesh",
    "PipelineOptions": "options",
    "WrittenEdges": "export.written",
    "fit_curves": "edges3d.curves.fitting",
    "mesh": "surfaces.mesher",
    "preset": "options",
    "read_edges": "export.written",
    "read_mesh": "export.meshes",
    "reconstruct": "pipeline.reconstruct",
    "to_networkx": "export.graph",
    "to_pandas": "export.tables",
    "write_dxf": "export.dxf",
    "write_dxf_polylines": "export.dxf",
    "write_glb": "export.glb",
    "write_json": "export.edges_json",
    "write_mesh": "export.meshes",
    "write_obj": "export.edges",
    "write_ply": "export.ply",
    "write_step": "export.step",
    "write_structures": "export.limap",
    "write_svg": "export.svg",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)


def __dir__() -> list[str]:
    """The public names, for completion."""
    return sorted(__all__)
