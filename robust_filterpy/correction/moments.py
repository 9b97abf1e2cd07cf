"""The robust correction from moments alone: for filters that know C and S but no measurement matrix.

The same three equations as in `robust_filterpy.correction`, with the cross-covariance C of state and innovation
and the innovation covariance S given, as sigma points give them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.covariance import NotPositiveDefiniteError
from robust_filterpy.correction.missing import nothing_observed, scatter
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction
from robust_filterpy.correction.whitening import Inverse, standardize, standardized

__all__ = ["correct_moments"]

# Below this correlation a component is one that the state has no part in: sigma points leave rounding, not zeros.
_NO_PART = 1e-12


def correct_moments(
    x: Array,
    P: Array,
    y: Array,
    C: Array,
    S: Array,
    R: Array,
    choices: Choices,
    inv: Inverse | None = None,
    add: Callable[[Array, Array], Array] = np.add,
) -> Correction:
    """Correct a state by an innovation whose influence is bounded, from its moments.

    x+ = x + C T' psi(T y) and P+ = P - C T' D T C' (paper 26-28, 37-39, 42-44, 47-49).

    Parameters
    ----------
    x : ndarray, shape (n,)
        Prior mean.
    P : ndarray, shape (n, n)
        Prior covariance.
    y : ndarray, shape (m,)
        Innovation; NaN marks a missing component.
    C : ndarray, shape (n, m)
        Covariance of the state and the innovation.
    S : ndarray, shape (m, m)
        Innovation covariance.
    R : ndarray, shape (m, m)
        The part of S that is measurement noise; the error of scaling "unit" names the rest.
    choices : Choices
        Influence function, scaling, information, grouping.
    inv : callable, optional
        What inverts S, as in `robust_filterpy.correction.correct`.
    add : callable, default numpy.add
        ``add(x, dx)`` moves a state, where that is more than a sum (angles).

    Returns
    -------
    Correction

    Raises
    ------
    NotPositiveDefiniteError
        If scaling is "unit" and P+ would be indefinite.
    SingularInnovationError
        If S is not positive definite and inv is not given.

    Notes
    -----
    P - G D G' is positive semidefinite wherever the joint covariance [[P, C], [C', S]] is; the form that stays so
    in rounding needs a measurement matrix.

    Examples
    --------
    >>> one = np.eye(1)
    >>> c = correct_moments(np.zeros(1), one, np.array([100.0]), one, 2.0 * one, one, Choices())
    >>> c.x.round(3), c.clipped
    (array([0.951]), array([ True]))
    """
    part = np.flatnonzero(y == y)
    m = y.size
    if part.size == 0:
        return nothing_observed(x, P, S, m)
    pick = np.ix_(part, part)
    Sp, Cp = S[pick], C[:, part]
    T, SI, _ = standardize(Sp, choices.scaling, inv)
    e = standardized(T, y[part])
    psi, D, psi_deriv = choices.apply_influence(e, None if choices.grouping == "component" else _visible(P, Cp, Sp))
    G = Cp.dot(T.T)
    unclipped = np.diag(D) if isinstance(D, list) else D
    reduction = G.dot(unclipped).dot(G.T)
    P_post = P - 0.5 * (reduction + reduction.T)
    if choices.scaling == "unit" and np.linalg.eigvalsh(P_post)[0] < -1e-13 * np.abs(P_post).max():
        found = float(np.linalg.eigvals(unclipped @ (Sp - R[pick])).real.max())
        raise NotPositiveDefiniteError(
            f'scaling="unit" would make P indefinite: it needs D (S - R) < 1 in the unit of the measurement squared, '
            f'found {found:.6g}; use scaling="bounded" or "innovation", a smaller P, or a larger unit of measurement'
        )
    x_post = np.asarray(add(x, G.dot(psi)), dtype=float)
    inverse = T.T.dot(T) if SI is None else SI
    if part.size == m:
        return Correction(x_post, P_post, y, S, SI, G.dot(T), T, e, psi, psi_deriv)
    wide_T, wide_SI, K = np.zeros((m, m)), np.zeros((m, m)), np.zeros((x.size, m))
    wide_T[pick], wide_SI[pick], K[:, part] = T, inverse, G.dot(T)
    wide = (scatter(v, part, m) for v in (y[part], e, psi))
    y, e, psi = wide
    return Correction(x_post, P_post, y, S, wide_SI, K, wide_T, e, psi, scatter(np.array(psi_deriv), part, m, np.nan))


def _visible(P: Array, C: Array, S: Array) -> np.ndarray:
    """Return which components the state has a part in, shape (m,)."""
    scale = np.sqrt(np.outer(P.diagonal(), S.diagonal()))
    return np.asarray((np.abs(C) > _NO_PART * scale).any(axis=0))
