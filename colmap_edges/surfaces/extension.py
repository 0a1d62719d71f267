"""The compiled mesher, which is built with CGAL and may be missing."""

from __future__ import annotations

from typing import Any

from colmap_edges.errors import ColmapEdgesError


def load_extension() -> Any:
    """Import the compiled mesher.

    Raises:
        ColmapEdgesError: if it is not built.
    """
    try:
        from colmap_edges import _mesher
    except ImportError as error:
        raise ColmapEdgesError(
            f"the mesher is not built ({error}); "
            "run: apt-get install libcgal-dev, then reinstall colmap-edges"
        ) from error
    return _mesher
