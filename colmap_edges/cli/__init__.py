"""The command line: parse, call the pipeline, say what came out, exit."""
