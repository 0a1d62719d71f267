"""report.html: a self-contained page with 3D viewer, image overlays and figures of a run."""

from __future__ import annotations

__all__ = ["Contents", "PictureVisitor", "write_report"]
