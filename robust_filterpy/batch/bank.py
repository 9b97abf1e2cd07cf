"""Many filters advanced together online: a fleet of like actuators, tracks, or sensors."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks, _state
from robust_filterpy._brief import wrapped
from robust_filterpy._checks import Array, numbers
from robust_filterpy.correction import spread
from robust_filterpy.correction.definition import Innovation, correct, correct_by_custom, innovation_moments
from robust_filterpy.correction.options import Choices, Grouping, Information, Scaling
from robust_filterpy.correction.result import Correction
from robust_filterpy.influence.functions import Huber, Influence
from robust_filterpy.kernel.records import Model, Output
from robust_filterpy.kernel.series import filter_series, serves

__all__ = ["FilterBank"]


class FilterBank:
    """Advance n robust filters together; equal to a loop over n `RobustKalmanFilter`.

    Parameters
    ----------
    n : int
        Number of filters, >= 1.
    dim_x, dim_z : int
        Length of the state and of the measurement of each.
    influence, scaling, information, grouping
        As in `RobustKalmanFilter`.

    Attributes
    ----------
    x : ndarray, shape (n, dim_x)
        States.
    P : ndarray, shape (n, dim_x, dim_x)
        Covariances.
    F, Q : ndarray, shape (dim_x, dim_x) or (n, dim_x, dim_x)
        Transition matrix and process noise covariance, shared or each filter's own.
    H : ndarray, shape (dim_z, dim_x) or (n, dim_z, dim_x)
        Measurement matrix.
    R : ndarray, shape (dim_z, dim_z) or (n, dim_z, dim_z)
        Measurement noise covariance.
    y, e, weights : ndarray, shape (n, dim_z)
        Innovation, standardized innovation (0 where missing) and psi(e)/e (NaN where missing) of the last update.
    S : ndarray, shape (n, dim_z, dim_z)
        Innovation covariance.
    log_likelihood : ndarray, shape (n,)
        Of the last update; 0 where all of it was missing.
    spread : ndarray, shape (n, dim_z)
        As `RobustKalmanFilter.spread`, for each filter.

    Raises
    ------
    ValueError, TypeError
        If a dimension or an option is out of range; a refused call changes nothing.

    Examples
    --------
    >>> bank = FilterBank(10, dim_x=2, dim_z=1)
    >>> bank.F, bank.H, bank.Q = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), 0.01 * np.eye(2)
    >>> rng = np.random.default_rng(0)
    >>> for _ in range(30):
    ...     bank.predict()
    ...     bank.update(rng.normal(size=(10, 1)))
    >>> bank.predict()
    >>> bank.update(np.full((10, 1), 1e6))
    >>> bool(np.abs(bank.x).max() < 10.0), bool((bank.weights < 1e-3).all())
    (True, True)
    """

    def __init__(
        self,
        n: int,
        dim_x: int,
        dim_z: int,
        *,
        influence: Influence = Huber(),
        scaling: Scaling = "learnt",
        information: Information = "realized",
        grouping: Grouping = "component",
    ) -> None:
        """Set up n filters with filterpy's initial values."""
        self.n = _checks.count("n", n, 1)
        self.dim_x, self.dim_z = _checks.count("dim_x", dim_x, 1), _checks.count("dim_z", dim_z, 1)
        self._choices = Choices(influence, scaling, information, grouping)
        self.x = np.zeros((n, dim_x))
        self.P = np.tile(np.eye(dim_x), (n, 1, 1))
        self.F, self.Q = np.eye(dim_x), np.eye(dim_x)
        self.H, self.R = np.zeros((dim_z, dim_x)), np.eye(dim_z)
        self.weights, self.log_likelihood = np.full((n, dim_z), np.nan), np.zeros(n)
        self._told: _Told | None = None
        self._shown: dict[str, Array] = {}
        self._memory = np.tile(spread.begin(dim_z), (n, 1, 1))

    def __repr__(self) -> str:
        """Show the size and the choices."""
        return f"FilterBank(n={self.n}, dim_x={self.dim_x}, dim_z={self.dim_z}, {self._choices})"

    def __str__(self) -> str:
        """Return the same on lines that a screen holds."""
        return wrapped(repr(self))

    @np.errstate(all="ignore")
    def predict(self, u: ArrayLike | None = None, B: ArrayLike | None = None) -> None:
        """Predict every state: x = F x + B u, P = F P F' + Q.

        Parameters
        ----------
        u : array_like, shape (n, dim_u) or (dim_u,), optional
            Control inputs.
        B : array_like, shape (dim_x, dim_u) or (n, dim_x, dim_u), optional
            Control matrix; needed with u.

        Raises
        ------
        ValueError
            If a shape does not fit or the prediction is not finite.
        """
        d = self.dim_x
        x, P = self._state()
        F, Q = self._matrix("F", (d, d)), self._matrix("Q", (d, d))
        Bu = None if u is None else self._control(B, u)
        if len(F) == 1:
            # One product for all: P F' as rows, and then the other side through the transpose.
            moved = x @ F[0].T
            half = (P.reshape(-1, d) @ F[0].T).reshape(P.shape)
            covariance = (half.transpose(0, 2, 1).reshape(-1, d) @ F[0].T).reshape(P.shape)
        else:
            moved = (F @ x[:, :, None])[:, :, 0]
            covariance = F @ P @ F.transpose(0, 2, 1)
        covariance += Q
        covariance += covariance.transpose(0, 2, 1).copy()
        covariance *= 0.5
        if Bu is not None:
            moved = moved + Bu
        if not math.isfinite(moved.sum() + covariance.sum()):
            raise ValueError("predict: expected finite x and P, got NaN or infinity; check x, P, F, Q, B and u")
        self.x, self.P = moved, covariance

    @np.errstate(all="ignore")
    def update(self, z: ArrayLike | None) -> None:
        """Correct every state by its measurement (paper 37, 39, 42, 44, 47, 49).

        Parameters
        ----------
        z : array_like, shape (n, dim_z), or None
            Measurements; NaN marks a missing component, a row of NaN a filter that has none, None that all have none.

        Raises
        ------
        ValueError
            If a shape does not fit, z is infinite or an R no covariance.
        SingularInnovationError, NotPositiveDefiniteError
            As in `RobustKalmanFilter.update`; no filter has changed then.
        """
        m, d, choices = self.dim_z, self.dim_x, self._choices
        x, P = self._state()
        z = np.full((self.n, m), np.nan) if z is None else numbers("z", z)
        if z.shape != (self.n, m):
            mend = "; use z[:, None]" if z.shape == (self.n,) and m == 1 else ""
            raise ValueError(f"z: expected shape {(self.n, m)}, got {z.shape}{mend}")
        if np.isinf(z).any():
            raise ValueError("z: expected finite numbers or NaN (missing), got infinity")
        H, R = self._matrix("H", (m, d)), self._matrix("R", (m, m))
        # By content, since users write into R.
        if m == 1 or self._checked is None or not np.array_equal(R, self._checked):
            _require_covariances(R)
            self._checked = R.copy() if m > 1 else None
        told = _Told(x, P, z, H, R, self._memory)
        x, P, memory = x.copy(), P.copy(), self._memory.copy()
        weights, log_likelihood = np.full((self.n, m), np.nan), np.zeros(self.n)
        left: Any = range(self.n)
        if serves(choices):
            # A prediction that follows and changes nothing: a correction alone.
            model = Model(np.eye(d)[None, None], np.zeros((1, 1, d, d)), H[:, None], R[:, None], np.zeros((1, 1, d)))
            none = np.empty((self.n, 0, 0))
            out = Output(none, none, none, none, weights[:, None], log_likelihood)
            done = filter_series(choices, z[:, None], model, x, P, out, memory=memory, update_first=True)
            left = np.flatnonzero(done == 0)
        for i in left:
            found = told.corrected(i, choices)
            x[i], P[i], weights[i], log_likelihood[i] = found.x, found.P, found.weights, found.log_density
            if found.memory is not None:
                memory[i] = found.memory
        # All at once: Ctrl-C does not come in between.
        self.__dict__.update(
            x=x, P=P, weights=weights, log_likelihood=log_likelihood, _memory=memory, _told=told, _shown={}
        )

    @property
    def y(self) -> Array:
        """Innovation of the last update, shape (n, dim_z), 0 where missing."""
        return self._part("y", (self.dim_z,))

    @property
    def e(self) -> Array:
        """Standardized innovation of the last update, shape (n, dim_z), 0 where missing (paper 29)."""
        return self._part("e", (self.dim_z,))

    @property
    def S(self) -> Array:
        """Innovation covariance of the last update, shape (n, dim_z, dim_z)."""
        return self._part("S", (self.dim_z, self.dim_z))

    def _part(self, name: str, shape: tuple[int, ...]) -> Array:
        """Return what few programs look at after every update, made when it is asked for."""
        if name not in self._shown:
            found, told = np.zeros((self.n, *shape)), self._told
            if told is not None:
                found[:] = [getattr(told.corrected(i, self._choices), name) for i in range(self.n)]
            self._shown[name] = found
        return self._shown[name]

    @property
    def spread(self) -> Array:
        """How large each sensor's standardized innovations usually are, shape (n, dim_z); NaN before the first."""
        return np.where(self._memory[..., spread.WEIGHT] > 0.0, self._memory[..., spread.SPREAD], np.nan)

    def state(self) -> dict[str, Array]:
        """Return everything that the filters need to go on, as plain arrays.

        Returns
        -------
        dict of str to ndarray
            ``format``, as in `RobustKalmanFilter.state`; x, P, F, Q, H and R; and ``spread``, shape (n, dim_z, 10),
            what is known of the sensors, if anything is.
        """
        x, P = self._state()
        known = {"spread": self._memory} if self._memory.any() else {}
        return _state.labelled(
            "FilterBank", {"x": x, "P": P, **{name: getattr(self, name) for name in "FQHR"}, **known}
        )

    def restore(self, state: Any) -> None:
        """Go back to a state of this bank, or of another one of the same sizes.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `state`, or what ``numpy.load`` makes of a file that holds it; F, Q, H and R stay as they are if it
            does not hold them, and nothing is known of the sensors then.

        Raises
        ------
        ValueError
            If it is not of a bank or of a newer format, an array is missing, does not fit, or is not finite, or a P is
            no covariance; nothing has changed then.
        TypeError
            If state is no mapping.

        Notes
        -----
        The continuation is the same to the last bit; y, e, S and weights show nothing until the next `update`.
        """
        n, d, m = self.n, self.dim_x, self.dim_z
        sizes = {"F": (d, d), "Q": (d, d), "H": (m, d), "R": (m, m)}
        shared = [name for name in sizes if name in state and np.ndim(state[name]) == 2]
        optional = {name: shape if name in shared else (n, *shape) for name, shape in sizes.items()}
        optional["spread"] = (n, m, spread.NUMBERS)
        found = _state.checked(state, "FilterBank", {"x": (n, d), "P": (n, d, d)}, optional)
        found["_memory"] = found.pop("spread", np.tile(spread.begin(m), (n, 1, 1)))
        self.__dict__.update(
            **found, weights=np.full((n, m), np.nan), log_likelihood=np.zeros(n), _told=None, _shown={}
        )  # fmt: skip

    _checked: Array | None = None

    def _state(self) -> tuple[Array, Array]:
        """Return x and P, checked."""
        x, P = numbers("x", self.x), numbers("P", self.P)
        for name, value, shape in (("x", x, (self.n, self.dim_x)), ("P", P, (self.n, self.dim_x, self.dim_x))):
            if value.shape != shape:
                raise ValueError(f"{name}: expected shape {shape} for n={self.n}, got {value.shape}")
        return x, P

    def _control(self, B: Any, u: Any) -> Array:
        """Return B u, shape (n, dim_x), checked."""
        B, d = numbers("B", B), self.dim_x
        if B.ndim not in (2, 3) or B.shape[-2] != d:
            raise ValueError(f"B: expected shape ({d}, dim_u) or ({self.n}, {d}, dim_u), got {B.shape}")
        return np.asarray((B @ np.broadcast_to(numbers("u", u), (self.n, B.shape[-1]))[:, :, None])[:, :, 0])

    def _matrix(self, name: str, shape: tuple[int, int]) -> Array:
        """Return a matrix as shape (1 or n, ., .), checked."""
        given = getattr(self, name)
        if given is None:
            raise ValueError(f"{name}: expected shape {shape} or {(self.n, *shape)}, got None")
        value = numbers(name, given)
        value = value[None] if value.ndim == 2 else value
        if value.ndim != 3 or value.shape[1:] != shape or len(value) not in (1, self.n):
            raise ValueError(f"{name}: expected shape {shape} or {(self.n, *shape)}, got {value.shape}")
        return value


