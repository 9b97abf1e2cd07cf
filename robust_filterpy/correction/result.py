"""What a correction returns: the posterior and everything that led to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.standardization import ordered_scaling

__all__ = ["Correction"]


class Correction(NamedTuple):
    """Posterior and everything that led to it. Where a component is missing, y, e, T and K are 0."""

    x: Array
    """Posterior mean, shape (n,)."""
    P: Array
    """Posterior covariance, shape (n, n)."""
    C: Array
    """Covariance of state and innovation, shape (n, m)."""
    y: Array
    """Innovation z - H x, shape (m,)."""
    S: Array
    """Innovation covariance, shape (m, m)."""
    score: Array
    """v in x+ = x + C v, shape (m,): T' psi where T has the rows by which the sensors were judged."""
    information: Array
    """B in P+ = P - C B C', shape (m, m): T'D T likewise."""
    e: Array
    """Standardized innovation of each sensor given those before it, shape (m,); T y while none of these is clipped."""
    weights: Array
    """psi(e)/e, NaN where missing, shape (m,)."""
    psi_deriv: Array
    """psi'(e), NaN where missing, shape (m,)."""
    order: tuple[tuple[int, ...], ...]
    """Groups of sensors in the order in which they were taken, the most plausible first."""
    scaling: str
    """Which T."""
    log_density: float
    """Log-likelihood of the innovation under the density of psi; 0 if all is missing."""
    memory: Array | None = None
    """Of the sensors afterwards, shape (m, 17), under scaling "learnt"."""
    outlier_probability: float = 0.0
    """Under a mixture, that a component was an outlier."""

    @property
    @np.errstate(under="ignore", over="ignore")
    def T(self) -> Array:
        """Scaling, shape (m, m): the inverse Cholesky factor of S in the order taken (paper 36)."""
        return ordered_scaling(self.S, self.order, self.scaling)

    @property
    @np.errstate(under="ignore", over="ignore")
    def inverse(self) -> Array:
        """Inverse of S, shape (m, m), 0 where a component is missing."""
        T = ordered_scaling(self.S, self.order, "innovation")
        return T.T @ T

    @property
    @np.errstate(under="ignore", over="ignore")
    def K(self) -> Array:
        """Gain before psi, C T'T, shape (n, m): x+ = x + K y_bounded."""
        T = self.T
        return self.C @ T.T @ T

    @property
    @np.errstate(under="ignore", over="ignore")
    def y_bounded(self) -> Array:
        """Bounded innovation, in the measurement's unit, shape (m,): y where nothing is bounded."""
        if len(self.y) == 1 and self.weights[0] == 1.0:
            return np.array(self.y)
        T = self.T
        if self.scaling in ("innovation", "learnt"):
            seen = np.flatnonzero(T.any(axis=1))
            bounded = np.zeros_like(self.y)
            bounded[seen] = self.S[np.ix_(seen, seen)] @ self.score[seen]
            return bounded
        # Columns of T have the inverse units of the sensors, which must not decide what pinv takes for 0.
        unit = np.abs(T).max(axis=0)
        unit[unit == 0.0] = 1.0
        inverse = np.linalg.pinv(T / unit) / unit[:, None]
        return np.asarray(inverse @ (inverse.T @ self.score))

    @property
    def clipped(self) -> np.ndarray:
        """Whether psi'(e) <= 0, bool, shape (m,): the component tells no more by being further away."""
        return np.asarray(self.psi_deriv) <= 0.0
