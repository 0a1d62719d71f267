"""The stages of a run, in order: read, detect, trace, write, mesh."""
