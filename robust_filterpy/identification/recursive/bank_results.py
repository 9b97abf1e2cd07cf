"""What a TrackerBank returns: a sample, or a recording, of n actuators."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.results import Intervals, TrackingResult, intervals
from robust_filterpy.identification.models.time_axis import table

__all__ = ["BankResult", "BankSample"]


class BankSample(NamedTuple):
    """What one update did to each of n actuators; see `Sample`.

    Attributes
    ----------
    prediction : ndarray, shape (n,)
        phi(k)' theta(k-1), before y(k) is used (paper 22).
    residual : ndarray, shape (n,)
        y(k) - prediction (23); NaN where y is missing.
    weights : ndarray, shape (n,)
        psi(e)/e; NaN where there was no correction (y missing, or adaptation off).
    guard : ndarray of int, shape (n,)
        0: step taken as it is; h > 0: halved h times; -1: not taken.
    """

    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class _Recorded(NamedTuple):
    """The columns of a `BankResult`; see there."""

    theta: Array
    std: Array
    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray
    sample: np.ndarray


class BankResult(_Recorded):
    """What recordings of n actuators gave: the columns of a `TrackingResult` with an axis of actuators.

    A tuple of its first seven attributes.

    Attributes
    ----------
    theta, std : ndarray, shape (K, n, n_theta)
        Parameters and their standard deviations, after each of the K samples that were kept.
    prediction, residual, weights : ndarray, shape (K, n)
        As in `BankSample`.
    guard : ndarray of int, shape (K, n)
        As in `BankSample`.
    sample : ndarray of int, shape (K,)
        Which samples were kept.
    names : tuple of str, length n_theta
        Names of the parameters.
    actuators : tuple, length n
        The columns of y if it was a pandas DataFrame, otherwise 0, 1, ..
    index : pandas.Index or None
        When the samples that were kept were taken, if the recording was a pandas object.
    """

    names: tuple[str, ...] = ()
    actuators: tuple[Any, ...] = ()
    index: Any = None

    def __str__(self) -> str:
        """Return what fits a screen."""
        return brief(self)

    def to_frame(self) -> Any:
        """Return all columns as a pandas DataFrame, a row for each sample that was kept.

        Returns
        -------
        pandas.DataFrame
            Columns (actuator, quantity), the quantities as in `TrackingResult.to_frame`.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        actuators = self.actuators or tuple(range(self.theta.shape[1]))
        columns = {
            (actuator, name): column
            for i, actuator in enumerate(actuators)
            for name, column in self.tracker(i).columns().items()
        }
        return table(columns, self.sample, "sample") if self.index is None else table(columns, self.index)

    def tracker(self, i: int) -> TrackingResult:
        """Return what actuator i gave.

        Parameters
        ----------
        i : int
            Which actuator.

        Returns
        -------
        TrackingResult
            A row for each sample that was kept.
        """
        return TrackingResult(*(column[:, i] for column in self[:6])).labelled(self.names, self.index)

    def confidence_intervals(self, level: float = 0.95) -> Intervals:
        """Return theta -+ z std for every sample that was kept, z the normal quantile of the level.

        Parameters
        ----------
        level : float, default 0.95
            Probability of the interval, in (0, 1).

        Returns
        -------
        Intervals
            lower, upper, each of shape (K, n, n_theta).
        """
        return intervals(self.theta, self.std, level)
