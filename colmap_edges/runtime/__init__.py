"""How work is run: stages, threads and clusters, cache, output folders, memory."""
