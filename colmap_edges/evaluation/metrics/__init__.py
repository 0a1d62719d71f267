"""Figures of how good meshes, edges and poses are."""
