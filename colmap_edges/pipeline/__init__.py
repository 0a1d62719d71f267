"""The stages in order: read, detect, trace, write, mesh."""