class _Told(NamedTuple):
    """What an update was told, a row for each filter or one for all."""

    x: Array
    P: Array
    z: Array
    H: Array
    R: Array
    memory: Array

    def corrected(self, i: int, choices: Choices) -> Correction:
        """Return the correction of one filter by the definition, or raise with its number."""
        H, R, memory = self.H[i % len(self.H)], self.R[i % len(self.R)], self.memory[i]
        try:
            innovation = self.z[i] - H @ self.x[i]
            if not np.isfinite(innovation[self.z[i] == self.z[i]]).all():
                raise ValueError("update: expected finite innovations, got NaN or infinity; check x and H")
            C, S = innovation_moments(self.P[i], H, R)
            if choices.by_custom and not np.isnan(innovation).all():
                return correct_by_custom(
                    memory, self.x[i], self.P[i], Innovation(self.z[i], innovation, C, S, R, H), choices
                )
            return correct(self.x[i], self.P[i], innovation, C, S, choices)
        except (ValueError, np.linalg.LinAlgError) as error:
            error.args = (f"filter {i}: {error}", *error.args[1:])
            raise


@np.errstate(invalid="ignore")
def _require_covariances(R: Array) -> None:
    """Raise unless every R is a covariance."""
    if _checks.all_covariances(R):
        return
    bad: list[int] = []
    sentence = ""
    for s, R_s in enumerate(R):
        try:
            _checks.covariance("R", R_s)
        except ValueError as error:
            sentence = sentence if bad else str(error)
            bad.append(s)
    which = "" if len(R) == 1 else f" (filter {bad[0]}{f' and {len(bad) - 1} more' if len(bad) > 1 else ''})"
    raise ValueError(sentence + which)
