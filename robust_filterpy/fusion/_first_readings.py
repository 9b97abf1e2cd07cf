"""How noisy a sensor is whose R nobody told: its first readings say, and serve for nothing else.

Three readings in a row are compared with a straight line in time: the middle one is off by e with variance
R (1 + (a^2 + b^2)/(a + b)^2), a and b the times between them. Five such e, from seven readings, give R to begin with;
from then on it is learnt. The state plays no part, so it does not matter how badly it is known.
"""

from __future__ import annotations

import numpy as np

from robust_filterpy._checks import Array

__all__ = ["TRIAL", "compared", "none_yet"]

# Columns of what is remembered of a component: its age, the last reading, the time before it, the one before that, how
# many there were, then squares.
_AGE, _LAST, _GAP, _BEFORE, _COUNT, _SQUARES = 0, 1, 2, 3, 4, 5
# So many squares are needed; the median of a squared normal number is .455.
_NEEDED, _MEDIAN = 5, 0.4549
#: Length of what is remembered, for each component.
TRIAL = _SQUARES + _NEEDED


def none_yet(size: int) -> Array:
    """Return what is remembered before the first reading."""
    return np.zeros((size, TRIAL))


def compared(trial: Array, sizes: Array, seconds: float, values: Array) -> tuple[Array, Array]:
    """Return what is remembered after another moment, and the variances that are known by now."""
    unknown = np.isnan(sizes)
    if not unknown.any():
        return trial, sizes
    trial, sizes = trial.copy(), sizes.copy()
    trial[unknown, _AGE] += seconds
    for i in np.flatnonzero(unknown & ~np.isnan(values)):
        row, z = trial[i], values[i]
        count, a, b = int(row[_COUNT]), row[_GAP], row[_AGE]
        if count >= 2:
            with np.errstate(over="ignore"):
                e = row[_LAST] - (row[_BEFORE] * b + z * a) / (a + b)
                square = min(e * e / (1.0 + (a * a + b * b) / (a + b) ** 2), 1e300)
            row[_SQUARES:] = np.append(row[_SQUARES + 1 :], square)
        row[_BEFORE], row[_GAP], row[_LAST], row[_AGE], row[_COUNT] = row[_LAST], b, z, 0.0, count + 1
        # A sensor that repeats itself to the last digit has not told yet.
        if count + 1 >= _NEEDED + 2 and row[_SQUARES:].any():
            median = float(np.median(row[_SQUARES:])) / _MEDIAN
            sizes[i] = median if median > 0.0 else float(row[_SQUARES:].mean())
    return trial, sizes
