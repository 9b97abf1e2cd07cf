"""Equations of a plant in continuous time, x' = f(x, u, p), y = h(x, u, p) + noise, and their model of a recording.

Residuals of a physical model in continuous time, integrated between samples that may come at any times.

Runge and Kutta's method of fourth order, with as many steps between two samples as the equations ask for. All
parameters that differentiation needs are integrated at once, where f takes them as columns, else one by one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.noise import Noises, OutputResiduals, with_linear
from robust_filterpy.identification.models.recording import ANY_TIMES, Recording, columns_of, recorded
from robust_filterpy.identification.models.results import Identified
from robust_filterpy.identification.models.signals import Signals, TimeAxis, held_input, trend_of

_DIFFERENCE: Final = 1e-5
_MOST_STEPS: Final = 128
# Twice as many steps change an output by less than this share of its size.
_ACCURATE: Final = 1e-4


class GreyResiduals(OutputResiduals):
    """Residuals of recordings, one row of y after the other.

    The free parameters are those of the equations, then the start of each recording if it is free.

    Parameters
    ----------
    structure : GreyBox
        The equations.
    recording : Recording
        What was recorded, with times.
    starts : ndarray, shape (n_recordings, n)
        States in the first samples.
    free_start : bool
        Whether these are free.
    """

    def __init__(self, structure: GreyBox, recording: Recording, starts: Array, free_start: bool) -> None:
        """Find out whether f takes columns."""
        self.recordings = [(recording.times[own], recording.y[own], recording.u[own]) for own in recording.spans]
        super().__init__([y for _, y, _ in self.recordings])
        self.structure, self.starts, self.free_start = structure, starts, free_start
        self._at, self._values = [structure.names.index(name) for name in structure.free_names], structure.values
        self.k = len(self._at)
        self.first = np.concatenate((self._values[self._at], starts.ravel() if free_start else []))
        self.size, self.n = np.where(self.first == 0.0, 1.0, np.abs(self.first)), self.first.size
        bounds = [structure.limits.get(name, (-np.inf, np.inf)) for name in structure.free_names]
        self.lower, self.upper = np.array([*bounds, *[(-np.inf, np.inf)] * (self.n - self.k)]).T
        self._measured = np.nan_to_num(recording.y)
        self.steps, self._columns, self.error = 1, False, np.zeros(self.outputs)
        self._columns = self._takes_columns()

    def settled(self, z: Array) -> bool:
        """Take as many steps as the equations need; False if they need too many."""
        before = None
        while self.steps <= _MOST_STEPS:
            now = self.simulated(z)
            if before is not None and np.isfinite(now).all():
                # Of what is computed too: a simulation has no measured outputs.
                size, self.error = np.std([self._measured, now], axis=1), np.abs(now - before).max(axis=0)
                if (self.error <= _ACCURATE * size.max(axis=0)).all():
                    self.steps = max(self.steps // 2, 1)
                    return True
            before = now if np.isfinite(now).all() else None
            self.steps *= 2
        self.steps = _MOST_STEPS
        return before is not None

    def residuals(self, z: Array) -> Array:
        """Return y less the outputs of all recordings, any number where an output is missing."""
        return (self._measured - self.simulated(z)).ravel()

    def simulated(self, z: Array) -> Array:
        """Return the outputs of all recordings, shape (sum of N, p)."""
        return np.concatenate([self._outputs(z[:, None], i)[:, :, 0] for i in range(len(self.recordings))])

    def jacobian(self, z: Array) -> Array:
        """Return the derivatives of the residuals by differences."""
        step = _DIFFERENCE * self.size
        step, parts = np.where(z + step > self.upper, -step, step), []
        for i in range(len(self.recordings)):
            outputs = self._outputs(z[:, None] + np.column_stack((np.zeros(self.n), np.diag(step))), i)
            parts.append((outputs[..., :1] - outputs[..., 1:]).reshape(-1, self.n) / step)
        return np.concatenate(parts)

    def is_stable(self, z: Array) -> bool:
        """Tell whether there are outputs at all: a trial that overflows is no step."""
        return bool(np.isfinite(z).all())

    def starts_of(self, z: Array) -> Array:
        """Return the states in which the recordings begin, shape (n_recordings, n) or, for columns, (.., m)."""
        if self.free_start:
            return z[self.k :].reshape(*self.starts.shape, *z.shape[1:])
        return np.repeat(self.starts[..., None], z.shape[1], axis=2) if z.ndim == 2 else self.starts

    def _outputs(self, z: Array, i: int) -> Array:
        """Return the outputs of a recording, shape (N, p, m), for columns of free parameters."""
        if not self._columns and z.shape[1] > 1:
            return np.concatenate([self._outputs(z[:, j : j + 1], i) for j in range(z.shape[1])], axis=2)
        (t, y, u), linear = self.recordings[i], self.structure.between == "lines"
        p, x = self._whole(z[: self.k]), self.starts_of(z)[i]
        if not self._columns:
            p, x = p[:, 0], x[:, 0]
        outputs = np.empty((*y.shape, z.shape[1]))
        with np.errstate(all="ignore"):
            for k in range(len(t)):
                outputs[k] = np.reshape(self._of(self.structure.h, x, u[k], p), (y.shape[1], -1))
                if k + 1 < len(t):
                    x = self._moved(x, u[k], u[k + 1] if linear else u[k], p, t[k + 1] - t[k])
        return outputs

    def _whole(self, p: Array) -> Array:
        """Return all parameters of the equations, or columns of them, for those that are free."""
        whole = np.broadcast_to(self._values.reshape(-1, *[1] * (p.ndim - 1)), (self._values.size, *p.shape[1:])).copy()
        whole[self._at] = p
        return whole

    def _moved(self, x: Array, u: Array, then: Array, p: Array, span: float) -> Array:
        """Return the state at the next sample."""
        step = span / self.steps
        for j in range(self.steps):
            a, b = (u + (then - u) * ((j + at) / self.steps) for at in (0.0, 1.0))
            middle = 0.5 * (a + b)
            k1 = self._of(self.structure.f, x, a, p)
            k2 = self._of(self.structure.f, x + 0.5 * step * k1, middle, p)
            k3 = self._of(self.structure.f, x + 0.5 * step * k2, middle, p)
            k4 = self._of(self.structure.f, x + step * k3, b, p)
            x = x + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return x

    def _of(self, function: Callable[..., Any] | None, x: Array, u: Array, p: Array) -> Array:
        """Return what a function of the user's says, one row a state or output; without h outputs are the states."""
        try:
            # A copy: who writes into p does so for this sample.
            values = x if function is None else function(x, u, p.copy())
            if x.ndim == 1:
                return np.asarray(values, dtype=float).ravel()
            return np.stack([np.broadcast_to(np.asarray(row, dtype=float), x.shape[1:]) for row in values])
        except (OverflowError, ZeroDivisionError, FloatingPointError):
            # A trial step too far: it is no number, and will be shortened.
            return np.full(x.shape, np.nan)

    def _takes_columns(self) -> bool:
        """Tell whether f and h do with columns what they do one by one."""
        p, x, u = self._whole(self.first[: self.k]), self.starts[0], self.recordings[0][2][0]
        sizes = np.array([1.0, 1.01, 1.0])
        for function in (self.structure.f, self.structure.h):
            single = np.stack([self._of(function, size * x, u, size * p) for size in sizes], axis=1)
            try:
                many = self._of(function, np.multiply.outer(x, sizes), u, np.multiply.outer(p, sizes))
            except Exception:
                return False
            if many.shape != single.shape or not np.allclose(many, single, equal_nan=True):
                return False
        return True


