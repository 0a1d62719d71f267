"""Relations between curves."""
from typing import Any
def regularized(curves: Any, points: Any, noise: Any) -> Any:
    return curves
