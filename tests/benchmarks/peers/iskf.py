"""The iteratively saturated Kalman filter.

A. Yang, S. Boyd, Iteratively saturated Kalman filtering, 2025: scaled gradient steps on the sum of two Huber functions,
of the length of P^(-1/2)(x - prediction) and of R^(-1/2)(z - H x). P is the Kalman filter's, as in their steady form.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from peers.recursion import Correction

#: The authors search both thresholds on a grid, by the error on a recording whose truth is known.
GRID_ONE = [{"of_z": float(b)} for b in np.geomspace(0.3, 10.0, 12)]
GRID_TWO = [
    {"of_x": float(a), "of_z": float(b)} for a in np.geomspace(0.1, 10.0, 8) for b in np.geomspace(0.3, 10.0, 8)
]


def one_step(of_z: float) -> Correction:
    """Return the correction after one step, in which only the innovation saturates."""
    return partial(_correct, 1, np.inf, of_z)


def two_steps(of_x: float, of_z: float) -> Correction:
    """Return the correction after two steps; in the second the move of the state saturates too."""
    return partial(_correct, 2, of_x, of_z)


def _correct(
    steps: int, of_x: float, of_z: float, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict
) -> Any:
    C, R_inverse = P @ case.H.T, np.linalg.inv(case.R)
    K = np.linalg.solve(case.H @ C + case.R, C.T).T
    at = x
    for step in range(steps):
        move, y = at - x, z - case.H @ at
        # The first step begins where nothing has moved.
        size = np.sqrt(max(move @ np.linalg.pinv(P, hermitian=True) @ move, 0.0)) if step and of_x < np.inf else 0.0
        from_x = move * min(1.0, of_x / max(size, 1e-300))
        from_z = y * min(1.0, of_z / max(np.sqrt(y @ R_inverse @ y), 1e-300))
        at = at + K @ from_z - (from_x - K @ (case.H @ from_x))
    return at, P - K @ C.T