def require_functions(structure: GreyBox, one: Recording, p: Array) -> None:
    """Raise unless f and h take the inputs of a recording and return what they should."""
    for name, function, size in (("f", structure.f, structure.x0.size), ("h", structure.h, one.y.shape[1])):
        try:
            value: Any = structure.x0 if function is None else function(structure.x0, one.u[0], p)
        except (IndexError, ValueError, TypeError) as error:
            raise ValueError(
                f"u: expected the inputs that {name} takes, got {one.u.shape[1]} of them ({error})"
            ) from None
        if np.size(value) != size:
            what = "one derivative for each state" if name == "f" else "one number for each output"
            raise ValueError(f"{name}: expected {what}, {size} of them, got {np.size(value)}")


_UNSETTLED: Final = "f: expected outputs that are finite; the equations are unstable or too stiff between samples"
# Steps towards the states in which a recording begins, and how often one is halved; less in -log of the likelihood is
# no progress.
_START_STEPS: Final = 20
_HALVINGS: Final = 6
_SETTLED: Final = 1e-4


@dataclass(frozen=True, eq=False)
class GreyBox:
    """Equations of a plant whose parameters are to be found by `identify`.

    Parameters
    ----------
    f : function
        f(x, u, p) gives x', the derivatives of the states in 1/s: x of shape (n,), u of shape (m,), p of shape (k,) in
        the order of p0. Where it also takes columns, x of shape (n, j) and p of shape (k, j), it is many times as fast.
    p0 : dict of str to float, or array_like, shape (k,)
        Names and first guesses of the parameters.
    x0 : array_like, shape (n,)
        First guess of the states in the first sample.
    h : function, optional
        h(x, u, p) gives the outputs. Default: the states themselves.
    fixed : iterable of str, optional
        Parameters that stay as they are.
    bounds : dict of str to (float, float), optional
        Least and largest value of some parameters; None or infinity for no bound.
    start : {"free", "fixed"}, default "free"
        Whether the states in the first sample are estimated too.
    between : {"held", "lines"}, default "held"
        What inputs do between samples.

    Raises
    ------
    ValueError, TypeError
        If a name is unknown, a guess is outside its bounds, or an argument is of the wrong kind.

    Examples
    --------
    >>> box = GreyBox(lambda x, u, p: [(p[0] * u[0] - x[0]) / p[1]], {"gain": 1.0, "T": 2.0}, x0=[0.0])
    >>> box.names
    ('gain', 'T')
    """

    f: Callable[..., Any]
    p0: Any
    x0: Any
    h: Callable[..., Any] | None = None
    fixed: Iterable[str] = ()
    bounds: Mapping[str, Any] = field(default_factory=dict)
    start: str = "free"
    between: str = "held"

    def __post_init__(self) -> None:
        """Check everything but the functions, which only data can."""
        for name, function in (("f", self.f), ("h", self.h)):
            if function is not None and not callable(function):
                raise TypeError(f"{name}: expected a function {name}(x, u, p), got {_checks.shown(function)}")
        named = self.p0 if isinstance(self.p0, Mapping) else {
            f"p{j + 1}": value for j, value in enumerate(np.atleast_1d(_checks.numbers("p0", self.p0)))
        }  # fmt: skip
        object.__setattr__(
            self, "p0", {str(name): _checks.real(f"p0[{name!r}]", value) for name, value in named.items()}
        )
        object.__setattr__(self, "x0", np.atleast_1d(_checks.numbers("x0", self.x0)))
        object.__setattr__(self, "fixed", tuple(self.fixed))
        _checks.option("start", self.start, ("free", "fixed"))
        _checks.option("between", self.between, ("held", "lines"))
        for name in (*self.fixed, *self.bounds):
            if name not in self.p0:
                raise ValueError(f"p0: expected a parameter {name!r}, got {', '.join(self.p0)}")
        if not self.free_names:
            raise ValueError("fixed: expected at least one parameter that is free, got all of them")
        if not np.isfinite([*self.values, *self.x0]).all():
            raise ValueError("p0: expected finite first guesses, got NaN or inf")
        for name, (low, high) in self.limits.items():
            if not low < self.p0[name] < high:
                raise ValueError(f"p0: expected {name} between {low:.6g} and {high:.6g}, got {self.p0[name]:.6g}")

    def __str__(self) -> str:
        """Return the kind of structure, which is all that a title has room for."""
        return "GreyBox"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters."""
        return tuple(self.p0)

    @property
    def free_names(self) -> tuple[str, ...]:
        """Names of those that are estimated."""
        return tuple(name for name in self.p0 if name not in self.fixed)

    @property
    def limits(self) -> dict[str, tuple[float, float]]:
        """Bounds of the parameters that have some, as numbers."""
        return {name: _checks.interval(f"bounds[{name!r}]", ends) for name, ends in self.bounds.items()}

    @property
    def values(self) -> Array:
        """First guesses of all parameters."""
        return np.array([*self.p0.values()])


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class GreyBoxModel(Identified):
    """A physical model as `identify` found it.

    Attributes
    ----------
    structure : GreyBox
        The equations.
    p : dict of str to float
        All parameters, those that were fixed too.
    theta, std : ndarray, shape (k,)
        The estimated ones, in the order of ``structure.free_names``, and their standard deviations.
    P : ndarray, shape (k, k)
        Their covariance.
    starts : ndarray, shape (n_recordings, n)
        States in the first samples.
    noise : tuple of Noise
        Of each output.
    weights : ndarray, shape (N, n_outputs)
        How much each sample was believed; NaN where it is missing.
    log_likelihood : float
        Of what is measured.
    unidentifiable : tuple of tuple of str
        Parameters that the recording cannot tell, or cannot tell from one another.
    warning : str
        What makes the estimate doubtful; empty if nothing does.
    findings : tuple of Finding
        What the recording has besides the model.
    trends : tuple of (int, ndarray)
        As of a `StateSpaceModel`.
    colour : float
        How many times as large standard deviations are as those of white residuals, which P counts.
    """

    p: dict[str, float]
    theta: Array
    starts: Array
    unidentifiable: tuple[tuple[str, ...], ...]

    def __repr__(self) -> str:
        """Show the estimated parameters with their standard deviations."""
        return f"GreyBoxModel({self._valued(self.structure.free_names)})" + self._remarks

    @property
    def _rows(self) -> tuple[tuple[str, ...], Array, Array]:
        """The parameters that are estimated."""
        return self.structure.free_names, self.theta, self.std

    def simulate(self, u: ArrayLike | None, t: ArrayLike, x0: ArrayLike | None = None) -> Array:
        """Run the model on inputs alone.

        Parameters
        ----------
        u : array_like, shape (N,) or (N, m), or None
            Inputs; where one is NaN it keeps the value before, and a warning says so.
        t : array_like, shape (N,)
            Times in s.
        x0 : array_like, shape (n,), optional
            States at the first of them. Default: those of the first recording.

        Returns
        -------
        ndarray, shape (N, n_outputs)

        Raises
        ------
        ValueError
            If they do not fit, or the equations overflow.
        """
        samples = np.zeros((np.size(t), len(self.noise)))
        signal = None if u is None else held_input(Signals(columns_of("u", u).shape[1], 0), u, np.zeros(0))
        recording = recorded(ANY_TIMES, samples, signal, t=t)._replace(y=samples)
        start = self.starts[0] if x0 is None else np.atleast_1d(_checks.numbers("x0", x0))
        if start.shape != self.structure.x0.shape:
            raise ValueError(f"x0: expected {self.structure.x0.size} states, got shape {start.shape}")
        require_functions(self.structure, recording, np.array([*self.p.values()]))
        model = GreyResiduals(self.structure, recording, start[None], False)
        if not model.settled(self.theta):
            raise ValueError(_UNSETTLED)
        return model.simulated(self.theta)

    def _run(self, y: Any, u: Any, t: Any, steps: int) -> tuple[TimeAxis, Any, Any]:
        """Return no time axis, measured outputs, and those from inputs alone, however far ahead."""
        measured, _, model, z = self.started(y, u, t)
        return TimeAxis(), measured, model.simulated(z) + trend_of(self.trends, measured)

    def started(self, y: Any, u: Any, t: Any = None) -> tuple[Array, Array, GreyResiduals, Array]:
        """Return a checked recording, its residuals and free parameters, with the likeliest states to begin with."""
        given = recorded(ANY_TIMES, y, u, t=t)
        count, free = given.y.shape[1], self.structure.start == "free"
        if count != len(self.noise):
            raise ValueError(f"y: expected {len(self.noise)} output(s), as the model has, got {count}")
        recording = given._replace(y=given.y - trend_of(self.trends, given.y))
        require_functions(self.structure, recording, np.array([*self.p.values()]))
        ends: list[Any] = []
        for start in (*self.starts, self.structure.x0) if free else (self.structure.x0,):
            model = GreyResiduals(self.structure, recording, start[None], free)
            z = np.concatenate((self.theta, start if free else []))
            if model.settled(z):
                noise = Noises(self.noise, model.which)
                z = _likeliest(model, z, noise) if free else z
                ends.append((noise.cost(model.residuals(z)[model.rows]), len(ends), model, z))
        if not ends:
            raise ValueError(_UNSETTLED)
        return given.y, recording.u, *min(ends)[2:]


def _likeliest(model: GreyResiduals, z: Array, noise: Noises) -> Array:
    """Return free parameters with the start at which the residuals are likeliest, the parameters as they are."""
    size, rows = np.sqrt(noise.variance), model.rows
    cost = noise.cost(model.residuals(z)[rows])
    for _ in range(_START_STEPS):
        step, before = with_linear(model, z, slice(model.k, None), rows, size) - z, cost
        for share in 0.5 ** np.arange(_HALVINGS):
            trial = model.residuals(z + share * step)[rows]
            if np.isfinite(trial).all() and noise.cost(trial) < cost:
                z, cost = z + share * step, noise.cost(trial)
                break
        if before - cost < _SETTLED:
            break
    return z
