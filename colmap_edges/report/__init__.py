"""report.html: one file that shows a run in 3D, over its images and in figures, offline."""

from __future__ import annotations

__all__ = ["Contents", "PictureTaker", "write_report"]
