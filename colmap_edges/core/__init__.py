"""Data types shared by all stages: arrays, polylines, views and 3D edges."""
