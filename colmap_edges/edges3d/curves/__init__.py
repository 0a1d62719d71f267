"""Parametric curves of 3D edges: lines, arcs, ellipses, splines, with standard deviations."""
