"""Errors of meshes and 3D edges by the protocols of the field, and tables of them."""
