"""`python -m colmap_edges`: the same as the command `colmap-edges`."""

from __future__ import annotations

from colmap_edges.cli.main import main

main()
