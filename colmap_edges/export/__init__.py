"""Writing and reading of 3D edges, faces and meshes in the formats of this and other programs."""
