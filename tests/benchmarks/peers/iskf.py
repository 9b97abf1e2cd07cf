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


def one_step(of_z: Any) -> Correction:
    """Return the correction after one step, in which only the innovation saturates."""
    return partial(_correct, 1, np.inf, of_z)


def two_steps(of_x: Any, of_z: Any) -> Correction:
    """Return the correction after two steps; in the second the move of the state saturates too.

    P does not depend on the thresholds: for columns of them the states are rows.
    """
    return partial(_correct, 2, of_x, of_z)


def _correct(
    steps: int, of_x: Any, of_z: Any, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict
) -> Any:
    H, C, R_inverse = case.H, P @ case.H.T, np.linalg.inv(case.R)
    K = np.linalg.solve(H @ C + case.R, C.T).T
    at = x
    for step in range(steps):
        move, y, from_x = at - x, z - at @ H.T, 0.0
        # The first step begins where nothing has moved.
        if step:
            from_x = move * np.minimum(1.0, of_x / _length(move, np.linalg.pinv(P, hermitian=True)))
        from_z = y * np.minimum(1.0, of_z / _length(y, R_inverse))
        at = at + from_z @ K.T - (from_x - from_x @ (K @ H).T if step else 0.0)
    return at, P - K @ C.T


def _length(v: np.ndarray, inverse: np.ndarray) -> np.ndarray:
    """Return the length of vectors, at least a number that may divide."""
    return np.sqrt(np.maximum(((v @ inverse) * v).sum(axis=-1, keepdims=True), 1e-300))
