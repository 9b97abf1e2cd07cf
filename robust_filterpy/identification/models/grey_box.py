"""Equations of a plant in continuous time, x' = f(x, u, p), y = h(x, u, p) + noise, and their model of a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models.grey_box_residuals import GreyRecording, GreyResiduals, Scale, require_inputs
from robust_filterpy.identification.models.noise import Noise, Noises
from robust_filterpy.identification.models.recording import ANY_TIMES, recorded
from robust_filterpy.identification.models.results import (
    Finding,
    Identified,
)
from robust_filterpy.identification.models.signals import trend_of
from robust_filterpy.identification.models.time_axis import TimeAxis
from robust_filterpy.influence.regression import robust_regression

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
        values = np.array([*self.p0.values(), *self.x0])
        if not np.isfinite(values).all():
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
        limits = {}
        for name, (low, high) in self.bounds.items():
            limits[name] = (-np.inf if low is None else float(low), np.inf if high is None else float(high))
        return limits

    @property
    def scales(self) -> tuple[Scale, Scale]:
        """Free numbers of the parameters that are estimated, and of the states."""
        p = np.array([self.p0[name] for name in self.free_names])
        bounds = np.array([self.limits.get(name, (-np.inf, np.inf)) for name in self.free_names])
        size, wide = np.where(p == 0.0, 1.0, np.abs(p)), np.full(self.x0.size, np.inf)
        states = Scale(self.x0, np.where(self.x0 == 0.0, 1.0, np.abs(self.x0)), -wide, wide)
        return Scale(p, size, bounds[:, 0], bounds[:, 1]), states

    def residuals_of(self, recordings: list[GreyRecording], starts: Array, free_start: bool) -> GreyResiduals:
        """Return what gives the residuals of recordings.

        Parameters
        ----------
        recordings : list of GreyRecording
            What was recorded.
        starts : ndarray, shape (n_recordings, n)
            States in the first samples.
        free_start : bool
            Whether these are free.

        Returns
        -------
        GreyResiduals
        """
        at = [self.names.index(name) for name in self.free_names]
        values = np.array([*self.p0.values()])
        h = self.h

        def whole(p: Array) -> Array:
            parameters = np.repeat(values[:, None], p.shape[1], axis=1) if p.ndim == 2 else values.copy()
            parameters[at] = p
            return parameters

        def f(x: Array, u: Array, p: Array) -> Any:
            return self.f(x, u, whole(p))

        def outputs(x: Array, u: Array, p: Array) -> Any:
            return x if h is None else h(x, u, whole(p))

        return GreyResiduals(f, outputs, recordings, *self.scales, starts, free_start, self.between == "lines")


@dataclass(frozen=True, eq=False, repr=False)
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
    untold : tuple of tuple of str
        Parameters that the recording cannot tell, or cannot tell from one another.
    warning : str
        What makes the estimate doubtful; empty if nothing does.
    findings : tuple of Finding
        What the recording has beside the model.
    trends : tuple of (int, ndarray)
        As of a `StateSpaceModel`.
    colour : float
        How many times as large standard deviations are as those of white residuals, which P counts.
    """

    structure: GreyBox
    p: dict[str, float]
    theta: Array
    P: Array
    starts: Array
    noise: tuple[Noise, ...]
    weights: Array
    log_likelihood: float
    untold: tuple[tuple[str, ...], ...]
    warning: str
    findings: tuple[Finding, ...] = ()
    trends: tuple[tuple[int, Array], ...] = ()
    colour: float = 1.0

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
            Inputs.
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
        times = np.atleast_1d(_checks.numbers("t", t))
        if times.ndim != 1 or (np.diff(times) <= 0.0).any() or not np.isfinite(times).all():
            raise ValueError("t: expected times that increase, of shape (N,)")
        signal = np.zeros((times.size, 0)) if u is None else _checks.numbers("u", u).reshape(len(np.asarray(u)), -1)
        if len(signal) != times.size:
            raise ValueError(f"u: expected {times.size} samples like t, got {len(signal)}")
        if not np.isfinite(signal).all():
            k = int(np.argmin(np.isfinite(signal).all(axis=1)))
            raise ValueError(f"u: expected finite numbers, got {signal[k]} in sample {k}; fill in what acted")
        start = self.starts[0] if x0 is None else np.atleast_1d(_checks.numbers("x0", x0))
        if start.shape != self.structure.x0.shape:
            raise ValueError(f"x0: expected {self.structure.x0.size} states, got shape {start.shape}")
        recording = GreyRecording(times, np.zeros((times.size, len(self.noise))), signal)
        require_inputs(self.structure, recording, np.array([*self.p.values()]))
        model = self.structure.residuals_of([recording], start[None], False)
        z = model.p.free(self.theta)
        if not model.settled(z):
            raise ValueError(
                "f: expected outputs that are finite; the equations are unstable or too stiff between samples"
            )
        return -model.residuals(z).reshape(times.size, -1)

    def predict(  # type: ignore[override]
        self, y: ArrayLike, u: ArrayLike | None, t: ArrayLike | None = None, steps: int = 1
    ) -> Any:
        """Predict each output of a recording: from inputs alone, however far ahead, since equations have no noise.

        Parameters
        ----------
        y, u, t
            As in `free_run`.
        steps : int, default 1
            How many samples ahead, which is all the same.

        Returns
        -------
        ndarray, shape (N, n_outputs)

        Raises
        ------
        ValueError, TypeError
            If they do not fit, the equations overflow, or steps is no positive integer.
        """
        return super().predict(y, u, steps, t)

    def _run(self, y: Any, u: Any, t: Any, steps: int) -> tuple[TimeAxis, Any, Any]:
        """Return no time axis, measured outputs, and those from inputs alone, however far ahead."""
        measured, _, model, z = self.started(y, u, t)
        return TimeAxis(), measured, np.nan_to_num(measured) - model.residuals(z).reshape(measured.shape)

    def started(self, y: Any, u: Any, t: Any = None) -> tuple[Array, Array, GreyResiduals, Array]:
        """Return a checked recording, its residuals and free parameters, with the likeliest states to begin with.

        Parameters
        ----------
        y : array_like, shape (N,) or (N, n_outputs)
            Outputs; NaN where one is missing.
        u : array_like, shape (N,) or (N, m), or None
            Inputs.
        t : array_like, shape (N,), or None
            Times in s; None for those of the index.

        Returns
        -------
        measured : ndarray, shape (N, n_outputs)
        signal : ndarray, shape (N, m)
        equations : GreyResiduals
        z : ndarray

        Raises
        ------
        ValueError
            If they do not fit, or the equations overflow.
        """
        given = recorded(ANY_TIMES, y, u, t=t)
        shape, p = given.y.shape, np.array([*self.p.values()])
        if shape[1] != len(self.noise):
            raise ValueError(f"y: expected {len(self.noise)} output(s), as the model has, got {shape[1]}")
        recording = GreyRecording(given.times, np.nan_to_num(given.y - trend_of(self.trends, given.y)), given.u)
        require_inputs(self.structure, recording, p)
        rows, free = ~np.isnan(given.y).ravel(), self.structure.start == "free"
        noise = Noises(self.noise, np.tile(np.arange(shape[1]), shape[0])[rows])
        ends: list[Any] = []
        for start in (*self.starts, self.structure.x0) if free else (self.structure.x0,):
            model = self.structure.residuals_of([recording], start[None], free)
            z = np.concatenate((model.p.free(self.theta), model.x.free(start) if free else []))
            if model.settled(z):
                z = _likeliest(model, z, noise, rows) if free else z
                ends.append((noise.cost(model.residuals(z)[rows]), len(ends), model, z))
        if not ends:
            raise ValueError(
                "f: expected outputs that are finite; the equations are unstable or too stiff between samples"
            )
        return given.y, recording.u, *min(ends)[2:]


def _likeliest(model: GreyResiduals, z: Array, noise: Noises, rows: Any) -> Array:
    """Return free parameters with the start at which the residuals are likeliest, the parameters as they are."""
    size, cost = np.sqrt(noise.variance), noise.cost(model.residuals(z)[rows])
    for _ in range(_START_STEPS):
        J = model.jacobian(z)[rows, model.k :] / size[:, None]
        step = np.zeros(z.size)
        step[model.k :] = robust_regression(-J, model.residuals(z)[rows] / size)
        before = cost
        for share in 0.5 ** np.arange(_HALVINGS):
            trial = model.residuals(z + share * step)[rows]
            if np.isfinite(trial).all() and noise.cost(trial) < cost:
                z, cost = z + share * step, noise.cost(trial)
                break
        if before - cost < _SETTLED:
            break
    return z
