"""Scenes with their truth: random rooms, facades, CAD parts, smooth bodies, clutter; fixed ones."""

FAMILIES = ("rooms", "facades", "cad", "smooth", "clutter")  # of random scenes
