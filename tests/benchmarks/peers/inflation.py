"""R times what brings the innovation's length back to a quantile.

G. Chang, Robust Kalman filtering based on Mahalanobis distance as outlier judging criterion, Journal of Geodesy 88
(2014): the factor of R by Newton's method, 1 where the length is below the quantile.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from peers.recursion import Correction, kalman
from scipy.stats import chi2

#: Chances of a length beyond the quantile that a recording is tried with.
GRID = [{"chance": chance} for chance in (0.01, 0.02, 0.05, 0.09, 0.15, 0.2)]


def inflated(chance: float) -> Correction:
    """Return the correction."""
    return partial(_correct, chance)


def _correct(chance: float, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict) -> Any:
    y, most, factor = z - case.H @ x, chi2.ppf(1.0 - chance, len(z)), 1.0
    for _ in range(50):
        score = np.linalg.solve(case.H @ P @ case.H.T + factor * case.R, y)
        beyond = y @ score - most
        if beyond <= 1e-6 * most:
            break
        factor += beyond / (score @ case.R @ score)
    return kalman(x, P, y, case.H, factor * case.R)
