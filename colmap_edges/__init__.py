"""3D edges, straight and curved, for COLMAP models, and meshes that follow them.

`reconstruct(reconstruction, image_path, options)` gives the edges of a pycolmap.Reconstruction and
`mesh(reconstruction, edges)` a mesh that follows them; the modules hold the stages. Names are
imported when first used, so that the command line starts at once.
"""

from __future__ import annotations

# pycolmap brings compression symbols of its own, which corrupt memory where they are found before
# those of zlib. Loaded here, zlib comes first whatever module of this package imports pycolmap.
import zlib  # noqa: F401
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from colmap_edges.core.curves3d import Curves3D
    from colmap_edges.core.edges3d import Edges3D
    from colmap_edges.edges3d.curves.fitting import fit_curves
    from colmap_edges.errors import ColmapEdgesError
    from colmap_edges.evaluation.readers.results import WrittenEdges, read_edges
    from colmap_edges.export.graph import to_networkx
    from colmap_edges.export.meshes import write_mesh
    from colmap_edges.options import PipelineOptions, preset
    from colmap_edges.pipeline.reconstruct import EdgeReconstruction, reconstruct
    from colmap_edges.surfaces.mesh import Mesh
    from colmap_edges.surfaces.mesher import mesh

__version__ = "0.1.0"
__all__ = [
    "ColmapEdgesError",
    "Curves3D",
    "EdgeReconstruction",
    "Edges3D",
    "Mesh",
    "PipelineOptions",
    "WrittenEdges",
    "__version__",
    "fit_curves",
    "mesh",
    "preset",
    "read_edges",
    "reconstruct",
    "to_networkx",
    "write_mesh",
]
_MODULES = {
    "ColmapEdgesError": "errors",
    "Curves3D": "core.curves3d",
    "EdgeReconstruction": "pipeline.reconstruct",
    "Edges3D": "core.edges3d",
    "Mesh": "surfaces.mesh",
    "PipelineOptions": "options",
    "WrittenEdges": "evaluation.readers.results",
    "fit_curves": "edges3d.curves.fitting",
    "mesh": "surfaces.mesher",
    "preset": "options",
    "read_edges": "evaluation.readers.results",
    "reconstruct": "pipeline.reconstruct",
    "to_networkx": "export.graph",
    "write_mesh": "export.meshes",
}


def __getattr__(name: str) -> Any:
    """Import a public name on first use."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
