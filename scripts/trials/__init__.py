"""Runs of the program on random scenes with truth: their figures, rules, tables and pictures."""
