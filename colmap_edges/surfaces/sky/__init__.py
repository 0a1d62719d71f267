"""Detection of the sky in images without masks."""
