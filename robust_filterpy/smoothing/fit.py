"""Whether Q and R fit a recording: what a smoother leaves, in units of what they say should be left.

Each measurement is compared with what all the others say of it (auxiliary residuals; A. C. Harvey and S. J. Koopman,
Journal of Business & Economic Statistics 10, 1992)::

    e = z - H x_s,   V = H P_s H',   e_others = (e + V o)/(1 - d V),   variance 1 + V/(1 - d V)   in units of R,
    w = G's,   variance G'L G                                                                    in units of Q,

the process noise by its mean square, the measurements by the median of those that are believed. A mean square of what
is a projection of independent noise has a standard deviation of at most sqrt(2/d), d the sum of its variances; its cube
root is nearly normal (E. B. Wilson and M. M. Hilferty, PNAS 17, 1931).

An R that is far too small hides from that median: learnt noise takes the larger half of ordinary noise for outliers.
But then there are many of them, and so many are said.
"""

from __future__ import annotations

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.smoothing.linear_pass import Model, Smooth, Weighting
from robust_filterpy.smoothing.sweeps import Fit

# What is said: variances wrong by more than this, and by so many standard deviations.
_WRONG, _SURE = 2.5, 4.0
_MEDIAN_SQUARE = 0.4549364
# By how much a median of squares varies more than their mean.
_OF_MEDIAN = 1.65
_BELIEVED = 0.5
# More outliers than this, by so many standard deviations of their number, are ordinary noise that R does not know.
_MANY, _MORE = 1.0 / 3.0, 2.0
_ROUNDING, _TINY = 1e-6, 1e-30


def misfits(model: Model, fit: Fit, weights: Array) -> list[str]:
    """Return what is said of Q and R for each series, nothing where they fit."""
    # weights (series, steps, m): how much each measurement was believed, NaN where it is missing.
    smooth = fit.smooth
    believed, measured = np.asarray(weights > _BELIEVED), ~np.isnan(weights)
    count = np.maximum(measured.sum(axis=1), 1)
    share = 1.0 - believed.sum(axis=1) / count
    many = share > _MANY + _MORE * np.sqrt(_MANY * (1.0 - _MANY) / count)
    left, of_left = _left(model.z, smooth, fit.weighting, believed)
    degrees = np.einsum("snii->s", smooth.information)
    driven = np.einsum("snr,snr->s", smooth.score, smooth.score) / np.maximum(degrees, _TINY)
    odd = []
    for s in range(len(weights)):
        parts = []
        for j in np.flatnonzero(measured[s].any(axis=0)):
            if many[s, j]:
                parts.append(f"{share[s, j]:.0%} of the measurements of sensor {j} look like outliers to R")
            elif _differs(left[s, j], of_left[s, j]):
                parts.append(f"what is left of sensor {j} is {left[s, j]:.2g} times as large (in variance) as R says")
        if _differs(driven[s], degrees[s]):
            parts.append(f"the process noise is {driven[s]:.2g} times as large (in variance) as Q says")
        odd.append(", ".join(parts))
    return odd


def _left(z: Array, smooth: Smooth, weighting: Weighting, believed: np.ndarray) -> tuple[Array, Array]:
    """Return how large what is left of each sensor is, and of how many degrees of freedom, both (series, m)."""
    V = np.einsum("...ii->...i", smooth.spread)
    rest = 1.0 - weighting.precision * V
    told = believed & (rest > _ROUNDING)
    rest = np.where(told, rest, 1.0)
    variance = 1.0 / (1.0 + V / rest)
    squares = ((z - smooth.fitted + V * weighting.offset) / rest) ** 2 * variance
    ordered = np.sort(np.where(told, squares, np.inf), axis=1)
    middle = np.maximum(told.sum(axis=1) - 1, 0)[:, None] // 2
    median = np.take_along_axis(ordered, middle, axis=1)[:, 0]
    return median / _MEDIAN_SQUARE, np.where(told, variance, 0.0).sum(axis=1) / _OF_MEDIAN**2


def _differs(size: float, degrees: float) -> bool:
    """Return whether a mean square is neither 1 nor nearly 1, for sure."""
    if degrees <= _TINY:
        return False
    apart = 2.0 / (9.0 * degrees)
    low, high = ((1.0 - apart + side * _SURE * np.sqrt(apart)) for side in (-1.0, 1.0))
    return bool(size > max(_WRONG, high**3) or size < min(1.0 / _WRONG, max(low, 0.0) ** 3))
