"""Numbers that a logger writes where it has none (9999, 1e7, 9.97e36): recognized, since they repeat far outside."""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._warning import warn

# A value that occurs less often, or in a smaller share of the samples, does not repeat.
_LEAST: Final = 3
_LEAST_SHARE: Final = 0.002
# How far outside the rest a fill value lies, in robust standard deviations of the rest, and at least its whole width.
_FAR: Final = 8.0
# Of so few different values nobody can say where the rest ends.
_LEAST_DIFFERENT: Final = 5
# A logger has one or two such numbers; more of them are a signal with several levels.
_MOST_VALUES: Final = 4

_MAD_TO_SCALE: Final = 1.482602218505602


class FillValues(NamedTuple):
    """A signal without its fill values, and which they were.

    Attributes
    ----------
    signal : ndarray, shape (N,)
        NaN where a fill value stood; the argument itself where there was none.
    values : tuple of float
        The fill values.
    counts : tuple of int
        How often each stood there.
    """

    signal: Array
    values: tuple[float, ...] = ()
    counts: tuple[int, ...] = ()

    @property
    def said(self) -> str:
        """What was found, in words; empty if nothing was."""
        each = [f"{value:.6g} ({count} samples)" for value, count in zip(self.values, self.counts, strict=True)]
        return (
            f"{', '.join(each)}: repeated exactly and far outside the rest, taken for missing samples" if each else ""
        )


def fill_values(signal: Array) -> FillValues:
    """Find the values that repeat exactly and lie far outside all others, and take them for missing.

    Parameters
    ----------
    signal : ndarray, shape (N,)
        NaN where a sample is missing.

    Returns
    -------
    FillValues

    Notes
    -----
    A value counts if it occurs in .2 % of the samples, three at least; is further from the nearest 98 % of the others
    than these are from one another, and than 8 of their robust standard deviations; has no neighbor; and is mostly
    entered from these others and left to them at once. Rounded and saturated signals, a rest at 0, on and off are left
    alone: their repeated values have neighbors, lie within the width of the others, are left on a way (a step
    response), or leave too few different others. A wild value that does not repeat is an outlier, not a fill.

    Examples
    --------
    >>> y = np.random.default_rng(1).normal(size=100)
    >>> y[::20] = 9999.0
    >>> fill_values(y).said
    '9999 (5 samples): repeated exactly and far outside the rest, taken for missing samples'
    """
    finite = signal[np.isfinite(signal)]
    values, counts = np.unique(finite, return_counts=True)
    repeated = counts >= max(_LEAST, _LEAST_SHARE * finite.size)
    if not repeated.any() or values.size <= _LEAST_DIFFERENT:
        return FillValues(signal)
    distance = np.abs(values - float(np.median(finite)))
    fills: list[int] = []
    for i in np.flatnonzero(repeated)[np.argsort(-distance[repeated])]:
        # What repeats as far out as this one may be another fill value, and says nothing of the width of the rest.
        rest = ~(repeated & (distance >= 0.5 * distance[i]))
        if rest.sum() < _LEAST_DIFFERENT or not _is_far(finite, values[i], np.repeat(values[rest], counts[rest])):
            break
        fills.append(int(i))
    if not fills or len(fills) > _MOST_VALUES:
        return FillValues(signal)
    fills.sort()
    return FillValues(
        np.where(np.isin(signal, values[fills]), np.nan, signal),
        tuple(values[fills].tolist()),
        tuple(counts[fills].tolist()),
    )


def without_fill_values(name: str, rows: Any) -> tuple[Any, Any]:
    """Return measurements with NaN for the fill values of each component, and warn of them; else the argument."""
    try:
        if isinstance(rows, np.ndarray) and rows.dtype != object:
            table = np.array(rows, dtype=float)
        else:
            table = _table(rows)
    except (TypeError, ValueError, IndexError):
        return rows, np.zeros((0, 0), dtype=bool)
    said, present = [], ~np.isnan(table)
    for place in np.ndindex(table.shape[1:]):
        column = (slice(None), *place)
        fills = fill_values(table[column])
        if fills.values:
            table[column] = fills.signal
            said.append(f"{f'component {place[0]}: ' if present[0].size > 1 else ''}{fills.said}")
    filled = (present & np.isnan(table)).reshape(len(table), math.prod(table.shape[1:]))
    if not said:
        return rows, filled
    warn(f"{name}: {'; '.join(said)}")
    return table, filled


def _table(rows: Any) -> Array:
    """Return rows of one shape as one array, NaN where a row is None."""
    present = [np.asarray(row, dtype=float) for row in rows if row is not None]
    gap = np.full(present[0].shape, np.nan)
    return np.array([gap if row is None else np.asarray(row, dtype=float) for row in rows])


def _is_far(finite: Array, value: float, others: Array) -> bool:
    """Tell whether a value lies far outside the others and between ordinary ones in time."""
    low, middle, high = np.quantile(others, [0.01, 0.5, 0.99])
    scale = _MAD_TO_SCALE * float(np.median(np.abs(others - middle)))
    # More than half of the others at one value: their width is all that there is.
    away = max(_FAR * scale, high - low)
    alone = float(np.abs(others - value).min()) > _FAR * scale
    if not (alone and bool(value > high + away or value < low - away)):
        return False
    # Samples before and after the stretches of the value.
    borders = np.flatnonzero(np.diff(finite == value))
    neighbours = np.where(finite[borders] == value, finite[borders + 1], finite[borders])
    return 2 * int(((neighbours >= low) & (neighbours <= high)).sum()) >= neighbours.size
