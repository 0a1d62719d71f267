"""COLMAP models: reading, checking, writing, workspaces, triangulation."""
