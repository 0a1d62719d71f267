"""Benchmarks' data and rules: DTU, Strecha, scenes with any reference."""
