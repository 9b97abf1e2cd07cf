"""What a tracker returns: one sample, a whole recording, coefficients, intervals."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from robust_filterpy._checks import Array, real

__all__ = ["Coefficients", "Intervals", "Sample", "TrackingResult"]


class Coefficients(NamedTuple):
    """Coefficients of A(q) y = B(q) u + C(q) v without the leading 1 of A and C.

    Attributes
    ----------
    a : ndarray, shape (na,)
        a_1 .. a_na.
    b : ndarray, shape (nb,), or tuple of ndarray
        b_1 .. b_nb; with several inputs one array for each.
    c : ndarray, shape (nc,)
        c_1 .. c_nc.
    """

    a: Array
    b: Array | tuple[Array, ...]
    c: Array


class Intervals(NamedTuple):
    """Confidence intervals of the parameters.

    Attributes
    ----------
    lower, upper : ndarray, shape of theta
        Ends of the intervals.
    """

    lower: Array
    upper: Array


class Sample(NamedTuple):
    """What one update did.

    Attributes
    ----------
    prediction : float
        yhat(k) = phi(k)' theta(k-1), before y(k) is used (paper 22).
    residual : float
        y(k) - prediction (23); NaN if y is missing.
    weight : float
        psi(e)/e in [0, 1]: how much of the innovation was believed; 1 for a filter that has no weights, NaN if there
        was no correction (y missing, or adaptation off).
    guard : int
        0: the step was taken as it is; h > 0: it was halved h times; -1: it was not taken.
    """

    prediction: float
    residual: float
    weight: float
    guard: int


class Columns(NamedTuple):
    """The columns of a `TrackingResult` while they are being filled; variance is diag P."""

    theta: Array
    variance: Array
    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray

    @classmethod
    def empty(cls, *shape: int) -> Columns:
        """Return columns with these axes; the last is that of the parameters."""
        theta, variance = np.empty(shape), np.empty(shape)
        prediction, residual, weights = np.full((3, *shape[:-1]), np.nan)
        return cls(theta, variance, prediction, residual, weights, np.zeros(shape[:-1], dtype=np.int64))


class TrackingResult(NamedTuple):
    """What a recording of N samples gave, row k after sample k.

    Attributes
    ----------
    theta : ndarray, shape (N, n)
        Parameters.
    std : ndarray, shape (N, n)
        Their standard deviations, sqrt(diag P).
    prediction : ndarray, shape (N,)
        phi(k)' theta(k-1), before y(k) is used (paper 22).
    residual : ndarray, shape (N,)
        y(k) - prediction (23), NaN where y is missing.
    weights : ndarray, shape (N,)
        psi(e)/e; 1 for a filter that has no weights, NaN where there was no correction.
    guard : ndarray of int, shape (N,)
        0: step taken as it is; h > 0: halved h times; -1: not taken.
    """

    theta: Array
    std: Array
    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray

    def confidence_intervals(self, level: float = 0.95) -> Intervals:
        """Return theta -+ z std for every sample, z the normal quantile of the level.

        Parameters
        ----------
        level : float, default 0.95
            Probability of the interval, in (0, 1).

        Returns
        -------
        Intervals
            lower, upper, each of shape (N, n).
        """
        return intervals(self.theta, self.std, level)


def intervals(theta: Array, std: Array, level: float) -> Intervals:
    """Return normal confidence intervals or raise if the level is no probability."""
    if not 0.0 < real("level", level) < 1.0:
        raise ValueError(f"level: expected a number in (0, 1), got {level!r}")
    half = float(ndtri(0.5 * (1.0 + level))) * std
    return Intervals(theta - half, theta + half)
