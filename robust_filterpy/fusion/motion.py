"""How the state moves during any length of time: F(dt), Q(dt) and B(dt), or a function of the state.

Between two stamps that are dt apart x goes to F(dt) x + B(dt) u and P to F P F' + Q(dt). For a continuous model
x' = A x + B u + L w, with w white of spectral density Qc,

    F = exp(A dt),   Q = integral over 0..dt of exp(A s) L Qc L' exp(A' s) ds,   B(dt) = integral of exp(A s) B ds

(van Loan 1978). u is what `Fusion.control` was given last, held until it is given another.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from robust_filterpy import _checks
from robust_filterpy._checks import Array

__all__ = ["Motion", "constant_acceleration", "constant_velocity", "from_continuous", "from_function"]


class Moved(NamedTuple):
    """A stretch of time: x goes to F x + drift."""

    #: (n, n)
    F: Array
    #: (n, n)
    Q: Array
    #: (n,)
    drift: Array


class Motion:
    """Hold a motion model; made by one of the functions of this module.

    Parameters
    ----------
    dim_x : int
        Length of the state.
    stacks : callable
        ``stacks(dts)`` returns F (N, n, n), Q (N, n, n) and B (N, n, dim_u) for N stretches of time in seconds.
    dim_u : int, default 0
        Length of the control input.
    function : callable, optional
        ``function(x, dt)``, or ``function(x, dt, u)`` if dim_u > 0: where x goes; F is then its Jacobian at x.
    jacobian : callable, optional
        ``jacobian(x, dt)`` or ``jacobian(x, dt, u)``, shape (n, n).
    names : sequence of str, optional
        Of the state's components.
    """

    def __init__(
        self, dim_x: int, stacks: Callable[[Array], tuple[Array, Array, Array]], dim_u: int = 0,
        function: Callable[..., Any] | None = None, jacobian: Callable[..., Any] | None = None,
        names: tuple[str, ...] | None = None,
    ) -> None:  # fmt: skip
        """Keep what it is given."""
        self.dim_x, self.dim_u = _checks.count("dim_x", dim_x, 1), _checks.count("dim_u", dim_u)
        self.names = tuple(f"x{i}" for i in range(dim_x)) if names is None else tuple(names)
        #: F (n, n), Q (n, n) and B (n, dim_u) of one stretch, which comes again and again.
        self.matrices = lru_cache(maxsize=512)(partial(_one, stacks))
        self.stacks, self.function, self.jacobian = stacks, function, jacobian

    def __getstate__(self) -> dict[str, Any]:
        """Leave the matrices of the stretches behind."""
        return {**vars(self), "matrices": self.matrices.__wrapped__}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Begin to remember them again."""
        vars(self).update(state, matrices=lru_cache(maxsize=512)(state["matrices"]))

    @property
    def is_linear(self) -> bool:
        """Whether F does not depend on the state."""
        return self.function is None

    def __repr__(self) -> str:
        """Show the states."""
        return f"Motion({self.dim_x} states: {', '.join(self.names)})"

    def over(self, dt: float, x: Array, u: Array) -> Moved:
        """Return what happens to a state during a stretch of time.

        Parameters
        ----------
        dt : float
            Seconds, >= 0.
        x : ndarray, shape (n,)
            State at its beginning.
        u : ndarray, shape (dim_u,)
            Control input during it.

        Returns
        -------
        Moved

        Raises
        ------
        ValueError
            If a function returns something of another shape or that is not finite.
        """
        F, Q, B = self.matrices(dt)
        if self.function is None or self.jacobian is None:
            return Moved(F, Q, B @ u)
        given = (x.copy(), dt, u.copy()) if self.dim_u else (x.copy(), dt)
        n = self.dim_x
        to = _checks.finite("f(x, dt)", self.function(*given), (n,))
        F = _checks.finite("jacobian(x, dt)", self.jacobian(*given), (n, n))
        return Moved(F, Q, to - F @ x)

    def over_each(self, dts: Array, xs: Array, us: Array) -> Moved:
        """Return what happens during stretches of time, as `over`, a row for each.

        Parameters
        ----------
        dts : ndarray, shape (K,)
            Seconds, >= 0.
        xs : ndarray, shape (K, n)
            States at the beginning of each; what they are plays no part in a linear motion.
        us : ndarray, shape (K, dim_u)
            Control inputs during each.

        Returns
        -------
        Moved
            F and Q of shape (K, n, n), drift (K, n).
        """
        if self.is_linear:
            F, Q, B = self.stacks(dts)
            return Moved(F, Q, np.asarray((B @ us[:, :, None])[:, :, 0]))
        return Moved(*map(np.array, zip(*map(self.over, dts.tolist(), xs, us), strict=True)))


