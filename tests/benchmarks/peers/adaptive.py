"""Filters that estimate R while they run, without a model of outliers."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from peers.recursion import Correction, kalman

#: Forgetting factors and windows that a recording is tried with.
GRID_VARIATIONAL = [{"rho": float(1.0 - gap)} for gap in np.geomspace(0.003, 0.3, 7)]
GRID_WINDOW = [{"window": int(n)} for n in (10, 20, 40, 80, 160)]


def variational(rho: float, sweeps: int = 3) -> Correction:
    """Return the variational adaptive correction: R diagonal, inverse gamma with forgetting factor rho.

    S. Sarkka, A. Nummenmaa, Recursive noise adaptive Kalman filtering by variational Bayesian approximations, IEEE
    Transactions on Automatic Control 54 (2009).
    """
    return partial(_variational, rho, sweeps)


def _variational(rho: float, sweeps: int, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict) -> Any:
    alpha = rho * memory.get("alpha", 5.0) + 0.5
    prior = rho * memory.get("beta", 5.0 * case.R.diagonal())
    beta = prior + 0.5 * memory.get("R", case.R.diagonal())
    for _ in range(sweeps):
        x_new, P_new = kalman(x, P, z - case.H @ x, case.H, np.diag(beta / alpha))
        beta = prior + 0.5 * (z - case.H @ x_new) ** 2 + 0.5 * ((case.H @ P_new) * case.H).sum(axis=1)
    memory.update(alpha=alpha, beta=beta, R=beta / alpha)
    return x_new, P_new


def innovation_based(window: int) -> Correction:
    """Return the correction with R = mean of y y' over a window - H P H'.

    A. Mohamed, K. Schwarz, Adaptive Kalman filtering for INS/GPS, Journal of Geodesy 73 (1999), after R. Mehra, On the
    identification of variances and adaptive Kalman filtering, IEEE Transactions on Automatic Control 15 (1970).
    """
    return partial(_innovation_based, window)


def _innovation_based(window: int, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict) -> Any:
    y = z - case.H @ x
    past = [*memory.get("y", []), y][-window:]
    memory["y"], R = past, case.R
    if len(past) == window:
        found = np.mean([np.outer(v, v) for v in past], axis=0) - case.H @ P @ case.H.T
        # What is no covariance is floored at a twentieth of the R that was given, in each direction.
        values, vectors = np.linalg.eigh(found)
        R = (vectors * np.maximum(values, 0.05 * np.linalg.eigvalsh(case.R)[0])) @ vectors.T
    return kalman(x, P, y, case.H, R)
