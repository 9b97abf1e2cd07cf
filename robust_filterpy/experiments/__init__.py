"""Monte-Carlo studies of estimators.

* `monte_carlo`: repeat a trial with other random numbers, on many processes.
* `metrics`: what the runs show: errors, fits, intervals.

Imports from below: `identification`, for `fit_percent`.
"""

from __future__ import annotations

from robust_filterpy._lazy import elsewhere
from robust_filterpy.experiments.metrics import bootstrap_interval
from robust_filterpy.experiments.monte_carlo import monte_carlo, rerun
from robust_filterpy.identification.models.noise import fit_percent

__all__ = ["bootstrap_interval", "fit_percent", "monte_carlo", "rerun"]

__getattr__ = elsewhere(__name__)
