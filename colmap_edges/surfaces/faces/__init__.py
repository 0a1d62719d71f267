"""Planar faces between 3D edges, and points on them for the mesher."""
