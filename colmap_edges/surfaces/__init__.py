"""Points and edges -> triangle mesh: the Python side of the CGAL extension."""
