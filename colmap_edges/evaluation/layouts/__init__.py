"""Layouts of data sets, converted to scenes: one module a layout."""
