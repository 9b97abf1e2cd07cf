"""Two Student t filters.

M. Roth, E. Ozkan, F. Gustafsson, A Student's t filter for heavy tailed process and measurement noise, ICASSP 2013:
state and noises jointly t with the same degrees of freedom nu, to which the posterior's nu + m are matched back.

J. N. M. Neuhoefer's (repository continental/outlier-robust-student-t-filter): t noise of nu degrees of freedom, a state
of nu + m, a process noise of nu + m + n, which fit together if the scale of each is multiplied by how far the others
are off. These two numbers are not known; their means given the measurement are iterated.
"""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import numpy as np
from peers.recursion import Correction, kalman, length
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.stats import chi2

#: Degrees of freedom that a recording is tried with; the authors take 3, and tune: 3.26 with their covariances.
GRID = [{"nu": float(nu)} for nu in (2.5, 3.0, 4.0, 6.0, 10.0, 30.0)]
GRID_FITTED = [{"nu": float(nu)} for nu in (1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 7.5)]


def student_t(nu: float) -> Correction:
    """Return the correction of Roth's; P, Q and R are scale matrices."""
    return partial(_correct, nu)


def _correct(nu: float, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict) -> Any:
    y, m = z - case.H @ x, len(z)
    squared = length(y, case.H @ P @ case.H.T + case.R) ** 2
    x, P = kalman(x, P, y, case.H, case.R)
    wider = (nu + squared) / (nu + m)
    # The same covariance with nu instead of nu + m degrees of freedom.
    return x, P * wider * (nu + m) / (nu + m - 2.0) * (nu - 2.0) / nu


def fitted(nu: float) -> Correction:
    """Return the correction of Neuhoefer's; P, Q and R are the normal covariances closest to the scale matrices."""
    return partial(_correct_fitted, nu)


def _correct_fitted(nu: float, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict) -> Any:
    n, m, y, H = len(x), len(z), z - case.H @ x, case.H
    state = closest_scale(n, nu + m)
    moved, Q, R = state * (P - case.Q), closest_scale(n, nu + m + n) * case.Q, closest_scale(m, nu) * case.R
    a = (nu + m) / (nu + y @ np.linalg.solve(R, y))
    b = (nu + m + n) / (nu + m + max(n - 2, 0) * (nu + m) / (nu + m + 2.0))
    for _ in range(100):
        predicted = a * (moved + b * Q)
        inverse = np.linalg.inv(H @ predicted @ H.T + R)
        score, seen = inverse @ y, a * H @ moved @ H.T
        size = (nu + y @ score) / (nu + m - 2.0) if nu + m > 2.0 else 1.0
        left = size * (m - np.sum(R * inverse)) / 2.0 + score @ R @ score
        step = size * a * (n - np.sum(seen * inverse)) / 2.0 + a * score @ seen @ score
        a_new, b_new = (nu + m) / (nu + left), (nu + m + n) / (nu + m + step)
        if abs(a_new - a) / (a_new + a) + abs(b_new - b) / (b_new + b) < 2e-2:
            break
        a, b = a_new, b_new
    C = predicted @ H.T
    return x + C @ score, (nu + y @ score) / (nu + m) / state * (predicted - C @ inverse @ C.T)


@lru_cache
def closest_scale(dim: int, nu: float) -> float:
    """Return the factor of a normal covariance with which Student's t as a scale matrix is closest to that density."""

    def apart(log_a: float) -> float:
        integrand = lambda s: chi2.pdf(s, dim) * np.log1p(s * np.exp(-log_a) / nu)  # noqa: E731
        return 0.5 * dim * log_a + 0.5 * (nu + dim) * quad(integrand, 0.0, np.inf)[0]

    return float(np.exp(minimize_scalar(apart, bounds=(-5.0, 2.0), method="bounded").x))
