"""Refinement of poses on SfM points and edges together."""
