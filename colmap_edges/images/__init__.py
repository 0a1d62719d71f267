"""Image files, masks, and where images show the background."""
