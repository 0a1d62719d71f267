"""The command line: parses flags, calls the pipeline, prints a summary."""
