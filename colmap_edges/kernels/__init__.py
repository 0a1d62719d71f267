"""C++ kernels (nanobind) of the time-critical loops, tested against numpy references."""

from __future__ import annotations
