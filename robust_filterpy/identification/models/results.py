"""What a tracker returns: one sample, a whole recording, coefficients, intervals."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from robust_filterpy._brief import brief, lines_of
from robust_filterpy._checks import Array, real
from robust_filterpy._pictures import Pictured
from robust_filterpy.identification.models.time_axis import table

__all__ = [
    "BoxJenkinsCoefficients",
    "Coefficients",
    "Intervals",
    "PolynomialCoefficients",
    "Sample",
    "TrackingResult",
]


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

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class BoxJenkinsCoefficients(NamedTuple):
    """Coefficients of y = B(q)/F(q) u + C(q)/D(q) v without the leading 1 of F, C and D.

    Attributes
    ----------
    b : ndarray, shape (nb,), or tuple of ndarray
        b_1 .. b_nb; with several inputs one array for each.
    f : ndarray, shape (nf,)
        f_1 .. f_nf.
    c : ndarray, shape (nc,)
        c_1 .. c_nc.
    d : ndarray, shape (nd,)
        d_1 .. d_nd.
    """

    b: Array | tuple[Array, ...]
    f: Array
    c: Array
    d: Array

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class PolynomialCoefficients(NamedTuple):
    """Coefficients of a `Structure` that is none of the usual ones.

    Attributes
    ----------
    a, f, c, d : ndarray
        Without the leading 1s.
    b : ndarray, or tuple of ndarray with several inputs
        Coefficients of B.
    """

    a: Array
    b: Any
    f: Array
    c: Array
    d: Array

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class Intervals(NamedTuple):
    """Confidence intervals of the parameters.

    Attributes
    ----------
    lower, upper : ndarray, shape of theta
        Ends of the intervals.
    """

    lower: Array
    upper: Array

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


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

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


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


class _Recorded(NamedTuple):
    """The columns of a `TrackingResult`; see there."""

    theta: Array
    std: Array
    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray


class TrackingResult(Pictured, _Recorded):
    """What a recording of N samples gave, row k after sample k; a tuple of its first six attributes.

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
    names : tuple of str, length n
        Names of the parameters.
    index : pandas.Index or None
        When the samples were taken, if the recording was a pandas object.
    """

    picture = "figures.plot_parameters"

    names: tuple[str, ...] = ()
    index: Any = None

    def __str__(self) -> str:
        """Return what fits a screen, and where the parameters end."""
        if not len(self.theta) or len(self.names) != self.theta.shape[1]:
            return brief(self)
        each = zip(self.names, self.theta[-1], self.std[-1], strict=True)
        end = ", ".join(f"{name} {value:.4g} +- {std:.2g}" for name, value, std in each)
        return "\n".join([brief(self), *lines_of({"at the end": end})])

    def labelled(self, names: tuple[str, ...], index: Any = None) -> TrackingResult:
        """Return the same columns with names of the parameters and an index.

        Parameters
        ----------
        names : tuple of str, length n
            Names of the parameters.
        index : pandas.Index, optional
            When the samples were taken.

        Returns
        -------
        TrackingResult
        """
        found = TrackingResult(*self)
        found.names, found.index = names, index
        return found

    def to_frame(self) -> Any:
        """Return all columns as a pandas DataFrame, a row for each sample.

        Returns
        -------
        pandas.DataFrame
            The parameters by their names, their standard deviations as "a1_std", prediction, residual, weight, guard;
            on the index of the recording.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        return table(self.columns(), self.index, "sample" if self.index is None else None)

    def columns(self) -> dict[str, Array]:
        """Return the columns by name.

        Returns
        -------
        dict of str to ndarray
            As in `to_frame`.
        """
        names = self.names or tuple(f"theta{j + 1}" for j in range(self.theta.shape[-1]))
        columns = dict(zip(names, np.moveaxis(self.theta, -1, 0), strict=True))
        columns |= {f"{name}_std": std for name, std in zip(names, np.moveaxis(self.std, -1, 0), strict=True)}
        rest = {"prediction": self.prediction, "residual": self.residual, "weight": self.weights, "guard": self.guard}
        return columns | rest

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
