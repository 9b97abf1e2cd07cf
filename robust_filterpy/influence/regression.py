"""A linear regression by Huber's weights, and a scale that outliers do not move: what a search begins with."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.linalg import solve

from robust_filterpy._checks import Array
from robust_filterpy.influence.functions import Huber

# Of a normal distribution the median absolute deviation is its standard deviation over this.
_MAD_TO_SCALE: Final = 1.482602218505602


def mad_scale(residual: Array) -> float:
    """Return the standard deviation of normal noise with this median absolute deviation from 0."""
    return _MAD_TO_SCALE * float(np.median(np.abs(residual)))


def robust_regression(X: Array, y: Array, steps: int = 10) -> Array:
    """Return the coefficients of a linear regression by Huber's weights, good enough to begin with.

    Parameters
    ----------
    X : ndarray, shape (N, n)
        Regressors.
    y : ndarray, shape (N,)
        What they explain, outliers among it.
    steps : int, default 10
        Weighted least-squares problems to solve at most.

    Returns
    -------
    ndarray, shape (n,)
    """
    weights, theta = np.ones(y.size), np.zeros(X.shape[1])
    # A single gross outlier would spoil the residuals of the first fit, and with them its weight.
    centre = np.median(y)
    spread = 5.0 * mad_scale(y - centre)
    target = np.clip(y, centre - spread, centre + spread) if spread > 0.0 else y
    for _ in range(steps):
        gram = X.T @ (X * weights[:, None])
        ridge = 1e-9 * gram.diagonal() + 1e-12 * np.trace(gram) / len(gram) + np.finfo(float).tiny
        new = solve(gram + np.diag(ridge), X.T @ (weights * target), assume_a="pos")
        done = np.linalg.norm(X @ (new - theta)) <= 1e-3 * np.linalg.norm(y - X @ new)
        theta, target = new, y
        residual = y - X @ theta
        scale = mad_scale(residual)
        if done or scale == 0.0:
            break
        weights = Huber().weights(residual / scale)
    return theta
