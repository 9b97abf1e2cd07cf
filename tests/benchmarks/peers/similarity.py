"""The filter of a statistical similarity measure, with the logarithmic one (SSMKF).

Y. Huang, Y. Zhang, Y. Zhao, P. Shi, J. Chambers, A novel outlier-robust Kalman filtering framework based on statistical
similarity measure, IEEE Transactions on Automatic Control 66 (2021): R/lambda and P/xi, each iterated for itself.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from peers.recursion import Correction, kalman

#: Degrees of freedom that a recording is tried with; 2.6 was found best for manoeuvres in a plane.
GRID = [{"nu": float(nu)} for nu in (1.0, 1.7, 2.6, 4.0, 6.0)]


def similarity(nu: float) -> Correction:
    """Return the correction."""
    return partial(_correct, nu)


def _correct(nu: float, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict) -> Any:
    y, H, R = z - case.H @ x, case.H, case.R
    of_R, of_P, trusted, kept = np.linalg.inv(R), np.linalg.inv(P), 1.0, 1.0
    for _ in range(30):
        moved, left = kalman(np.zeros(len(x)), P, y, H, R / trusted)
        before, rest = trusted, y - H @ moved
        trusted = (nu + len(y)) / (nu + np.sum((np.outer(rest, rest) + H @ left @ H.T) * of_R))
        if abs(trusted - before) < 1e-6 * before:
            break
    for _ in range(30):
        moved, left = kalman(np.zeros(len(x)), P / kept, y, H, R / trusted)
        before, kept = kept, (nu + len(x)) / (nu + np.sum((np.outer(moved, moved) + left) * of_P))
        if abs(kept - before) < 1e-6 * before:
            break
    return kalman(x, P / kept, y, H, R / trusted)