def constant_velocity(dim: int = 1, q: ArrayLike = 1.0) -> Motion:
    """Return the motion of a point whose velocity is driven by white noise.

    Parameters
    ----------
    dim : int, default 1
        Number of axes; the state is position and velocity of the first axis, then of the second, ..
    q : float or array_like, shape (dim,)
        Spectral density of the acceleration, unit^2/s^3: after a second the velocity's variance has grown by q.

    Returns
    -------
    Motion
        Its control input, if one is given, is the acceleration, shape (dim,).

    Raises
    ------
    ValueError, TypeError
        If dim < 1 or q is not > 0.

    Examples
    --------
    >>> F, Q, B = constant_velocity(1, q=3.0).matrices(2.0)
    >>> F.tolist(), Q.tolist(), B.tolist()
    ([[1.0, 2.0], [0.0, 1.0]], [[8.0, 6.0], [6.0, 6.0]], [[2.0], [2.0]])
    """
    return _integrators(dim, q, ("p", "v"), controlled=True)


def constant_acceleration(dim: int = 1, q: ArrayLike = 1.0) -> Motion:
    """Return the motion of a point whose acceleration is driven by white noise.

    Parameters
    ----------
    dim : int, default 1
        Number of axes; the state is position, velocity and acceleration of the first axis, then of the second, ..
    q : float or array_like, shape (dim,)
        Spectral density of the jerk, unit^2/s^5.

    Returns
    -------
    Motion

    Raises
    ------
    ValueError, TypeError
        If dim < 1 or q is not > 0.
    """
    return _integrators(dim, q, ("p", "v", "a"), controlled=False)


def from_continuous(A: Any, L: ArrayLike | None = None, Qc: ArrayLike = 1.0, B: Any = None) -> Motion:
    """Return the motion x' = A x + B u + L w of a continuous model, w white of spectral density Qc (van Loan).

    Parameters
    ----------
    A : array_like, shape (n, n)
        Also a ``control.StateSpace`` in continuous time, whose A and B are taken.
    L : array_like, shape (n, k), optional
        Where the noise enters; by default at every state.
    Qc : array_like, shape (k, k), or float
        Spectral density of the noise; a float means times I.
    B : array_like, shape (n, dim_u), optional
        Where the control input enters.

    Returns
    -------
    Motion

    Raises
    ------
    ValueError, TypeError
        If a shape does not fit, a number is not finite, Qc is no covariance, or the model is in discrete time.

    Examples
    --------
    >>> motion = from_continuous([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], 3.0)
    >>> motion.matrices(2.0)[1].round(12).tolist()
    [[8.0, 6.0], [6.0, 6.0]]
    """
    if hasattr(A, "A") and hasattr(A, "B") and hasattr(A, "dt"):
        if A.dt not in (0, None):
            raise ValueError(f"A: expected a model in continuous time, got one with dt={A.dt}")
        A, B = A.A, A.B if B is None else B
    A = _checks.numbers("A", A)
    if A.ndim != 2 or A.shape[0] != A.shape[1] or not len(A):
        raise ValueError(f"A: expected a square matrix, got {_checks.described(A)}")
    n = len(A)
    L = np.eye(n) if L is None else _columns("L", L, n)
    k = L.shape[1]
    Qc = _checks.numbers("Qc", Qc)
    Qc = _checks.matrix("Qc", Qc * np.eye(k) if Qc.ndim == 0 else Qc, (k, k), f"L with {k} columns")
    _checks.covariance("Qc", Qc)
    B = np.zeros((n, 0)) if B is None else _columns("B", B, n)
    for name, value in (("A", A), ("L", L), ("B", B)):
        if not np.isfinite(value).all():
            raise ValueError(f"{name}: expected finite numbers, got NaN or infinity")
    dim_u = B.shape[1]
    A, driven = (np.pad(part, (0, dim_u)) for part in (A, L @ Qc @ L.T))
    A[:n, n:] = B
    return Motion(n, partial(_each, partial(_van_loan, A, driven, n)), dim_u)


def from_function(f: Callable[..., Any], jacobian: Callable[..., Any], Q: Any, dim_x: int, dim_u: int = 0) -> Motion:
    """Return the motion x -> f(x, dt) of a nonlinear model; the state's covariance goes by its Jacobian.

    Parameters
    ----------
    f : callable
        ``f(x, dt)``, or ``f(x, dt, u)`` if dim_u > 0, for x of shape (dim_x,); f(x, 0) is x.
    jacobian : callable
        Of the same arguments: df/dx, shape (dim_x, dim_x).
    Q : callable or array_like, shape (dim_x, dim_x)
        ``Q(dt)``, the covariance that a stretch of time adds, or a matrix that is multiplied by dt.
    dim_x : int
        Length of the state.
    dim_u : int, default 0
        Length of the control input.

    Returns
    -------
    Motion

    Raises
    ------
    ValueError, TypeError
        If f or jacobian cannot be called or Q is no covariance.
    """
    n = _checks.count("dim_x", dim_x, 1)
    for name, value in (("f", f), ("jacobian", jacobian)):
        if not callable(value):
            raise TypeError(f"{name}: expected a function, got {_checks.shown(value)}")
    if not callable(Q):
        Q = _checks.matrix("Q", Q, (n, n), f"dim_x={n}").copy()
        _checks.covariance("Q", Q)
    return Motion(n, partial(_each, partial(_grown, Q, n, dim_u)), dim_u, f, jacobian)


