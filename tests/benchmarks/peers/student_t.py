"""The Student t filter.

M. Roth, E. Ozkan, F. Gustafsson, A Student's t filter for heavy tailed process and measurement noise, ICASSP 2013:
state and noises jointly t with the same degrees of freedom nu, to which the posterior's nu + m are matched back.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from peers.recursion import Correction, kalman, length

#: Degrees of freedom that a recording is tried with; the authors take 3.
GRID = [{"nu": float(nu)} for nu in (2.5, 3.0, 4.0, 6.0, 10.0, 30.0)]


def student_t(nu: float) -> Correction:
    """Return the correction; P, Q and R are scale matrices."""
    return partial(_correct, nu)


def _correct(nu: float, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict) -> Any:
    y, m = z - case.H @ x, len(z)
    squared = length(y, case.H @ P @ case.H.T + case.R) ** 2
    x, P = kalman(x, P, y, case.H, case.R)
    wider = (nu + squared) / (nu + m)
    # The same covariance with nu instead of nu + m degrees of freedom.
    return x, P * wider * (nu + m) / (nu + m - 2.0) * (nu - 2.0) / nu
