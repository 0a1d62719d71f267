"""Pieces of 3D edges joined to whole ones and led to corners."""
