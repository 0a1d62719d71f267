"""COLMAP models: reading, validation, writing, workspaces."""
