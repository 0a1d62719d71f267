"""Images -> 2D edge graphs: scale, detection, corners, joining; and their index and store."""
