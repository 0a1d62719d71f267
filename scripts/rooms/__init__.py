"""Furnished rooms, mostly plain, seen from inside: with their true surface, curves and poses."""
