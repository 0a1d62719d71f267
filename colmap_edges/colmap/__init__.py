"""COLMAP models: reading, validation, writing, workspaces, triangulation."""
