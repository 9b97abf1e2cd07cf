"""The gate that most programs have, and the gate that begins anew once it has refused too many in a row."""

from __future__ import annotations

from functools import lru_cache, partial
from typing import Any

import numpy as np
from peers.recursion import Correction, kalman, length
from scipy.stats import chi2


def gate(level: float = 0.9973, patience: float = np.inf) -> Correction:
    """Return the correction that leaves out a measurement whose length is beyond the quantile of its chi-square.

    After as many refusals in a row as patience says it begins anew: P is that of the start, as much wider as makes the
    measurement an ordinary one.
    """
    return partial(_correct, level, patience)


def _correct(
    level: float, patience: float, x: np.ndarray, P: np.ndarray, z: np.ndarray, case: Any, memory: dict
) -> Any:
    y, H, R = z - case.H @ x, case.H, case.R
    refused = memory["refused"] = memory.get("refused", 0) + 1
    if length(y, H @ P @ H.T + R) ** 2 <= _quantile(level, len(z)):
        memory["refused"] = 0
    elif refused > patience:
        memory["refused"] = 0
        P = case.P0 * max(1.0, length(y, H @ case.P0 @ H.T + R) ** 2 / len(z))
    else:
        return x, P
    return kalman(x, P, y, H, R)


@lru_cache
def _quantile(level: float, dim: int) -> float:
    return float(chi2.ppf(level, dim))
