"""The loop of predictions around the peers' corrections, each written from its paper in a few lines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

#: (x, P, z, case, memory) -> (x, P): one correction; what it remembers between samples is in memory.
Correction = Callable[[np.ndarray, np.ndarray, np.ndarray, Any, dict], tuple[np.ndarray, np.ndarray]]


def filtered(case: Any, correct: Correction, q_scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Return the corrected states of a recording and their covariances, shapes (N, n) and (N, n, n).

    States are (N, G, n) where a correction has G choices of which P does not depend.
    """
    x, P, memory = case.x0, case.P0, {}
    path, covariances = [], []
    for z in case.zs:
        x, P = x @ case.F.T, case.F @ P @ case.F.T + q_scale * case.Q
        x, P = correct(x, P, z, case, memory)
        P = 0.5 * (P + P.T)
        path.append(x)
        covariances.append(P)
    return np.array(path), np.array(covariances)


def kalman(x: np.ndarray, P: np.ndarray, y: np.ndarray, H: np.ndarray, R: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the Kalman filter's corrected x and P for an innovation y."""
    C = P @ H.T
    K = np.linalg.solve(H @ C + R, C.T).T
    return x + K @ y, P - K @ C.T


def length(y: np.ndarray, S: np.ndarray) -> float:
    """Return the Mahalanobis length sqrt(y' S^-1 y)."""
    return float(np.sqrt(y @ np.linalg.solve(S, y)))
