"""Error metrics of meshes, edges and poses."""
