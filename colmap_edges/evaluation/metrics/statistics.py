"""Error statistics: MAE, RMSE, sigma and quantiles, defined once for all tables."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Record = dict[str, Any]  # figures by name, as in evaluation.json


def summarize(errors: ArrayLike) -> Record:
    """Statistics of signed errors e (any shape), in the unit of e; all NaN without errors.

    Returns:
        `count`, `mae` (mean of |e|), `rmse`, `sigma` (standard deviation of |e|, so rmse^2 = mae^2
        + sigma^2, which the figures of the paper's tables satisfy), `bias` (mean of e), and
        `median`, `p90`, `p95` of |e|.
    """
    signed = np.asarray(errors, dtype=np.float64).ravel()
    count = signed.size
    signed = signed if count else np.full(1, np.nan)
    size = np.abs(signed)
    median, p90, p95 = (float(q) for q in np.percentile(size, (50, 90, 95)))
    return {
        "count": count,
        "mae": float(size.mean()),
        "rmse": float(np.sqrt(np.mean(signed**2))),
        "sigma": float(size.std()),
        "bias": float(signed.mean()),
        "median": median,
        "p90": p90,
        "p95": p95,
    }


def mean(values: ArrayLike) -> float:
    """Mean of (N,) values, or share of true ones; NaN without any."""
    values = np.asarray(values)
    return float(values.mean()) if len(values) else float("nan")
