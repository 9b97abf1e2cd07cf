"""Outliers that a model's own regressor holds: found, and then treated as missing.

In A(q) y = B(q) u + C(q) v a wild y(k) is in na + 1 rows of the regression, and no weight for one row mends that. An
outlier in the measurement of y(k) leaves the pattern of h = A/C in the residuals, an outlier of v one large residual:
of all samples and both kinds the largest likelihood ratio is taken first, then what is left is looked at again (Chen
and Liu, Journal of the American Statistical Association 88, 1993).
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.ndimage import maximum_filter1d

from robust_filterpy._checks import Array
from robust_filterpy.identification.learnt_noise import mad_scale
from robust_filterpy.identification.missing import interpolated, response, touched
from robust_filterpy.identification.polynomial_model import PolynomialModel

__all__ = ["Outliers", "found_outliers"]

# Where the share of outliers is not known yet: standard deviations that make one.
_FIRST_THRESHOLD: Final = 3.5
_THRESHOLDS: Final = (2.5, 5.0)
_MOST_ROUNDS: Final = 30
# Residuals of this size, of an output of unit size, are no noise.
_ROUNDING: Final = 1e-12


class Outliers(NamedTuple):
    """Where a recording has outliers.

    Attributes
    ----------
    wrong : ndarray of bool, shape (N,)
        Samples of y that are wrong or missing.
    counts : ndarray of bool, shape (N - first,)
        Residuals that are no outliers of v.
    threshold : float
        How far a wrong sample is from what the others say, in standard deviations, at which it is as likely an
        ordinary one, by the share and the size of those found.
    """

    wrong: Any
    counts: Any
    threshold: float


def found_outliers(
    model: PolynomialModel, p: Array, missing: Any, R: float | None = None, threshold: float = _FIRST_THRESHOLD
) -> Outliers:
    """Find the outliers in the output and in the noise of a model that has measured outputs in its regressor.

    Parameters
    ----------
    model : PolynomialModel
        With the output as measured, of about unit size.
    p : ndarray, shape (n,)
        Its free parameters.
    missing : ndarray of bool, shape (N,)
        Which samples are missing.
    R : float, optional
        Variance of the ordinary noise. Default: from the median of the residuals.
    threshold : float, default 3.5
        What makes an outlier, in standard deviations.

    Returns
    -------
    Outliers
    """
    h, first, wrong = response(model, p), model.first, missing.copy()
    base = model.residuals(p)
    counts = np.ones(base.size, dtype=bool)
    if h.size == 1:
        return Outliers(wrong, counts, threshold)
    sizes: list[float] = []
    for _ in range(_MOST_ROUNDS):
        residual = np.where(counts, interpolated(base, h, wrong, counts.astype(float), first).residual, 0.0)
        clear = counts & ~touched(wrong, h, first)
        scale = mad_scale(residual[clear if clear.sum() > 0.2 * base.size else counts]) if R is None else math.sqrt(R)
        if scale < _ROUNDING:
            break
        # Both statistics are standard normal for an ordinary sample.
        noise = np.concatenate((np.zeros(first), np.abs(residual) / scale))
        output = np.abs(_matched(residual, h, first)) / scale
        power = _matched(counts, h * h, first)
        output = np.where(wrong | (power < 0.1), 0.0, output / np.sqrt(np.maximum(power, 0.1)))
        output[:first] = 0.0
        either = np.maximum(output, noise)
        peak = (either > threshold) & (either >= maximum_filter1d(either, 2 * h.size + 1))
        if not peak.any():
            break
        new = peak & (output >= noise)
        wrong |= new
        sizes.extend(output[new])
        counts &= ~(peak & ~new)[first:]
    share = (len(sizes) + 0.5) / (model.y.size + 10.0)
    ratio = math.sqrt((np.square(sizes).sum() + 64.0) / (len(sizes) + 1.0))
    even = math.sqrt(2.0 * math.log(max(ratio * (1.0 - share) / share, 1.0)))
    return Outliers(wrong, counts, float(np.clip(even, *_THRESHOLDS)))


def _matched(signal: Any, pattern: Array, first: int) -> Array:
    """Return the correlation of residuals with a pattern that begins at each sample, before ``first`` too."""
    padded = np.concatenate((np.zeros(first), signal, np.zeros(pattern.size - 1)))
    return np.correlate(padded, pattern, "valid")
