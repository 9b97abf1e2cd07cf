"""WoLF: the weighted observation likelihood filter.

G. Duran-Martin, M. Altamirano, A. Shestopaloff, L. Sanchez-Betancourt, J. Knoblauch, M. Jones, F.-X. Briol, K. Murphy,
Outlier-robust Kalman filtering through generalised Bayes, ICML 2024: the likelihood to the power w^2, hence R/w^2.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from peers.recursion import Correction, kalman, length

#: Thresholds that a recording is tried with: the authors choose c by the error on a recording whose truth is known.
GRID = [{"c": float(c)} for c in np.geomspace(0.5, 20.0, 12)]


def imq(c: float) -> Correction:
    """Return the correction with the inverse multi-quadratic weight, w^2 = 1/(1 + |R^(-1/2) y|^2/c^2)."""
    return partial(_correct, lambda r: 1.0 / (1.0 + (r / c) ** 2))


def tmd(c: float) -> Correction:
    """Return the correction with the thresholded Mahalanobis distance, w = 1 up to c and 0 beyond."""
    return partial(_correct, lambda r: float(r <= c))


def _correct(weight: Any, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict) -> Any:
    y = z - case.H @ x
    w = weight(length(y, case.R))
    return (x, P) if w < 1e-12 else kalman(x, P, y, case.H, case.R / w)
