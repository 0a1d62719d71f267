"""Tracing of 3D edges from 2D edge graphs, by depths along chains or by the paper's method."""
