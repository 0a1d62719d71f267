"""Meshing of points and edges: the Python side of the CGAL extension."""
