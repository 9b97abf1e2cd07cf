"""T with T S T' = I: the scaling that standardizes an innovation (paper 29, 36, 42)."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable

import numpy as np
from scipy.linalg import lapack

from robust_filterpy._checks import Array
from robust_filterpy.correction.standardization import SingularInnovationError, singular_error

Inverse = Callable[[Array], Array]
_EPS = sys.float_info.epsilon


def standardize(S: Array, scaling: str, inv: Inverse | None = None) -> tuple[Array, Array | None, Array | None]:
    """Return the scaling T of innovations with covariance S.

    With Z the correlation matrix of S, "innovation" is ``T = Z^(-1/2) diag(S)^(-1/2)``, so that T S T' = I (paper 36);
    "unit" is T = I (42); "bounded" is S^(-1/2) with the eigenvalues of S floored at 1.

    Parameters
    ----------
    S : ndarray, shape (m, m)
        Innovation covariance.
    scaling : {"innovation", "unit", "bounded"}
        Which T.
    inv : callable, optional
        What inverts S; T'T is then inv(S). By default a singular S is an error.

    Returns
    -------
    T : ndarray, shape (m, m)
        Not symmetric under "innovation".
    SI : ndarray, shape (m, m), or None
        Inverse of S; None where it is T'T.
    whitening_defect : ndarray, shape (m, m), or None
        I - T S T'; None where it is 0.

    Raises
    ------
    SingularInnovationError
        If S is not positive definite and inv is not given.

    Notes
    -----
    Of all T with T S T' = I this one keeps every component of e closest to its own sensor, in correlation, and depends
    neither on the units of the sensors nor on their order (ZCA-cor: Kessy, Lewin and Strimmer, The American
    Statistician 72, 2018). S^(-1/2) depends on the units.

    Examples
    --------
    >>> T, _, _ = standardize(np.array([[4.0, 0.0], [0.0, 1e-6]]), "innovation")
    >>> T
    array([[5.e-01, 0.e+00],
           [0.e+00, 1.e+03]])
    """
    if inv is not None:
        return _from_inverse(inv(S), S, scaling)
    if scaling == "innovation":
        return _correlation_whitening(S), None, None
    m = len(S)
    if scaling == "unit":
        T = _correlation_whitening(S)
        return np.eye(m), T.T.dot(T), np.eye(m) - S
    values, vectors = _eigen(S)
    # Exactly I where it is I: rounding must not mix the sensors.
    T = np.eye(m) if values[-1] <= 1.0 else (vectors / np.sqrt(np.maximum(values, 1.0))).dot(vectors.T)
    return T, (vectors / values).dot(vectors.T), (vectors * np.maximum(1.0 - values, 0.0)).dot(vectors.T)


def _correlation_whitening(S: Array) -> Array:
    """Return Z^(-1/2) diag(S)^(-1/2), Z being the correlation matrix of S."""
    variances = S.diagonal()
    if len(S) == 2:
        return _of_pair(*S.ravel().tolist())
    least, most = min(variances.tolist()), max(variances.tolist())
    if not (least > 0.0 and most < math.inf):
        raise singular_error(S, least)
    unit = np.sqrt(variances)
    values, vectors, failed = lapack.dsyev(S / unit / unit[:, None])
    roots = values.tolist()
    if failed or not roots[0] > len(roots) * _EPS * roots[-1]:
        raise singular_error(S, roots[0])
    return (vectors / np.sqrt(values)).dot(vectors.T) / unit


def _of_pair(a: float, b: float, _: float, c: float) -> Array:
    """Return the whitening for two sensors in closed form."""
    if not (0.0 < a < math.inf and 0.0 < c < math.inf):
        raise singular_error(np.array([[a, b], [b, c]]), min(a, c))
    first, second = math.sqrt(a), math.sqrt(c)
    correlation = b / first / second
    if not 1.0 - abs(correlation) > 2.0 * _EPS:
        raise singular_error(np.array([[a, b], [b, c]]), 1.0 - abs(correlation))
    p, q = 1.0 / math.sqrt(1.0 + correlation), 1.0 / math.sqrt(1.0 - correlation)
    same, other = 0.5 * (p + q), 0.5 * (p - q)
    return np.array([[same / first, other / second], [other / first, same / second]])


def _eigen(S: Array) -> tuple[Array, Array]:
    """Return eigenvalues, ascending, and eigenvectors of a positive definite S."""
    if len(S) > 1 and np.count_nonzero(S) == np.count_nonzero(S.diagonal()):
        # Exact, however different the units of the sensors are.
        order = np.argsort(S.diagonal())
        values, vectors, failed = S.diagonal()[order], np.eye(len(S))[:, order], 0
        smallest = values[0]
    else:
        values, vectors, failed = lapack.dsyev(S)
        smallest = values[0] - len(S) * _EPS * values[-1]
    if failed or not (smallest > 0.0 and values[-1] < math.inf):
        raise singular_error(S, values[0])
    return values, vectors


def _from_inverse(SI: Array, S: Array, scaling: str) -> tuple[Array, Array | None, Array | None]:
    """Return the scaling that belongs to whatever inverse the user wants of S."""
    m = len(S)
    SI = np.asarray(SI, dtype=float)
    if scaling == "unit":
        return np.eye(m), SI, np.eye(m) - S
    variances = S.diagonal()
    unit = np.sqrt(np.where(variances > 0.0, variances, 1.0)) if scaling == "innovation" else np.ones(m)
    values, vectors = np.linalg.eigh(0.5 * (SI + SI.T) * unit * unit[:, None])
    if values[0] < -1e-10 * max(values[-1], 0.0) or not np.isfinite(values).all():
        raise SingularInnovationError(
            f"inv(S): expected a positive semidefinite matrix, got least eigenvalue {values[0]:.3g}; check R and inv"
        )
    regular = values > m * _EPS * max(values[-1], 0.0)
    roots = np.sqrt(np.where(regular, values, 0.0))
    if scaling == "bounded":
        roots = np.minimum(roots, 1.0)
    T = (vectors * roots).dot(vectors.T) / unit
    return T, SI, np.eye(m) - T.dot(S).dot(T.T)
