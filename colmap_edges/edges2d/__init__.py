"""Images -> 2D edge graphs: detection, upsampling, corners, joining; and their index and store."""
