"""Export of 3D edges and meshes to the file formats of other programs."""
