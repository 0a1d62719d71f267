"""3D edges, straight and curved, for COLMAP models, and meshes that follow them."""

__version__ = "0.1.0"
