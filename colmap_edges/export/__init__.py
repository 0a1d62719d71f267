"""3D edges and meshes as files for other programs."""
