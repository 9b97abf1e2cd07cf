"""Outliers that a model's own regressor holds: found, and replaced by what the samples around them say.

In A(q) y = B(q) u + C(q) v a wild y(k) is in na + 1 rows of the regression, and no weight for one row mends that. An
outlier in the measurement of y(k) leaves the pattern of h = A/C in the residuals, an outlier of v one large residual:
of all samples and both kinds the largest likelihood ratio is taken first, then what is left is looked at again (Chen
and Liu, Journal of the American Statistical Association 88, 1993). A wrong sample is as good as a missing one: both
are interpolated by the model.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import lfilter
from scipy.sparse import csc_array
from scipy.sparse.linalg import spsolve

from robust_filterpy._checks import Array
from robust_filterpy.identification.learnt_noise import mad_scale
from robust_filterpy.identification.polynomial_model import PolynomialModel

__all__ = ["THRESHOLD", "Cleaned", "cleaned"]

#: How far a sample may be from what the others say, in standard deviations, and still count as ordinary.
THRESHOLD: Final = 3.0
_MOST_ROUNDS: Final = 30
# What an unknown sample may add to a residual that counts, as a share of the ordinary noise.
_LEAST_TOUCH: Final = 0.1
_LONGEST: Final = 200
# Residuals of this size, of an output of unit size, are no noise.
_ROUNDING: Final = 1e-12


class Cleaned(NamedTuple):
    """An output through which a model's regressor holds no outlier.

    Attributes
    ----------
    y : ndarray, shape (N,)
        Output with wrong and missing samples interpolated.
    wrong : ndarray of bool, shape (N,)
        Which samples these are.
    rows : ndarray of bool, shape (N - first,)
        Which residuals are free of them.
    """

    y: Array
    wrong: Any
    rows: Any


def cleaned(model: PolynomialModel, p: Array, missing: Any, R: float | None = None) -> Cleaned:
    """Find the wrong samples of an output, and interpolate them and the missing ones.

    Parameters
    ----------
    model : PolynomialModel
        With the output as measured.
    p : ndarray, shape (n,)
        Its free parameters.
    missing : ndarray of bool, shape (N,)
        Which samples are known to be wrong.
    R : float, optional
        Variance of the ordinary noise. Default: from the median of the residuals.

    Returns
    -------
    Cleaned
    """
    parts = model.parts(p)
    impulse = np.zeros(min(_LONGEST, model.y.size))
    impulse[0] = 1.0
    h = lfilter(np.convolve(parts.a, parts.d), parts.c, impulse)
    h = h[: np.flatnonzero(np.abs(h) > 1e-3)[-1] + 1]
    first, wrong = model.first, missing.copy()
    if h.size == 1:
        return Cleaned(model.y, wrong, ~wrong[first:])
    base = model.residuals(p)
    counts = np.ones(base.size, dtype=bool)
    for _ in range(_MOST_ROUNDS):
        residual, correction = _interpolated(base, h, np.flatnonzero(wrong), counts, first)
        untouched = counts & ~_touched(wrong, h, first)
        scale = mad_scale(residual[untouched if untouched.sum() > 0.2 * base.size else counts]) if R is None else R**0.5
        if scale < _ROUNDING:
            break
        # Both statistics are standard normal for an ordinary sample.
        innovation = np.abs(np.where(counts, residual, 0.0)) / scale
        padded = np.concatenate((np.zeros(first), np.where(counts, residual, 0.0), np.zeros(h.size)))
        power = np.convolve(np.concatenate((np.zeros(first), counts, np.zeros(h.size))), (h * h)[::-1], "full")
        match = np.convolve(padded, h[::-1], "full")
        span = slice(h.size - 1, h.size - 1 + model.y.size)
        with np.errstate(invalid="ignore", divide="ignore"):
            additive = np.abs(match[span]) / np.sqrt(power[span]) / scale
        additive[wrong | ~(power[span] > 0.1)] = 0.0
        additive[:first] = 0.0
        whole = np.concatenate((np.zeros(first), innovation))
        either = np.maximum(additive, whole)
        peak = (either >= maximum_filter1d(either, 2 * h.size + 1)) & (either > THRESHOLD)
        if not peak.any():
            break
        wrong |= peak & (additive >= whole)
        counts &= ~(peak & (whole > additive))[first:]
    residual, correction = _interpolated(base, h, np.flatnonzero(wrong), counts, first)
    y = model.y.copy()
    y[wrong] += correction
    return Cleaned(y, wrong, ~_touched(wrong, h, first))


def _interpolated(base: Array, h: Array, wrong: Any, counts: Any, first: int) -> tuple[Array, Array]:
    """Return the residuals with the samples at ``wrong`` chosen for the least sum of squares, and their corrections."""
    if wrong.size == 0:
        return base, np.zeros(0)
    rows = (wrong[:, None] - first + np.arange(h.size)).ravel()
    columns = np.repeat(np.arange(wrong.size), h.size)
    values = np.tile(h, wrong.size)
    inside = (rows >= 0) & (rows < base.size)
    H = csc_array((values[inside], (rows[inside], columns[inside])), shape=(base.size, wrong.size))
    weighted = H.multiply(counts[:, None]).tocsc()
    gram = (H.T @ weighted).tocsc()
    gram.setdiag(gram.diagonal() + 1e-9)
    correction = np.atleast_1d(spsolve(gram, -(weighted.T @ base)))
    return base + H @ correction, correction


def _touched(wrong: Any, h: Array, first: int) -> Any:
    """Return which residuals an interpolated sample could change by more than a little."""
    reach = np.flatnonzero(np.abs(h) > _LEAST_TOUCH)[-1] + 1
    return np.convolve(wrong, np.ones(reach), "full")[first : wrong.size] > 0.5
