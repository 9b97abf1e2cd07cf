"""Numerical conditioning for highly informative samples, as after a spike in a signal that stands in phi.

The sharpness of a sample is phi'phi tr(P)/R, about by how much it may shrink P in its direction.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from robust_filterpy._checks import Array

# The rounding of one correction is about 1e-16 P times the sharpness; from here on it is mended.
SHARP: Final = 1e6

# Beyond this, rounding of a P that is right would exceed R in H P H' + R.
_SHARPEST: Final = 1e13


def tempering(square: float, trace: float, r: float) -> float:
    """Return the factor, at most 1, by which to shrink a sample whose regressor has phi'phi = square."""
    if square * trace <= _SHARPEST * r:
        return 1.0
    return math.sqrt(_SHARPEST / square) * math.sqrt(r / trace)


def repaired(P: Array) -> Array:
    """Return P, or if it has lost its symmetry or its sign the nearest covariance."""
    symmetric = 0.5 * (P + P.T)
    values, vectors = np.linalg.eigh(symmetric)
    floor = np.finfo(float).eps * values[-1]
    if values[0] >= -floor:
        return P if np.array_equal(P, symmetric) else symmetric
    return np.asarray((vectors * np.maximum(values, floor)).dot(vectors.T))
