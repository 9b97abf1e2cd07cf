"""A linear regression by Huber's weights, and a scale that outliers do not move: what a search begins with."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.linalg import solve
from scipy.ndimage import median_filter

from robust_filterpy._checks import Array
from robust_filterpy.influence.functions import Huber

# Of a normal distribution the median absolute deviation is its standard deviation over this.
_MAD_TO_SCALE: Final = 1.482602218505602
# A signal that is mostly at rest is as large as this share of where it stays for so many samples in a row.
_AT_REST, _IN_A_ROW = 0.01, 9
# Share of the clipping level of the output below which no residual is weighed down.
_LEAST: Final = 0.002


def mad_scale(residual: Array) -> float:
    """Return the standard deviation of normal noise with this median absolute deviation from 0."""
    return _MAD_TO_SCALE * float(np.median(np.abs(residual)))


def size_of(signal: Array) -> float:
    """Return how large a signal is about 0: by its median, but not next to nothing if it only rests for most of the time.

    Parameters
    ----------
    signal : ndarray, shape (N,)
        In the order of time, outliers among it; N >= 1.

    Returns
    -------
    float
    """
    # Wild values that come one by one do not pass the filter.
    moving = np.quantile(np.abs(median_filter(signal, _IN_A_ROW, mode="nearest")), 0.99)
    return max(mad_scale(signal), _AT_REST * float(moving)) or float(np.abs(signal).mean())


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
    spread = 5.0 * size_of(y - centre)
    target = np.clip(y, centre - spread, centre + spread) if spread > 0.0 else y
    for _ in range(steps):
        gram = X.T @ (X * weights[:, None])
        ridge = 1e-9 * gram.diagonal() + 1e-12 * np.trace(gram) / len(gram) + np.finfo(float).tiny
        new = solve(gram + np.diag(ridge), X.T @ (weights * target), assume_a="pos")
        done = np.linalg.norm(X @ (new - theta)) <= 1e-3 * np.linalg.norm(y - X @ new)
        theta, target = new, y
        residual = y - X @ theta
        # Where most samples are at rest and rounded, what moves is no outlier.
        scale = max(mad_scale(residual), _LEAST * spread)
        if done or scale == 0.0:
            break
        weights = Huber().weights(residual / scale)
    return theta
