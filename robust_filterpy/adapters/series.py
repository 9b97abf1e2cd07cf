"""Columns of a table and the filters that look after them, for libraries whose users bring no model."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from filterpy.kalman import KalmanFilter

from robust_filterpy._checks import Array
from robust_filterpy._warning import warn
from robust_filterpy.filters import RobustKalmanFilter, robust
from robust_filterpy.noise import estimate_noise
from robust_filterpy.smoothing import smooth

__all__ = ["SeriesModel"]

#: Values that `estimate_noise` needs at the least; of a long series the latest tell enough (5 % of a variance).
LEAST, LATEST = 10, 1000
#: Values whose median is the level to begin from.
FIRST = 5


@dataclass(frozen=True)
class SeriesModel:
    """Hold one filter for all columns of a table, or one for each of them.

    Attributes
    ----------
    filters : tuple of filters
        With the model set; they are copied before use, so that every series begins anew.
    given : bool
        Whether the user brought the filter, and its x and P are where to begin. A level with a slope begins at the
        first values of each series.
    """

    filters: tuple[Any, ...]
    given: bool

    @classmethod
    def of(cls, filter: Any, values: Array) -> SeriesModel:
        """Return the user's filter made robust, or a level with a slope for each column, its noises learned.

        Parameters
        ----------
        filter : RobustKalmanFilter, KalmanFilter or None
            A linear filter, of filterpy or of this package.
        values : ndarray, shape (N, columns)
            NaN marks what is missing.

        Returns
        -------
        SeriesModel

        Raises
        ------
        TypeError
            If the filter is not linear, or none at all.
        ValueError
            If its dim_z is not the number of columns, or a value is infinite.

        Warns
        -----
        UserWarning
            If a column has fewer than ten values: its noises are then a guess from their differences.
        """
        _finite(values)
        if filter is None:
            return cls(tuple(_level_and_slope(column) for column in values.T), given=False)
        if not isinstance(filter, KalmanFilter):
            raise TypeError(f"filter: expected a linear filter of filterpy's kind or None, got {type(filter).__name__}")
        ours = copy.deepcopy(filter) if isinstance(filter, RobustKalmanFilter) else robust(filter)
        model = cls((ours,), given=True)
        model.checked(values)
        return model

    def checked(self, values: Array) -> None:
        """Refuse values that this model cannot take.

        Raises
        ------
        ValueError
            If there are not as many columns as the model measures, or a value is infinite.
        """
        _finite(values)
        expected = sum(kf.dim_z for kf in self.filters)
        if values.shape[1] != expected:
            what = "the filter's dim_z" if self.given else "as in fit"
            raise ValueError(f"series: expected {expected} column(s), {what}, got {values.shape[1]}")

    def estimates(self, values: Array, *, smoothed: bool = False, states: bool = False) -> Array:
        """Return what the series was without its noise and its outliers.

        Parameters
        ----------
        values : ndarray, shape (N, columns)
            NaN marks what is missing.
        smoothed : bool, default False
            Whether later values may be used, as `smooth` does.
        states : bool, default False
            Whether to return the states instead of what would have been measured.

        Returns
        -------
        ndarray, shape (N, columns), or (N, number of states of all filters)

        Raises
        ------
        ValueError
            As `checked`.
        """
        self.checked(values)
        estimates, begin = [], 0
        for kf in self.filters:
            columns, begin = values[:, begin : begin + kf.dim_z], begin + kf.dim_z
            kf = copy.deepcopy(kf)
            if not self.given:
                kf.x[0, 0] = _first_level(columns[:, 0])
            x = smooth(kf, columns).x if smoothed else kf.batch_filter(columns)[0]
            x = np.reshape(x, (len(values), -1))
            estimates.append(x if states else x @ np.transpose(kf.H))
        return np.concatenate(estimates, axis=1)


def _finite(values: Array) -> None:
    """Refuse infinite values."""
    if np.isinf(values).any():
        raise ValueError("series: expected finite numbers or NaN (missing), got infinity")


def _first_level(column: Array) -> float:
    """Return the median of the first values that are there; 0 if there is none."""
    there = column[~np.isnan(column)][:FIRST]
    return float(np.median(there)) if there.size else 0.0


def _level_and_slope(column: Array) -> RobustKalmanFilter:
    """Return a level that wanders with a slope that wanders, and the noises of one column."""
    present = np.flatnonzero(~np.isnan(column))[-LATEST:]
    column = column[present[0] :] if present.size else column
    there = column[~np.isnan(column)]
    steps = np.abs(np.diff(there))
    # A median of 0 is a column that mostly stands still: then any step at all, then its size, sets the unit.
    unit = next((s for s in (np.median(steps) if steps.size else 0, steps.max(initial=0)) if s > 0), 0.0) or 1.0
    # Noises that were learned are believed from the first value on: it may be an outlier. A guess is not.
    kf = RobustKalmanFilter(2, 1, scaling="innovation" if len(there) >= LEAST else "learnt")
    kf.F, kf.H = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    kf.x[0, 0] = _first_level(column)
    kf.R, kf.Q = np.array([[unit**2]]), np.diag([0.1, 0.001]) * unit**2
    kf.P = np.diag([25.0, 1.0]) * unit**2
    if len(there) < LEAST:
        warn(f"series: {len(there)} value(s) do not tell their noises, which are guessed; at least {LEAST} do")
        return kf
    noise = estimate_noise(kf, column, Q="each")
    kf.R, kf.Q = noise.R, noise.Q
    return kf
