"""Random scenes with their truth: rooms, facades, CAD objects, smooth bodies and clutter."""