def _integrators(dim: int, q: ArrayLike, names: tuple[str, ...], controlled: bool) -> Motion:
    """Return chains of integrators, one for each axis, whose last member is driven by white noise, in closed form."""
    dim = _checks.count("dim", dim, 1)
    density = _checks.numbers("q", q)
    if density.ndim > 1 or (density.ndim == 1 and len(density) != dim):
        raise ValueError(f"q: expected a number or {dim} of them, got {_checks.described(density)}")
    if not ((density > 0.0) & np.isfinite(density)).all():
        raise ValueError(f"q: expected a finite number > 0, got {_checks.shown(q)}")
    k = len(names)
    # Of one axis x' = A x + L w, u entering where w does; A to the power of k is 0, so that all series end.
    axes, A, L = np.eye(dim), np.eye(k, k=1), np.eye(k)[:, -1:]
    powers: list[Any] = [np.kron(axes, np.linalg.matrix_power(A, i) / math.factorial(i)) for i in range(k)]
    B: Any = np.kron(axes, L)[:, : dim * controlled]
    driven = np.kron(np.diag(np.broadcast_to(density, dim)), L @ L.T)
    spelt = tuple(f"{axis}.{name}" for axis in ("xyz"[:dim] if dim <= 3 else range(dim)) for name in names)
    return Motion(dim * k, partial(_series, powers, driven, B), B.shape[1], names=spelt)


def _series(powers: list[Array], driven: Array, B: Array, dts: Array) -> tuple[Array, Array, Array]:
    """Return F, Q and B of each stretch, by the powers of A over their factorials."""
    dt, ks = dts[:, None, None], list(enumerate(powers))
    F, moved = np.zeros((2, len(dts), *driven.shape))
    Q = np.zeros_like(F)
    for i, a in ks:
        F, moved = F + a * dt**i, moved + a * dt ** (i + 1) / (i + 1)
        for j, b in ks:
            Q = Q + (a @ driven @ b.T) * dt ** (i + j + 1) / (i + j + 1)
    return F, Q, moved @ B


def _one(stacks: Callable[[Array], tuple[Array, Array, Array]], dt: float) -> tuple[Array, Array, Array]:
    """Return F, Q and B of one stretch."""
    F, Q, B = stacks(np.array([dt]))
    return F[0], Q[0], B[0]


def _each(matrices: Callable[[float], tuple[Array, Array, Array]], dts: Array) -> tuple[Array, Array, Array]:
    """Return F, Q and B of each stretch, those of one length once."""
    lengths, which = np.unique(dts, return_inverse=True)
    F, Q, B = (np.array(part)[which] for part in zip(*map(matrices, lengths.tolist()), strict=True))
    return F, Q, B


def _grown(Q: Any, n: int, dim_u: int, dt: float) -> tuple[Array, Array, Array]:
    """Return no F, Q of a stretch of time, and no B."""
    grown = _checks.matrix("Q(dt)", Q(dt), (n, n), f"dim_x={n}") if callable(Q) else Q * dt
    _checks.covariance("Q(dt)", grown, math.inf)
    return np.eye(n), grown, np.zeros((n, dim_u))


def _van_loan(A: Array, driven: Array, n: int, dt: float) -> tuple[Array, Array, Array]:
    """Return F, Q and B(dt), inputs being states that stay: by the exponential for a short stretch, then doubled."""
    # As many as it takes for |A| h < 1: exp(-A dt) of a stable A overflows.
    doublings, k = max(0, math.frexp(np.abs(A[:n, :n]).sum(axis=1).max() * dt)[1]), len(A)
    exponential = expm(np.block([[-A, driven], [np.zeros_like(A), A.T]]) * (dt / 2.0**doublings))
    F = exponential[k:, k:].T
    Q = F @ exponential[:k, k:]
    for _ in range(doublings):
        Q, F = Q + F @ Q @ F.T, F @ F
    return F[:n, :n], 0.5 * (Q + Q.T)[:n, :n], F[:n, n:]


def _columns(name: str, value: ArrayLike, n: int) -> Array:
    """Return a matrix of n rows, or raise."""
    matrix = _checks.numbers(name, value)
    if matrix.ndim == 1 and len(matrix) == n:
        matrix = matrix[:, None]
    if matrix.ndim != 2 or len(matrix) != n:
        raise ValueError(f"{name}: expected {n} rows, as A has, got {_checks.described(matrix)}")
    return matrix
