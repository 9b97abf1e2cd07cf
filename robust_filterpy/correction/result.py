"""What a correction returns, and T of a group and of all groups in the order taken (paper 29, 36, 42), of a noise."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array

__all__ = [
    "Correction", "SingularInnovationError", "correlation_whitening", "group_scaling", "is_cancelled",
    "ordered_scaling", "singular",
]  # fmt: skip

# What is left of a variance of 1 below this is rounding, not a sensor's own noise.
_ROUNDING = 1e-13


# LinAlgError is a ValueError from numpy 1.25 on.
class SingularInnovationError(np.linalg.LinAlgError, ValueError):
    """Say that the innovation covariance S has no inverse."""


def is_cancelled(block: Array, variances: Array) -> bool:
    """Return whether what is left of a group's covariance is not positive definite beyond rounding."""
    if not (np.isfinite(block).all() and (variances > 0.0).all()):
        return True
    if len(block) == 1:
        return not block[0, 0] > _ROUNDING * variances[0]
    try:
        root = np.linalg.cholesky(block)
    except np.linalg.LinAlgError:
        return True
    return bool((root.diagonal() ** 2 <= _ROUNDING * variances).any())


def group_scaling(block: Array, scaling: str) -> Array:
    """Return T of one group."""
    k = len(block)
    if scaling == "unit":
        return np.eye(k)
    if scaling == "bounded":
        largest = block[0, 0] if k == 1 else np.linalg.eigvalsh(block)[-1]
        return np.eye(k) / math.sqrt(max(float(largest), 1.0))
    if k == 1:
        return 1.0 / np.sqrt(block)
    # Units first: they must not decide what is rounding.
    unit = np.sqrt(block.diagonal())
    root = np.linalg.cholesky(block / unit / unit[:, None])
    # An ordinary inverse: scipy's triangular one starts threads, which take ten times as long as the work.
    return np.tril(np.linalg.inv(root)) / unit


def ordered_scaling(S: Array, order: tuple[tuple[int, ...], ...], scaling: str) -> Array:
    """Return T, the rows of all groups together, as if none of them had been clipped."""
    S, start = np.array(S, dtype=float), S.diagonal().copy()
    T, W = np.zeros_like(S), np.eye(len(S))
    for group in map(list, order):
        block = S[np.ix_(group, group)]
        if is_cancelled(block, start[group]):
            continue
        t = group_scaling(block, scaling)
        q, w = S[:, group] @ t.T, W[:, group] @ t.T
        T[group] = w.T
        W -= w @ q.T
        S -= q @ q.T
    return T


def correlation_whitening(S: Array) -> Array:
    """Return T = Z^(-1/2) diag(S)^(-1/2), T S T' = I, Z the correlation matrix of S; raise if that has no inverse."""
    # Of all such T this one keeps every component closest to its own sensor, in correlation, and depends neither on
    # units nor on the order of the sensors (ZCA-cor: Kessy, Lewin and Strimmer, The American Statistician 72, 2018).
    variances = S.diagonal()
    if not ((variances > 0.0).all() and np.isfinite(S).all()):
        raise singular(S)
    unit = np.sqrt(variances)
    values, vectors = np.linalg.eigh(S / unit / unit[:, None])
    if not values[0] > len(S) * np.finfo(float).eps * values[-1]:
        raise singular(S)
    return np.asarray((vectors / np.sqrt(values)).dot(vectors.T) / unit)


def singular(S: Array) -> SingularInnovationError:
    """Return the error that says what is wrong with an S without inverse, and how far from one it is."""
    if not np.isfinite(S).all():
        return SingularInnovationError("S = H P H' + R: not finite; check H, P and R for NaN, infinity and overflow")
    variances = np.maximum(S.diagonal(), 0.0)
    units = np.sqrt(np.outer(variances, variances))
    least = float(np.linalg.eigvalsh(S / np.where(units > 0.0, units, 1.0))[0])
    if least < -1e-6:
        return SingularInnovationError(
            f"S = H P H' + R: singular or negative (least eigenvalue {least:.3g}); P or R is no covariance matrix: "
            "look at both, and at the Q that predict adds to P"
        )
    return SingularInnovationError(
        f"S = H P H' + R: singular (least eigenvalue {least:.3g}); make R positive definite, or, without "
        f"noise=, set inv=numpy.linalg.pinv to ignore the directions that carry no information"
    )


class Correction(NamedTuple):
    """Posterior and everything that led to it. Where a component is missing, y, e, T and K are 0."""

    #: Posterior mean, shape (n,).
    x: Array
    #: Posterior covariance, shape (n, n).
    P: Array
    #: Covariance of state and innovation, shape (n, m).
    C: Array
    #: Innovation z - H x, shape (m,).
    y: Array
    #: Innovation covariance, shape (m, m).
    S: Array
    #: v in x+ = x + C v, shape (m,): T' psi where T has the rows by which the sensors were judged.
    score: Array
    #: B in P+ = P - C B C', shape (m, m): T'D T likewise.
    information: Array
    #: Standardized innovation of each sensor given those before it, shape (m,); T y while none of these is clipped.
    e: Array
    #: psi(e)/e, NaN where missing, shape (m,).
    weights: Array
    #: psi'(e), NaN where missing, shape (m,).
    psi_deriv: Array
    #: Groups of sensors in the order in which they were taken, the most plausible first.
    order: tuple[tuple[int, ...], ...]
    #: Which T.
    scaling: str
    #: Log-likelihood of the innovation under the density of psi; 0 if all is missing.
    log_density: float
    #: Of the sensors afterwards, shape (m, `spread.NUMBERS`), under scaling "learnt".
    memory: Array | None = None
    #: Under a mixture, that a component was an outlier.
    outlier_probability: float = 0.0

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
