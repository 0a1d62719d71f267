"""Units of length that files may name, with their codes in DXF files, and names of axes."""

from __future__ import annotations

from colmap_edges.declared_options import shown
from colmap_edges.errors import OptionError

METRES = {"mm": 0.001, "cm": 0.01, "m": 1.0, "km": 1000.0, "in": 0.0254, "ft": 0.3048}
INSUNITS = {"": 0, "in": 1, "ft": 2, "mm": 4, "cm": 5, "m": 6, "km": 7}  # of DXF
IMPERIAL = ("in", "ft")
AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
AXES |= {f"-{name}": (-x, -y, -z) for name, (x, y, z) in AXES.items()}


def metres(unit: str) -> float:
    """Length of a unit in metres; 1 of an unknown one, whose name is empty.

    Raises:
        OptionError: if there is no unit of that name.
    """
    if unit not in ("", *METRES):
        raise OptionError(f"unit is {shown(unit)}; give one of: {', '.join(METRES)}")
    return METRES.get(unit, 1.0)
