"""What a correction returns: the posterior and everything that led to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.options import ratio


class Correction(NamedTuple):
    """Posterior and everything that led to it. Where a component is missing, y, e, psi, T, SI and K are 0."""

    x: Array
    """Posterior mean, shape (n,)."""
    P: Array
    """Posterior covariance, shape (n, n)."""
    y: Array
    """Innovation z - H x, shape (m,)."""
    S: Array
    """Innovation covariance, shape (m, m)."""
    SI: Array | None
    """Its inverse, shape (m, m); None under scaling "innovation", where it is T'T."""
    K: Array
    """Gain before psi, C T'T, shape (n, m): x+ = x + K y_bounded."""
    T: Array
    """Scaling, shape (m, m)."""
    e: Array
    """Standardized innovation T y, shape (m,)."""
    psi: Array
    """psi(e), shape (m,)."""
    psi_deriv: Array | list[float]
    """psi'(e), NaN where missing, m floats."""

    @property
    def inverse(self) -> Array:
        """Inverse of S, shape (m, m)."""
        return self.T.T.dot(self.T) if self.SI is None else self.SI

    @property
    def y_bounded(self) -> Array:
        """Bounded innovation T^-1 psi(T y), in the measurement's unit, shape (m,)."""
        if np.array_equal(self.psi, self.e):
            return np.array(self.y)
        if self.T.shape == (1, 1):
            return self.psi / self.T[0]
        # Columns of T have the inverse units of the sensors, which must not decide what pinv takes for 0.
        unit = np.abs(self.T).max(axis=0)
        unit[unit == 0.0] = 1.0
        return np.asarray(np.linalg.pinv(self.T / unit) @ self.psi) / unit

    @property
    def weights(self) -> Array:
        """psi(e)/e, NaN where missing, shape (m,)."""
        return np.where(np.isnan(self.psi_deriv), np.nan, ratio(self.psi, self.e))

    @property
    def clipped(self) -> np.ndarray:
        """Whether psi'(e) <= 0, bool, shape (m,): the component tells no more by being further away."""
        return np.asarray(self.psi_deriv) <= 0.0


class Observed(NamedTuple):
    """Correction by a complete measurement; K is computed from C on request."""

    x: Array
    P: Array
    C: Array
    y: Array
    S: Array
    SI: Array | None
    T: Array
    e: Array
    psi: Array
    psi_deriv: Array | list[float]

    def as_arrays(self) -> Correction:
        """Return the same with K."""
        x, P, C, y, S, SI, T, e, psi, psi_deriv = self
        return Correction(x, P, y, S, SI, C.dot(T.T).dot(T), T, e, psi, psi_deriv)
