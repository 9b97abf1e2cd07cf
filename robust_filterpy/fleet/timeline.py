"""Times of samples: late ones and duplicates, and gaps on a regular grid."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array

#: What may be done with a sample that is not later than the one before it.
POLICIES: Final = ("refuse", "drop")
# How far from a whole number of sampling periods a sample may lie.
_JITTER: Final = 0.25
# A longer silence is no gap but another recording.
_LONGEST: Final = 100_000


class Timeline(NamedTuple):
    """Where samples stand among the steps of a model."""

    kept: np.ndarray
    """Which rows of the batch are taken, shape (K,)."""
    place: np.ndarray
    """Which step each of them is, shape (K,)."""
    steps: int
    """How many steps there are."""
    last: float
    """Time of the last sample, NaN if there has been none."""


def seconds(times: Any) -> Array:
    """Return times as float seconds, shape (N,), or raise; dates count from 1970."""
    found = np.asarray(times)
    if found.dtype.kind == "O" and found.size and all(hasattr(one, "timestamp") for one in found.flat):
        found = np.array([one.timestamp() for one in found.flat])
    if found.dtype.kind in "mM":
        unit = found.dtype.str[1]
        nanoseconds = found.astype(f"{unit}8[ns]")
        missing, whole = np.isnat(nanoseconds), nanoseconds.astype(np.int64)
        # Whole seconds first, or the nanoseconds would be rounded away.
        values = whole // 1_000_000_000 + (whole % 1_000_000_000) * 1e-9
        found = np.where(missing, np.nan, values)
    values = _checks.numbers("time", found)
    bad = ~np.isfinite(values)
    if values.ndim != 1 or bad.any():
        where = f"none in row {int(np.argmax(bad))}" if values.ndim == 1 else f"shape {values.shape}"
        raise ValueError(f"time: expected a time for each sample, got {where}")
    return values


def timeline(times: Array | None, n: int, last: float, dt: float | None, late: str) -> Timeline:
    """Return where n samples stand after one at the time last (NaN if there is none), or raise.

    Parameters
    ----------
    times : ndarray, shape (n,), or None
        In seconds; None if samples have no times, and each is a step.
    n : int
        Number of samples.
    last : float
        Time of the sample before them.
    dt : float, optional
        Sampling period in seconds, which makes steps of what is missing between samples; without it each sample is
        a step.
    late : {"refuse", "drop"}
        What is done with a sample that is not later than the one before it.

    Returns
    -------
    Timeline
        kept, place, steps, last.

    Raises
    ------
    ValueError
        If a sample is late and late is "refuse", or lies between the steps, or after a gap of more than 1e5 steps.
    """
    if times is None:
        return Timeline(np.arange(n), np.arange(n), n, last)
    before = np.fmax.accumulate(np.concatenate(([last], times)))[:-1]
    least = 0.0 if dt is None else _JITTER * dt
    # One that is left out is not later than what stands before it, and so changes no other's fate.
    kept = np.isnan(before) | (times > before + least)
    if dt is not None and late == "drop":
        kept = _spread(times, last, least)
    if late == "refuse" and not kept.all():
        k = int(np.argmin(kept))
        what = "a duplicate" if times[k] == before[k] else "late" if times[k] < before[k] else "too early for the next"
        raise ValueError(
            f"time: expected each sample later than the one before it, at {before[k]:.15g}, got {times[k]:.15g} in row "
            f'{k}, which is {what}; sort them, or use late="drop"'
        )
    rows = np.flatnonzero(kept)
    if dt is None or not rows.size:
        return Timeline(rows, np.arange(rows.size), rows.size, float(times[rows[-1]]) if rows.size else last)
    chosen = times[rows]
    apart = np.diff(chosen, prepend=chosen[0] - dt if np.isnan(last) else last) / dt
    periods = np.rint(apart)
    off = np.abs(apart - periods) > _JITTER
    if off.any():
        k = int(np.argmax(off))
        raise ValueError(
            f"time: expected whole numbers of dt={dt:g} s between samples, within {_JITTER:.0%} of it, got "
            f"{apart[k]:.3g} of it before row {rows[k]}"
        )
    if periods.max() > _LONGEST:
        k = int(np.argmax(periods))
        raise ValueError(
            f"time: expected gaps of at most {_LONGEST} steps of dt={dt:g} s, got {periods[k]:.6g} before row {rows[k]}"
            f"; start anew with state None"
        )
    place = np.cumsum(periods).astype(int) - 1
    return Timeline(rows, place, int(place[-1]) + 1, float(chosen[-1]))


def _spread(times: Array, last: float, least: float) -> np.ndarray:
    """Return which samples are later than the last one that was taken by more than least."""
    kept = np.zeros(times.size, dtype=bool)
    for k, time in enumerate(times.tolist()):
        if not time <= last + least:
            kept[k], last = True, time
    return kept
