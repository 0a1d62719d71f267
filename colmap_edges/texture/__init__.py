"""Textures of meshes: a view for each triangle, charts of an atlas, levelling of their colours."""
