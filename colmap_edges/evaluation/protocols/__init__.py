"""Data and protocols of benchmarks: DTU, Strecha, scenes with any reference."""
