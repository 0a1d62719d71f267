"""Image files, masks, edge images, and detection of the background."""
