"""Refinement of lenses and poses, on SfM points and edges."""
