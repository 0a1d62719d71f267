"""Hot loops in C++ (nanobind); each is tested against a numpy reference."""

from __future__ import annotations
