"""Models of the state and of some constants side by side: moved, and corrected under noise that is a mixture.

`fusion._faults` has one for each fault from each onset, `fusion.reacquisition` one for each way in which readings and
state can have come apart, `diagnostics` one for each repair of a model. All are advanced together, in place;
the first of these in C, too (``kernel/hypotheses.c``).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from robust_filterpy._checks import Array

__all__ = ["corrected", "moved"]


def moved(x: Array, P: Array, F: Array, Q: Array, drift: Array) -> None:
    """Move N models of D numbers, the first n of them the state, in place; F of one shape for all, or one for each."""
    n, D = F.shape[-1], x.shape[1]
    x[:, :n] = (F @ x[:, :n, None])[:, :, 0] + drift if F.ndim > 2 else x[:, :n] @ F.T + drift
    ahead = np.zeros((*F.shape[:-2], D, D))
    ahead[..., :, :] = np.eye(D)
    ahead[..., :n, :n] = F
    for _ in range(2):
        turned = P @ np.swapaxes(ahead, 1, 2) if F.ndim > 2 else (P.reshape(-1, D) @ ahead.T).reshape(P.shape)
        P[:] = np.swapaxes(turned, 1, 2)
    P[:, :n, :n] += Q


def corrected(x: Array, P: Array, z: Any, h: Array, variances: Array, logs: Array, reach: float = math.inf) -> Array:
    """Correct N models by one number each, in place; return its log-density (`correction.learnt`'s step).

    variances, logs: of the classes of noise, and logarithms of their shares, (C, N) or (C, 1). reach: deviations of the
    widest class from which on a number is no farther.
    """
    y = z - np.einsum("ni,ni->n", h, x)
    C = np.einsum("nij,nj->ni", P, h)
    S = np.einsum("ni,ni->n", h, C) + variances
    far = reach * np.sqrt(np.where(logs > -math.inf, S, 0.0).max(axis=0))
    y = np.clip(y, -far, far)
    pulls = y / S
    logs = logs - 0.5 * (pulls * y + np.log(2.0 * math.pi * S))
    peak = logs.max(axis=0)
    given = np.exp(logs - peak)
    total = given.sum(axis=0)
    a = (given * pulls).sum(axis=0) / total
    b = (given * (1.0 / S - pulls**2)).sum(axis=0) / total + a * a
    x += a[:, None] * C
    P -= (b[:, None] * C)[:, :, None] * C[:, None, :]
    return np.asarray(peak + np.log(total))
