"""Tracing of 3D edges by depths along the chains of each view: the default method."""
