"""Error statistics: MAE, RMSE, sigma and quantiles, defined once for all tables."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, kw_only=True)
class ErrorStatistics:
    """Statistics of signed errors e, in the unit of e.

    Attributes:
        count: Number of errors.
        mae: Mean of |e|.
        rmse: Root of the mean of e squared.
        sigma: Standard deviation of |e| about `mae`, so rmse^2 = mae^2 + sigma^2 (the relation
            that the figures of the paper's tables satisfy).
        bias: Mean of e.
        median: Median of |e|.
        p90: 90th percentile of |e|.
        p95: 95th percentile of |e|.
    """

    count: int
    mae: float
    rmse: float
    sigma: float
    bias: float
    median: float
    p90: float
    p95: float


def summarize(errors: NDArray[np.floating]) -> ErrorStatistics:
    """Statistics of signed `errors` (any shape); all NaN without errors."""
    signed = np.asarray(errors, dtype=np.float64).ravel()
    if not signed.size:
        nan = float("nan")
        return ErrorStatistics(
            count=0, mae=nan, rmse=nan, sigma=nan, bias=nan, median=nan, p90=nan, p95=nan
        )
    size = np.abs(signed)
    median, p90, p95 = (float(q) for q in np.percentile(size, (50, 90, 95)))
    return ErrorStatistics(
        count=signed.size,
        mae=float(size.mean()),
        rmse=float(np.sqrt(np.mean(signed**2))),
        sigma=float(size.std()),
        bias=float(signed.mean()),
        median=median,
        p90=p90,
        p95=p95,
    )
