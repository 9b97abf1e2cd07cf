"""The robust correction: definition. The fast forms elsewhere are tested against it.

For an innovation y = z - H x with covariance S = H P H' + R and cross-covariance C = P H'::

    e  = T y                       standardized innovation            (paper 29, 36)
    x+ = x + C T' psi(e)           bounded influence                  (26, 37, 42, 47)
    P+ = P - C T' D T C'           information D between 0 and I      (28, 39, 44, 49)

T, D and psi are `Choices`.
"""

from __future__ import annotations

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction.covariance import _require_positive, innovation_moments, posterior_covariance
from robust_filterpy.correction.missing import _embed, nothing_observed
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.result import Correction, Observed
from robust_filterpy.correction.whitening import SAFE, Inverse, standardize, standardized

_DEFAULT = Choices()


def correct(
    x: Array,
    P: Array,
    y: Array,
    H: Array,
    R: Array,
    choices: Choices = _DEFAULT,
    M: Array | None = None,
    inv: Inverse | None = None,
) -> Correction:
    """Correct a state by an innovation whose influence is bounded.

    x+ = x + C T' psi(T y) and P+ = P - C T' D T C' (paper 26-28, 37-39, 42-44, 47-49).

    Parameters
    ----------
    x : ndarray, shape (n,)
        Prior mean.
    P : ndarray, shape (n, n)
        Prior covariance.
    y : ndarray, shape (m,)
        Innovation z - H x; NaN marks a missing component.
    H : ndarray, shape (m, n)
        Measurement matrix.
    R : ndarray, shape (m, m)
        Measurement noise covariance, positive definite.
    choices : Choices
        Influence function, scaling, information, grouping.
    M : ndarray, shape (n, m), optional
        Covariance of the state's error and the measurement noise; then C = P H' + M and
        S = H P H' + H M + M' H' + R.
    inv : callable, optional
        What inverts S, such as `numpy.linalg.pinv`; T'T is then inv(S). By default a singular S is an
        error.

    Returns
    -------
    Correction

    Raises
    ------
    NotPositiveDefiniteError
        If scaling is "unit" and P+ would be indefinite.
    SingularInnovationError
        If S is singular and inv is not given.

    Examples
    --------
    >>> c = correct(np.zeros(1), np.eye(1), np.array([100.0]), np.eye(1), np.eye(1))
    >>> c.x.round(3), c.P, c.clipped
    (array([0.951]), array([[1.]]), array([ True]))
    """
    if sum(map(abs, y.tolist())) < SAFE:
        return correct_observed(x, P, y, H, R, choices, M, inv).as_arrays()
    part = np.flatnonzero(y == y)
    if part.size == y.size:
        return correct_observed(x, P, y, H, R, choices, M, inv, small=False).as_arrays()
    _, S = innovation_moments(P, H, R, M)
    if part.size == 0:
        return nothing_observed(x, P, S, y.size)
    M = None if M is None else M[:, part]
    some = correct_observed(x, P, y[part], H[part], R[np.ix_(part, part)], choices, M, inv, small=False)
    return _embed(some.as_arrays(), part, S)


def correct_observed(
    x: Array,
    P: Array,
    y: Array,
    H: Array,
    R: Array,
    choices: Choices,
    M: Array | None = None,
    inv: Inverse | None = None,
    small: bool = True,
) -> Observed:
    """Correct by a complete measurement. small: every |y_i| < SAFE, so that T y cannot overflow."""
    C, S = innovation_moments(P, H, R, M)
    T, SI, whitening_defect = standardize(S, choices.scaling, inv)
    e = T.dot(y) if small else standardized(T, y)
    psi, D, psi_deriv = choices.apply_influence(e, None if choices.grouping == "component" else H.any(axis=1))
    G = C.dot(T.T)
    x_post = x + G.dot(psi)
    P_post = posterior_covariance(P, H, R, G, T, D, whitening_defect, M)
    if choices.scaling == "unit":
        _require_positive(P_post, D, S - R)
    return Observed(x_post, P_post, C, y, S, SI, T, e, psi, psi_deriv)
