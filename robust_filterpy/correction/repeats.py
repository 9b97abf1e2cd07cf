"""Whether a sensor is stuck: it repeats its last reading to the last bit, though its noise is white and in fine steps.

White noise in steps of at most a tenth of it does not give the same number twice. The least change from reading to
reading tells how fine the steps are, and what changes less than white noise is none, so that counters, coarse sensors,
readings that are held and recordings without noise are believed. Whether a reading that repeats is far from where it is
expected, and so what it is worth, is for who asks.

What is known of a sensor's readings is a row of six numbers: what the last correction left of the reading, the last
unforeseen change and the scale of their differences, how many readings there were; the last reading, and one over the
least change that was seen, with a minus sign if the last reading repeated the one before.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from robust_filterpy._checks import Array

__all__ = ["FINE", "WIDTH", "again", "note_change", "note_reading"]

#: Numbers of a row.
WIDTH: Final = 6
#: Steps of a sensor in a standard deviation of its noise from which on it does not repeat itself by chance.
FINE: Final = 10.0
# Changes are remembered for 50 readings. Their scale is the quantile of .7 by recursion, here of a normal |x|: outliers
# hardly move it, nor do readings that are held for three samples.
_CHANGES, _QUANTILE = 50.0, 1.0364333894937898
_LEFT, _CHANGE, _SCALE, _COUNT, _LAST, _FINE = range(WIDTH)


def note_reading(row: Array, z: float, r: float) -> None:
    """Note a reading, and how fine the steps of its sensor are, in place.

    Parameters
    ----------
    row : ndarray, shape (6,)
        What is known of the readings.
    z : float
        The reading.
    r : float
        Variance of its noise, in the square of its unit.
    """
    count, last, fine = row[[_COUNT, _LAST, _FINE]].tolist()
    change = abs(z - last)
    if count and change == 0.0:
        row[_FINE] = -abs(fine)
    elif count:
        # A sensor that goes on after it has repeated itself reads in coarse steps, or only now and then. A single small
        # change is chance: it halves the steps that were known at most.
        row[_FINE] = max(fine, 0.0, min(1.0 / change, 2.0 * max(fine, r**-0.5)))
    row[_LAST] = z


def note_change(row: Array, y: float) -> None:
    """Let an innovation, of which the last correction's rest is taken off, move the scale of changes, in place.

    Parameters
    ----------
    row : ndarray, shape (6,)
        What is known of the readings.
    y : float
        The innovation, in the unit of the readings.
    """
    rest, before, scale, count = row[:_LAST].tolist()
    row[_CHANGE], row[_COUNT] = y - rest if count else 0.0, count + 1.0
    if count < 2.0:
        return
    size = abs(row[_CHANGE] - before) / _QUANTILE
    pace = 2.0 * max(1.0 / (count - 1.0), 1.0 / _CHANGES)
    # Up or down by a pace, but never beyond what was seen.
    moved = min(size, scale * math.exp(0.7 * pace)) if size > scale else max(size, scale * math.exp(-0.3 * pace))
    row[_SCALE] = moved if count > 2.0 else size


def again(rows: Array, z: Array, r: Array) -> np.ndarray:
    """Return which readings repeat the last one though the noise of their sensors is white and in fine steps.

    Parameters
    ----------
    rows : ndarray, shape (.., 6)
        What is known of the readings of each sensor.
    z : ndarray, shape (..)
        What the sensors say.
    r : ndarray, shape (..)
        Variances of their noise, in the squares of their units.

    Returns
    -------
    ndarray of bool, shape (..)
    """
    # White noise makes 6 r. What changes less is no noise: there a repeated reading means that the state rests.
    white = rows[..., _SCALE] ** 2 >= r
    return np.asarray((z == rows[..., _LAST]) & white & (np.abs(rows[..., _FINE]) * np.sqrt(r) >= FINE))
