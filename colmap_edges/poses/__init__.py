"""Poses refined on SfM points and edges together."""
