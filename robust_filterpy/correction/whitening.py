"""T with T S T' = I: the scaling that standardizes an innovation (paper 29, 36, 42)."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable

import numpy as np
from scipy.linalg import lapack

from robust_filterpy._checks import Array

Inverse = Callable[[Array], Array]
_LARGEST = sys.float_info.max
_EPS = sys.float_info.epsilon
# Up to here a product with T does not overflow.
SAFE = 1e150


class SingularInnovationError(np.linalg.LinAlgError):
    """Say that the innovation covariance S has no inverse."""


def standardize(S: Array, scaling: str, inv: Inverse | None = None) -> tuple[Array, Array | None, Array | None]:
    """Return the scaling T of innovations with covariance S.

    T = S^(-1/2), the symmetric root (paper 36); T = I (42); or S^(-1/2) with the eigenvalues of S floored at 1.

    Parameters
    ----------
    S : ndarray, shape (m, m)
        Innovation covariance.
    scaling : {"innovation", "unit", "bounded"}
        Which T.
    inv : callable, optional
        What inverts S; by default a singular S is an error.

    Returns
    -------
    T : ndarray, shape (m, m)
        Symmetric.
    SI : ndarray, shape (m, m), or None
        Inverse of S; None where it is T T.
    whitening_defect : ndarray, shape (m, m), or None
        I - T S T'; None where it is 0.

    Raises
    ------
    SingularInnovationError
        If S is not positive definite and inv is not given.
    """
    m = len(S)
    if scaling == "unit":
        return np.eye(m), _inverse(S) if inv is None else inv(S), np.eye(m) - S
    if inv is not None:
        return _root_of_inverse(inv(S), S, scaling)
    if scaling == "innovation" and m == 2:
        (a, b), (_, c) = S.tolist()
        p, q, r = root_of_pair(a, b, c)
        return np.array([[p, q], [q, r]]), None, None
    values, vectors = _eigen(S)
    if scaling == "bounded":
        quarter = vectors / np.maximum(values, 1.0) ** 0.25
        whitening_defect = (vectors * np.maximum(1.0 - values, 0.0)).dot(vectors.T)
        return quarter.dot(quarter.T), (vectors / values).dot(vectors.T), whitening_defect
    # T as a product of one factor with its own transpose is symmetric to the last bit.
    # A triangular solve of bandwidth 0 divides the rows in half the time of numpy's broadcasting.
    quarter, _ = lapack.dtbtrs(np.sqrt(np.sqrt(values))[None], vectors.T)
    return quarter.T.dot(quarter), None, None


def standardized(T: Array, y: Array) -> Array:
    """Return e = T y (paper 29), finite even where the product overflows."""
    peak = max(map(abs, y.tolist()))
    if peak < SAFE:
        return T.dot(y)
    with np.errstate(over="ignore"):
        return np.clip(T.dot(y / peak) * peak, -_LARGEST, _LARGEST)


def _eigen(S: Array) -> tuple[Array, Array]:
    """Return eigenvalues, ascending, and eigenvectors of a positive definite S."""
    values, vectors, failed = lapack.dsyev(S)
    spread = values.tolist()
    if failed or not spread[0] > len(spread) * _EPS * spread[-1]:
        if not np.isfinite(S).all():
            raise SingularInnovationError("S = H P H' + R: not finite; check H, P and R for NaN, infinity and overflow")
        # Sensors in very different units: as long as they are uncorrelated, the root is exact.
        values, vectors = S.diagonal(), np.eye(len(spread))
        if np.count_nonzero(S) > np.count_nonzero(values) or not values.min() > 0.0:
            raise _singular(spread[0])
    return values, vectors


def _singular(least: float) -> SingularInnovationError:
    """Return the error of an S without inverse."""
    return SingularInnovationError(
        f"S = H P H' + R: singular (least eigenvalue {least:.3g}); make R positive definite, or set "
        f"inv=numpy.linalg.pinv to ignore the directions that carry no information"
    )


def _inverse(S: Array) -> Array:
    """Return the symmetric inverse of a positive definite S."""
    values, vectors = _eigen(S)
    return np.asarray((vectors / values) @ vectors.T)


def root_of_pair(a: float, b: float, c: float) -> tuple[float, float, float]:
    """Return S^(-1/2), S = [[a, b], [b, c]]: with s = sqrt(det S), S^(1/2) = (S + s I)/sqrt(tr S + 2 s)."""
    determinant = a * c - b * b
    if not (a > 0.0 and c > 0.0 and determinant > 4.0 * _EPS * a * c and determinant < math.inf):
        _eigen(np.array([[a, b], [b, c]]))
        correlation = b / math.sqrt(a) / math.sqrt(c)
        s = math.sqrt(a) * math.sqrt(c) * math.sqrt(max(1.0 - correlation**2, 0.0))
        if not 0.0 < s < math.inf:
            raise _singular(s)
    else:
        s = math.sqrt(determinant)
    t = math.sqrt(a + c + 2.0 * s)
    return (c + s) / t / s, -b / t / s, (a + s) / t / s


def _root_of_inverse(SI: Array, S: Array, scaling: str) -> tuple[Array, Array | None, Array | None]:
    """Return the symmetric root of whatever inverse the user wants of S."""
    values, vectors = np.linalg.eigh(0.5 * (SI + SI.T))
    if values[0] < -1e-10 * max(values[-1], 0.0) or not np.isfinite(values).all():
        raise SingularInnovationError(
            f"inv(S): expected a positive semidefinite matrix, got least eigenvalue {values[0]:.3g}; check R and inv"
        )
    kept = values > S.shape[0] * _EPS * max(values[-1], 0.0)
    root = np.sqrt(np.where(kept, values, 0.0))
    if scaling == "bounded":
        root = np.minimum(root, 1.0)
    T = (vectors * root) @ vectors.T
    return T, np.asarray(SI, dtype=float), np.eye(S.shape[0]) - T @ S @ T
