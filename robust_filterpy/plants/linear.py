"""Linear plants to identify: what stands for one, ARX and output-error data from it, parameters that drift (8)-(10).

A parameter vector is ``theta = [a_1 .. a_na, b_1 .. b_nb]``, eq (12), and stands for

    y_n(k) = -a_1 y_n(k-1) - .. - a_na y_n(k-na) + b_1 u(k-nk) + .. + b_nb u(k-nk-nb+1)            (11)

where theta may change from sample to sample: row k of a path is the theta(k) that makes y(k).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import scipy.signal
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, count, finite, finite_vector, matrix, numbers, positive
from robust_filterpy._checks import covariance as require_covariance
from robust_filterpy.identification.models.regressor import LinearParameters, is_stable, linear_parameters

if TYPE_CHECKING:
    import control

#: A discrete transfer function, or theta of shape (na + nb,), or a path of it of shape (N, na + nb).
System: TypeAlias = "control.TransferFunction | ArrayLike"


def orders_of(system: Any, na: int | None, nb: int | None, nk: int | None) -> LinearParameters:
    """Return theta, constant or a path, and the orders that belong to it."""
    if hasattr(system, "ninputs"):
        if not (na is nb is nk is None):
            raise ValueError("na, nb, nk: expected none with a transfer function (it tells them); give them with theta")
        return linear_parameters(system)
    theta = numbers("system", system)
    if na is None or nb is None:
        raise ValueError("na, nb: expected both with theta, which does not tell where the a's end")
    na, nb, nk = count("na", na), count("nb", nb), count("nk", 1 if nk is None else nk)
    if na + nb == 0:
        raise ValueError("na, nb: expected at least one parameter, got na = nb = 0")
    if theta.ndim not in (1, 2) or theta.shape[-1] != na + nb:
        raise ValueError(
            f"theta: expected shape ({na + nb},) or (N, {na + nb}) for na={na}, nb={nb}, got {theta.shape}"
        )
    if not np.isfinite(theta).all():
        raise ValueError("theta: expected finite numbers, got NaN or infinity among them")
    return LinearParameters(theta, na, nb, nk)


class Simulation(NamedTuple):
    """Data of a simulated plant, and the truth behind them; N samples of each.

    Attributes
    ----------
    u : ndarray, shape (N,)
        Input.
    y : ndarray, shape (N,)
        Measured output.
    y_clean : ndarray, shape (N,)
        Output without noise, y_n of eq (11).
    theta : ndarray, shape (N, na + nb)
        Parameters; row k made sample k.
    """

    u: Array
    y: Array
    y_clean: Array
    theta: Array


def simulate_arx(
    system: System, u: ArrayLike, *, noise: Any = None, rng: np.random.Generator | int | None = None,
    na: int | None = None, nb: int | None = None, nk: int | None = None,
) -> Simulation:  # fmt: skip
    """Simulate a plant with the noise inside its loop: ``A(q) y = B(q) u + noise``.

    ``y(k) = theta(k)' [-y(k-1) .. -y(k-na), u(k-nk) .. u(k-nk-nb+1)] + noise(k)``: an outlier goes round the loop
    with the output and decays with the plant's own dynamics.

    Parameters
    ----------
    system : control.TransferFunction or array_like, shape (na + nb,) or (N, na + nb)
        Discrete transfer function with one input and one output, or theta (constant, or one row per sample).
    u : array_like, shape (N,)
        Input.
    noise : scipy.stats distribution or array_like of shape (N,), optional
        A distribution (anything with ``rvs(size=, random_state=)``) to draw from, or the noise itself, in the unit
        of y. Default: none.
    rng : numpy.random.Generator or int, optional
        Draws the noise.
    na, nb : int, optional
        Number of a's and b's in theta; with a transfer function they are read from it and must not be given.
    nk : int, optional
        Delay of b_1 in samples, 0 for direct feed-through. Default: 1 with theta, read from a transfer function.

    Returns
    -------
    Simulation
        u, y, y_clean (the same recursion without noise), theta.

    Raises
    ------
    ValueError
        If shapes or orders do not fit together, a number is not finite, or the output overflows.
    TypeError
        If an argument is of the wrong kind.

    Notes
    -----
    The plant is at rest before sample 0: u and y are zero there. theta(k) makes y(k), eqs (11) and (14).

    Examples
    --------
    >>> simulate_arx([-0.5, 1.0], [1, 0, 0, 0], na=1, nb=1).y
    array([0.  , 1.  , 0.5 , 0.25])
    """
    return _simulated(True, system, u, noise, rng, na, nb, nk)


def simulate_output_error(
    system: System, u: ArrayLike, *, noise: Any = None, rng: np.random.Generator | int | None = None,
    na: int | None = None, nb: int | None = None, nk: int | None = None,
) -> Simulation:  # fmt: skip
    """Simulate a plant with the noise on its output: ``y = B(q)/A(q) u + noise``, eqs (11)-(14).

    Parameters
    ----------
    system, u, noise, rng, na, nb, nk
        As in `simulate_arx`.

    Returns
    -------
    Simulation
        u, y, y_clean (y_n of eq (11)), theta.

    Raises
    ------
    ValueError, TypeError
        As in `simulate_arx`.

    Notes
    -----
    The plant is at rest before sample 0: u and y_n are zero there. theta(k) makes y_n(k), eqs (11) and (14).

    Examples
    --------
    >>> from scipy.stats import norm
    >>> data = simulate_output_error([-0.5, 1.0], [1, 0, 0, 0], na=1, nb=1, noise=norm(scale=0.1), rng=1)
    >>> data.y_clean
    array([0.  , 1.  , 0.5 , 0.25])
    >>> (data.y - data.y_clean).round(3)
    array([ 0.035,  0.082,  0.033, -0.13 ])
    """
    return _simulated(False, system, u, noise, rng, na, nb, nk)


def _simulated(inside: bool, system: System, u: ArrayLike, noise: Any, rng: Any, *orders: int | None) -> Simulation:
    """Simulate a plant from rest, the noise inside its loop or on its output; orders: na, nb, nk."""
    signal = finite_vector("u", u).copy()
    theta, na, nb, nk = orders_of(system, *orders)
    if theta.ndim > 1 and len(theta) != signal.size:
        raise ValueError(f"theta: expected a row for each of the {signal.size} samples of u, got {len(theta)} rows")
    path = np.tile(theta, (signal.size, 1)) if theta.ndim == 1 else theta.copy()
    # b_1(k) u(k-nk) + .. + b_nb(k) u(k-nk-nb+1)
    padded, forcing = np.concatenate((np.zeros(nk + nb), signal)), np.zeros(signal.size)
    for j in range(nb):
        forcing += path[:, na + j] * padded[nb - j : nb - j + signal.size]
    v, a = _noise(noise, signal.size, rng), theta[..., :na]
    clean = _output(a, forcing)
    return Simulation(signal, _output(a, forcing + v) if inside else clean + v, clean, path)


def _output(a: Array, forcing: Array) -> Array:
    """Run y(k) = forcing(k) - a_1 y(k-1) - .. - a_na y(k-na) from rest; a may have a row for each sample."""
    with np.errstate(over="ignore", invalid="ignore"):
        if a.ndim == 1:
            y = scipy.signal.lfilter([1.0], np.concatenate(([1.0], a)), forcing)
        else:
            # Oldest first, as the samples stand in the buffer.
            na, a = a.shape[1], np.ascontiguousarray(a[:, ::-1])
            padded = np.zeros(na + forcing.size)
            for k, drive in enumerate(forcing):
                padded[na + k] = drive - a[k].dot(padded[k : k + na])
            y = padded[na:]
    if not np.isfinite(y).all():
        raise ValueError(
            f"theta: the output overflows at sample {int(np.argmin(np.isfinite(y)))}, the plant is unstable; "
            "random_walk(..., accept=stable(na)) keeps a path stable"
        )
    return y


def _noise(noise: Any, n: int, rng: np.random.Generator | int | None) -> Array:
    """Return n samples of noise, drawn or given."""
    if noise is None:
        return np.zeros(n)
    if isinstance(noise, type):
        raise TypeError(
            f"noise: expected a distribution, got the class {noise.__name__}; make one: {noise.__name__}(..)"
        )
    if hasattr(noise, "rvs"):
        noise = noise.rvs(size=n, random_state=np.random.default_rng(rng))
    v = finite_vector("noise", noise)
    if v.size != n:
        raise ValueError(f"noise: expected {n} samples, one for each of u, got {v.size}")
    return v


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
    transition = None if C is None else finite("C", C, (p, p))
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
