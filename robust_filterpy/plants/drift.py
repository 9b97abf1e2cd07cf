"""Parameters that drift: the random walk of eqs (8)-(10), and the test that keeps it among stable plants."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, count, finite_vector, matrix, numbers, positive
from robust_filterpy._checks import covariance as require_covariance
from robust_filterpy.identification.models.regressor import is_stable

#: Mean of theta in section 4 of the paper: na = nb = 4, nk = 1, poles .867 +- .139j and -.411 +- .363j.
THETA_BAR: Array = np.array([-0.9131, -0.3523, 0.1118, 0.2318, -0.0413, 0.0766, 0.0115, 0.0647])
THETA_BAR.setflags(write=False)


def random_walk(
    theta0: ArrayLike, Q: ArrayLike, n: int, rng: np.random.Generator | int | None = None,
    accept: Callable[[Array], bool] | None = None, C: ArrayLike | None = None,
) -> Array:  # fmt: skip
    """Let parameters drift: ``theta(k+1) = C theta(k) + w(k)``, w ~ N(0, Q), eqs (8)-(10).

    Parameters
    ----------
    theta0 : array_like, shape (p,)
        First row of the path.
    Q : array_like, shape (p, p), or float
        Covariance of a step, symmetric positive semidefinite; a number q stands for ``q * I``. 0 leaves eq (10).
    n : int
        Rows of the path, >= 1.
    rng : numpy.random.Generator or int, optional
        Draws the steps; all of them are drawn first, whether accepted or not.
    accept : callable, optional
        ``accept(theta) -> bool``. A step to a theta that it refuses is not made: theta stays for that sample.
        See `stable`.
    C : array_like, shape (p, p), optional
        Transition matrix of eq (9). Default: the identity, eq (8).

    Returns
    -------
    ndarray, shape (n, p)
        The path, theta0 in row 0.

    Raises
    ------
    ValueError
        If shapes do not fit together, a number is not finite, Q is no covariance, accept refuses theta0, or the
        path overflows.
    TypeError
        If an argument is of the wrong kind.

    Notes
    -----
    The paper's W for its 8 parameters is lost in the text. Unguarded walks of 1000 samples from its theta-bar leave
    the region of stable plants, at least for a moment, in 21 % of 2000 runs with Q = 1e-6 I, in 74 % with 1e-5 I, in
    98 % with 1e-4 I; hence ``accept``.

    Examples
    --------
    >>> path = random_walk(THETA_BAR, 1e-6, 1000, rng=1, accept=stable(4))
    >>> path.shape
    (1000, 8)
    """
    theta0 = finite_vector("theta0", theta0)
    p, n = theta0.size, count("n", n, 1)
    covariance = numbers("Q", Q)
    covariance = matrix("Q", covariance * np.eye(p) if covariance.ndim == 0 else covariance, (p, p), f"{p} parameters")
    require_covariance("Q", covariance)
    transition = None if C is None else matrix("C", C, (p, p), f"{p} parameters")
    if transition is not None and not np.isfinite(transition).all():
        raise ValueError("C: expected finite numbers, got NaN or infinity among them")
    if accept is not None and not callable(accept):
        raise TypeError(f"accept: expected a function of theta or None, got {accept!r}; stable(na) makes one")
    if accept is not None and not accept(theta0.copy()):
        raise ValueError(f"theta0: expected a start that accept takes, got {theta0}")
    # eigh serves the singular Q of parameters that stand still.
    w = np.random.default_rng(rng).multivariate_normal(np.zeros(p), covariance, size=n - 1, method="eigh")
    if transition is None and accept is None:
        return np.vstack((theta0, theta0 + np.cumsum(w, axis=0)))
    path = np.empty((n, p))
    path[0] = theta0
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(n - 1):
            step = (path[k] if transition is None else transition @ path[k]) + w[k]
            if transition is not None and not np.isfinite(step).all():
                raise ValueError(f"C: the path overflows at row {k + 1}; C has an eigenvalue outside the unit circle")
            path[k + 1] = step if accept is None or accept(step.copy()) else path[k]
    return path


def stable(na: int, radius: float = 1.0) -> Callable[[ArrayLike], bool]:
    """Make a test of stability, to be given to `random_walk` as ``accept``.

    Parameters
    ----------
    na : int
        Number of a's at the head of theta, >= 0.
    radius : float, default 1
        Poles must lie strictly inside the circle of this radius; below 1 it leaves a margin.

    Returns
    -------
    callable
        ``accept(theta) -> bool``: whether all roots of z^na + a_1 z^(na-1) + .. + a_na are inside. It can be pickled.

    Raises
    ------
    ValueError
        If na is negative or radius is not a finite number > 0.
    TypeError
        If an argument is of the wrong kind.

    Notes
    -----
    The poles are those of theta held still. A plant whose theta moves is safe when it moves slowly.

    Examples
    --------
    >>> stable(2)([-1.5, 0.7, 1.0, 0.5]), stable(2)([-2.5, 1.0, 1.0, 0.5])
    (True, False)
    """
    return partial(_has_poles_inside, count("na", na), positive("radius", radius))


def _has_poles_inside(na: int, radius: float, theta: ArrayLike) -> bool:
    """Tell whether the first na entries of theta are the coefficients of a stable polynomial."""
    theta = finite_vector("theta", theta)
    if theta.size < na:
        raise ValueError(f"theta: expected at least na={na} entries, got {theta.size}")
    # The powers take the circle to that of radius 1.
    return is_stable((theta[:na] / radius ** np.arange(1, na + 1)).tolist())
