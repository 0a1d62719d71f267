"""Errors of meshes, 3D edges and poses by the protocols of the field, and tables of them."""
