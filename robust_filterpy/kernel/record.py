"""What a correction by the kernel left, as `robust_filterpy.correction.Correction`."""

from __future__ import annotations

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.standardization import group_scaling
from robust_filterpy.kernel.series import SCALINGS

__all__ = ["correction_of"]


def correction_of(values: Array, x: Array, P: Array) -> Correction:
    """Return what a record of numbers says.

    Parameters
    ----------
    values : ndarray, shape (4 + 7 m + m^2 + m n,)
        n, m, scaling, log-likelihood; y, e, weights, psi', d, v and the order, of m numbers each; S and C'.
    x : ndarray, shape (n,) or (n, 1)
        Posterior mean.
    P : ndarray, shape (n, n)
        Posterior covariance.

    Returns
    -------
    Correction
    """
    n, m = int(values[0]), int(values[1])
    scaling, rest = SCALINGS[int(values[2])], values[4:]
    y, e, weights, psi_deriv, d, score, order = rest[: 7 * m].reshape(7, m)
    S, C = rest[7 * m : (7 + m) * m].reshape(m, m), rest[(7 + m) * m :].reshape(m, n).T
    taken = [int(i) for i in order[: np.count_nonzero(weights == weights)]]
    return Correction(
        np.ravel(x), P, C, y, S, score, _information(S, d, taken, scaling), e, weights, psi_deriv,
        tuple((i,) for i in taken), scaling, float(values[3]),
    )  # fmt: skip


def _information(S: Array, d: Array, order: list[int], scaling: str) -> Array:
    """Return B in P+ = P - C B C', which few look at."""
    S, W, B = S.copy(), np.eye(len(S)), np.zeros_like(S)
    for i in order:
        t = group_scaling(S[i : i + 1, i : i + 1], scaling)[0, 0]
        q, w = t * S[:, i], t * W[:, i]
        B += d[i] * np.outer(w, w)
        W -= d[i] * np.outer(w, q)
        S -= d[i] * np.outer(q, q)
    return B
