"""Errors of meshes, 3D edges and poses by established protocols, and tables of them."""
