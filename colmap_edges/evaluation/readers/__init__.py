"""Readers of reference data, of other systems' results, and of our output folders."""
