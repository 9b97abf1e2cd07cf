"""P+ = P - C T' D T C' in forms that stay positive semidefinite in rounding (paper 28, 39, 44, 49)."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from robust_filterpy._checks import Array

_HALF = np.array(0.5)


# LinAlgError is a ValueError from numpy 1.25 on.
class NotPositiveDefiniteError(np.linalg.LinAlgError, ValueError):
    """Say that scaling "unit" would make P indefinite: it is a filter only while H P H' < 1."""


def innovation_moments(P: Array, H: Array, R: Array, M: Array | None) -> tuple[Array, Array]:
    """Return C = P H' + M and S = H P H' + H M + M' H' + R."""
    C = P.dot(H.T)
    S = H.dot(C)
    S += R
    if M is not None:
        C += M
        HM = H.dot(M)
        S += HM + HM.T
    return C, S


def posterior_covariance(
    P: Array,
    H: Array,
    R: Array,
    G: Array,
    T: Array,
    D: Array | list[float],
    whitening_defect: Array | None = None,
    M: Array | None = None,
) -> Array:
    """Return P+ = P - G D G' with G = C T', in a form that stays positive semidefinite in rounding.

    With K_D = G D T it is Joseph's form of the gain K_D, plus what psi leaves unused::

        P+ = (I - K_D H) P (I - K_D H)' + K_D R K_D' - (I - K_D H) M K_D' - K_D M' (I - K_D H)'
             + G (D - D^2 + D (I - T S T') D) G'

    Parameters
    ----------
    P : ndarray, shape (n, n)
        Prior covariance.
    H : ndarray, shape (m, n)
        Measurement matrix.
    R : ndarray, shape (m, m)
        Measurement noise covariance.
    G : ndarray, shape (n, m)
        Standardized gain C T'.
    T : ndarray, shape (m, m)
        Scaling.
    D : list of m floats, or ndarray, shape (m, m)
        Information, its diagonal or the matrix.
    whitening_defect : ndarray, shape (m, m), optional
        I - T S T'; None where it is 0.
    M : ndarray, shape (n, m), optional
        Covariance of the state's error and the measurement noise.

    Returns
    -------
    ndarray, shape (n, n)
        Symmetric.
    """
    unused = None
    if isinstance(D, list):
        none, whole = D.count(0.0), D.count(1.0)
        if none == len(D):
            return P.copy()
        if none + whole == len(D):
            GD = G * np.array(D) if none else G
        else:
            d = np.array(D)
            GD = G * d
            unused = (G * (d - d * d)).dot(G.T)
    else:
        GD = G.dot(D)
        unused = G.dot(D - D.dot(D)).dot(G.T)
    P_post = joseph(P, H, R, GD.dot(T), M)
    if unused is not None:
        P_post += unused
    if whitening_defect is not None:
        P_post += GD.dot(whitening_defect).dot(GD.T)
    return symmetrized(P_post)


def joseph(P: Array, H: Array, R: Array, K: Array, M: Array | None) -> Array:
    """Return the covariance that a gain K leaves, (I - K H) P (I - K H)' + K R K', and the terms of M."""
    I_KH = identity(len(P)) - K.dot(H)
    P_post = I_KH.dot(P).dot(I_KH.T)
    P_post += K.dot(R).dot(K.T)
    if M is not None:
        cross = I_KH.dot(M).dot(K.T)
        P_post -= cross + cross.T
    return P_post


def symmetrized(P: Array) -> Array:
    """Return (P + P')/2: rounding must not let a covariance drift away from its transpose over many steps."""
    # A copy first, and an array for the number: two thirds of the time of (P + P.T)*0.5, twice in every step.
    mean = P.T.copy()
    mean += P
    mean *= _HALF
    return mean


@lru_cache(maxsize=64)
def _small_identity(n: int) -> Array:
    """Return I, to be read only."""
    matrix = np.eye(n)
    matrix.flags.writeable = False
    return matrix


def identity(n: int) -> Array:
    """Return I, to be read only; what is kept of it for the next call takes at most half a megabyte in all."""
    return _small_identity(n) if n <= 32 else np.eye(n)


def _require_positive(P_post: Array, D: Array | list[float], N: Array) -> None:
    """Raise if P+ is indefinite, naming H P H'."""
    if np.linalg.eigvalsh(P_post)[0] < -1e-13 * np.abs(P_post).max():
        informed = np.diag(D) if isinstance(D, list) else D
        raise _indefinite(float(np.linalg.eigvals(informed @ N).real.max()))


def _indefinite(hph: float) -> NotPositiveDefiniteError:
    """Return the error of a "unit" correction that would make P indefinite."""
    return NotPositiveDefiniteError(
        f'scaling="unit" would make P indefinite: it needs D H P H\' < 1 in the unit of the measurement squared, '
        f'found {hph:.6g}; use scaling="bounded" or "innovation", a smaller P, or a larger unit of measurement'
    )
