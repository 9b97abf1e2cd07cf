"""A linear regression by Huber's weights, and a scale that outliers do not move: what a search begins with."""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import median_filter

from robust_filterpy._checks import Array
from robust_filterpy.influence.functions import Huber

# Of a normal distribution the median absolute deviation is its standard deviation over this.
_MAD_TO_SCALE: Final = 1.482602218505602
# The median of a signal that mostly rests is rounding if it is within so many steps of it, or such a part of what
# moves: it is then taken for as large as this share of where it stays for so many samples in a row.
_STEPS, _NOTHING, _AT_REST, _IN_A_ROW = 10.0, 1e-7, 0.01, 9
# Share of the range of a signal within which two values are the same.
_EQUAL: Final = 1e-9
# Share of the clipping level of the output below which no residual is weighed down.
_LEAST: Final = 0.002


def mad_scale(residual: Array) -> float:
    """Return the standard deviation of normal noise with this median absolute deviation from 0."""
    return _MAD_TO_SCALE * float(np.median(np.abs(residual)))


def size_of(signal: Array) -> float:
    """Return how large a signal is about 0: by its median, unless that is rounding since it mostly rests."""
    usual, moving = mad_scale(signal), moving_size(signal)
    if usual > _STEPS * resolution(signal) and usual > _NOTHING * moving:
        return usual
    return max(usual, _AT_REST * moving) or float(np.abs(signal).mean())


def moving_size(signal: Array) -> float:
    """Return how large a signal becomes about 0 where it moves; wild values that come one by one do not count."""
    return float(np.quantile(np.abs(median_filter(signal, _IN_A_ROW, mode="nearest")), 0.99))


def resolution(signal: Array) -> float:
    """Return the least step between the values of a signal that is rounded, 0 if it does not repeat its values."""
    values, counts = np.unique(signal, return_counts=True)
    if 2 * values.size > counts.sum() or values.size < 2:
        return 0.0
    gaps, repeated = np.diff(values), counts > 1
    # Numbers that are equal but for rounding, as 0.1 + 0.2 and 0.3, are one value.
    apart = gaps > _EQUAL * (values[-1] - values[0])
    # Single values between may be of another kind, but where no two neighbors repeat they are all there is.
    both, either = repeated[1:] & repeated[:-1], repeated[1:] | repeated[:-1]
    steps = gaps[apart & (both if (both & apart).any() else either)]
    return float(steps.min()) if steps.size else 0.0


def in_directions(X: Array) -> tuple[Array, Array, Array, Array]:
    """Return the singular value decomposition of columns, each taken of unit size, and these sizes; 1 for 0."""
    size = np.linalg.norm(X, axis=0)
    size[size == 0.0] = 1.0
    return *np.linalg.svd(X / size, full_matrices=False), size


def robust_regression(X: Array, y: Array, steps: int = 10) -> Array:
    """Return the coefficients of a linear regression by Huber's weights, good enough to begin with."""
    weights, theta = np.ones(y.size), np.zeros(X.shape[1])
    # A single gross outlier would spoil the residuals of the first fit, and with them its weight.
    centre = np.median(y)
    spread = 5.0 * size_of(y - centre)
    target = np.clip(y, centre - spread, centre + spread) if spread > 0.0 else y
    for _ in range(steps):
        gram = X.T @ (X * weights[:, None])
        ridge = 1e-9 * gram.diagonal() + 1e-12 * np.trace(gram) / len(gram) + np.finfo(float).tiny
        # A column of zeros, or one twice, is for the ridge and no reason to warn.
        new = cho_solve(cho_factor(gram + np.diag(ridge)), X.T @ (weights * target))
        moved, theta, target = X @ (new - theta), new, y
        residual = y - X @ theta
        # Where most samples are at rest and rounded, what moves is no outlier.
        scale = max(mad_scale(residual), _LEAST * spread)
        # Held against ordinary samples: next to gross errors every step is a small one.
        if scale == 0.0 or np.linalg.norm(moved) <= 1e-3 * scale * np.sqrt(y.size):
            break
        weights = Huber().weights(residual / scale)
    return theta
