"""Textureless CAD objects, seen from all around: edges from cameras alone, with known truth."""
