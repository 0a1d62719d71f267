"""2D edge graphs of images: working scale, detection, corners, joining, index and storage."""
