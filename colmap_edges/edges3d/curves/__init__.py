"""What 3D edges are: lines, circular and elliptic arcs, splines, with deviations."""
