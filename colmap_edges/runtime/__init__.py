"""Running of work: stages, threads and clusters, cache, output folders, memory."""
