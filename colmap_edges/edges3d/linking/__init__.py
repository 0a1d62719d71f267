"""Joining of 3D edge pieces to whole edges, and their extension to corners."""
