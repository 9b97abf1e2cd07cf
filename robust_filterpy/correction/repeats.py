"""Whether a sensor is stuck: it repeats its last reading to the last bit, though it seldom does and its noise is white.

How often a sensor repeats itself is learned from its readings: white noise in fine steps never gives the same number
twice, one that is held for three samples repeats two in three. What changes less than white noise is none, so that
counters, sensors at rest, readings that are held and recordings without noise are believed. Whether a reading that
repeats is far from where it is expected, and so what it is worth, is for who asks.

What is learned of a sensor's readings is a row of six numbers: what the last correction left of the reading, the last
unforeseen change and the scale of their differences, how many readings there were; the last reading, and one over the
share of readings that repeat, with a minus sign if the last reading repeated the one before.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from robust_filterpy._checks import Array

__all__ = ["RARE", "WIDTH", "again", "note_change", "note_reading"]

#: Numbers of a row.
WIDTH: Final = 6
#: A share of repeats that is no habit of the sensor.
RARE: Final = 0.1
# Changes and repeats are remembered for 50 readings, and one repeat in a thousand is as rare as none. The scale of
# changes is the quantile of .7 by recursion, here of a normal |x|: outliers hardly move it, nor do readings that are
# held for three samples.
_CHANGES, _QUANTILE, _RAREST = 50.0, 1.0364333894937898, 1e-3
_LEFT, _CHANGE, _SCALE, _COUNT, _LAST, _RARE = range(WIDTH)


def note_reading(row: Array, z: float) -> None:
    """Note a reading, and how often its sensor repeats itself, in place."""
    count, last, rare = row[[_COUNT, _LAST, _RARE]].tolist()
    if count:
        share = 1.0 / max(abs(rare), 1.0)
        share = max(share + ((z == last) - share) / min(count + 1.0, _CHANGES), _RAREST)
        row[_RARE] = (-1.0 if z == last else 1.0) / share
    row[_LAST] = z


def note_change(row: Array, y: float) -> None:
    """Let an innovation, of which the last correction's rest is taken off, move the scale of changes, in place."""
    rest, before, scale, count = row[:_LAST].tolist()
    row[_COUNT] = count + 1.0
    if row[_RARE] < 0.0:
        # What repeats the reading before tells nothing of the noise.
        return
    row[_CHANGE] = y - rest if count else 0.0
    if count < 2.0:
        return
    size = abs(row[_CHANGE] - before) / _QUANTILE
    pace = 2.0 * max(1.0 / (count - 1.0), 1.0 / _CHANGES)
    # Up or down by a pace, but never beyond what was seen.
    moved = min(size, scale * math.exp(0.7 * pace)) if size > scale else max(size, scale * math.exp(-0.3 * pace))
    row[_SCALE] = moved if scale > 0.0 else size


def again(rows: Array, z: Array, r: Array) -> np.ndarray:
    """Return which readings repeat the last one though their sensors seldom do, and have white noise."""
    # White noise makes 6 r. What changes less is no noise: there a repeated reading means that the state rests.
    white = rows[..., _SCALE] ** 2 >= r
    return np.asarray((z == rows[..., _LAST]) & white & (RARE * np.abs(rows[..., _RARE]) >= 1.0))
