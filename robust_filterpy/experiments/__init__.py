"""Monte-Carlo studies of estimators.

* `monte_carlo`: repeat a trial with other random numbers, on many processes.
* `metrics`: what the runs show: errors, ratios, fits, intervals.

Imports from below: `identification`, for `fit_percent`.
"""

from __future__ import annotations

from robust_filterpy.experiments.monte_carlo import (
    Failure,
    Interval,
    MonteCarloResult,
    bootstrap_interval,
    fit_percent,
    log_squared_error,
    mean_square_error,
    monte_carlo,
    ratio_to,
    rerun,
)

__all__ = [
    "Failure",
    "Interval",
    "MonteCarloResult",
    "bootstrap_interval",
    "fit_percent",
    "log_squared_error",
    "mean_square_error",
    "monte_carlo",
    "ratio_to",
    "rerun",
]
