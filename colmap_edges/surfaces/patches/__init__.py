"""Points with normals and noise where images have texture, by correlation of windows."""
