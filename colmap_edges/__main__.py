"""`python -m colmap_edges`: the same as the command `colmap-edges`."""

from colmap_edges.cli import main

main()
