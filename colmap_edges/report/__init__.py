"""report.html: one file that shows a run in 3D, over its images and in figures, offline."""

from __future__ import annotations

from colmap_edges.report.contents import Contents
from colmap_edges.report.page import write_report
from colmap_edges.report.pictures import PictureTaker

__all__ = ["Contents", "PictureTaker", "write_report"]
