"""2D edge graphs -> 3D edges, by depths along chains or by the paper's correspondences."""
