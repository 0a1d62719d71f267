"""Surfaces of revolution without texture, from their outlines in many views, and points on them."""
