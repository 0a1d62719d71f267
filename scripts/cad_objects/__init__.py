"""Textureless CAD objects seen from all sides, with ground truth."""
