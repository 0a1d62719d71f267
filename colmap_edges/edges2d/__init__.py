"""Images -> 2D edge graphs: working scale, detection, corners, joining; and their index and store."""
