"""State-space models of several outputs: x(k+1) = A x + B u + K e, y = C x + D u + level + e."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import fill_values
from robust_filterpy.identification.models import coefficients
from robust_filterpy.identification.models.beginnings import held_input
from robust_filterpy.identification.models.continuous import ContinuousModel, continuous
from robust_filterpy.identification.models.findings import Finding, said
from robust_filterpy.identification.models.fit import fit_percent
from robust_filterpy.identification.models.learnt_noise import Noise
from robust_filterpy.identification.models.noise_of_outputs import Noises
from robust_filterpy.identification.models.response_records import FrequencyResponse, StepResponse
from robust_filterpy.identification.models.signals import measured_outputs, recorded_input
from robust_filterpy.identification.models.state_space_residuals import StateSpaceResiduals
from robust_filterpy.identification.models.time_axis import TimeAxis, recording, table
from robust_filterpy.identification.models.uncertainty import Regions, bands, regions
from robust_filterpy.influence.regression import robust_regression

if TYPE_CHECKING:
    import control

__all__ = ["Signals", "StateSpace", "StateSpaceModel"]

_AUTO = range(1, 9)


@dataclass(frozen=True)
class StateSpace:
    """Order of a state-space model with several inputs and outputs, for `identify`.

    Parameters
    ----------
    n : int or "auto", default "auto"
        Number of states; "auto": as many, up to 8, as the evidence supports (Bayes' information criterion).
    feedthrough : bool, default False
        Whether inputs act on y at once: a D.
    disturbance : bool, default False
        Whether noise drives the states too: a K. Without, each sensor has noise of its own and the states have none.

    Raises
    ------
    ValueError, TypeError
        If n is no positive integer or "auto", or an option is not True or False.

    Examples
    --------
    >>> StateSpace(4)
    StateSpace(n=4, feedthrough=False, disturbance=False)
    """

    n: int | str = "auto"
    feedthrough: bool = False
    disturbance: bool = False

    def __post_init__(self) -> None:
        """Check the order."""
        if isinstance(self.n, str):
            _checks.option("n", self.n, ("auto",))
        else:
            object.__setattr__(self, "n", _checks.count("n", self.n, 1))
        for name in ("feedthrough", "disturbance"):
            if not isinstance(getattr(self, name), (bool, np.bool_)):
                raise TypeError(f"{name}: expected True or False, got {getattr(self, name)!r}")

    @property
    def orders(self) -> Any:
        """Which orders are tried."""
        return _AUTO if isinstance(self.n, str) else (self.n,)


class Signals(NamedTuple):
    """How many inputs and outputs recordings have, for what is asked of a structure there.

    Attributes
    ----------
    n_inputs, n_outputs : int
        How many.
    takes_phi : bool
        No regressor comes from the caller.
    """

    n_inputs: int
    n_outputs: int
    takes_phi: bool = False

    @property
    def inputs(self) -> Any:
        """A place for each input."""
        return range(self.n_inputs)

    @classmethod
    def of(cls, y: Any, u: Any) -> Signals:
        """Return those of recordings, or raise.

        Parameters
        ----------
        y, u : array_like, shape (N,) or (N, n), or list of these
            Outputs and inputs.

        Returns
        -------
        Signals
        """
        if u is None:
            raise ValueError("u: expected a recording of the inputs for a state-space model, got None")
        several = isinstance(y, (list, tuple)) and all(np.ndim(one) > 0 and np.shape(one)[0] > 1 for one in y)
        first, second = (y[0], u[0]) if several and len(y) else (y, u)
        shapes = np.shape(first), np.shape(second)
        for name, shape in zip("yu", shapes, strict=True):
            if len(shape) not in (1, 2):
                raise ValueError(f"{name}: expected shape (N,) or (N, n), got {shape}")
        n_outputs, n_inputs = (int(shape[1]) if len(shape) == 2 else 1 for shape in shapes)
        return cls(n_inputs, n_outputs)


@dataclass(frozen=True, eq=False, repr=False)
class StateSpaceModel:
    """x(k+1) = A x + B u + K e, y = C x + D u + level + e, in a balanced basis, as `identify` found it.

    Attributes
    ----------
    structure : StateSpace
        With the order that was found.
    A, B, C, D, K : ndarray, shape (n, n), (n, m), (p, n), (p, m), (n, p)
        The matrices.
    level, level_std : ndarray, shape (p,)
        What each output is at rest, and how sure that is; of the last of several recordings.
    P : ndarray, shape (s, s)
        Covariance of all entries of A, B, C, and D and K if there are any. It is that of one basis: what does not
        depend on the basis has its own bands, `poles`, `step_response`, `frequency_response`.
    noise : tuple of Noise
        Of each output.
    weights : ndarray, shape (N, p)
        How much each sample was believed; NaN where it is missing.
    log_likelihood : float
        Of what is measured.
    warning : str
        What makes the estimate doubtful; empty if nothing does.
    end : ndarray, shape (n,)
        State after the recording.
    operating_point : ndarray, shape (m,)
        Inputs at which it rests.
    dt : float or None
        Sampling period in s, if the index told it.
    findings : tuple of Finding
        What the recording has beside the model.
    levels : ndarray, shape (n_recordings, p)
        Level of each recording.
    orders : tuple of (int, float)
        The orders that were tried, and the information criterion of each.
    """

    structure: StateSpace
    A: Array
    B: Array
    C: Array
    D: Array
    K: Array
    level: Array
    level_std: Array
    P: Array
    noise: tuple[Noise, ...]
    weights: Array
    log_likelihood: float
    warning: str
    end: Array
    operating_point: Array
    dt: float | None = None
    findings: tuple[Finding, ...] = ()
    levels: Array = field(default_factory=lambda: np.zeros((0, 0)))
    orders: tuple[tuple[int, float], ...] = ()

    def __repr__(self) -> str:
        """Show orders, poles and noise."""
        poles = ", ".join(f"{pole:.4g}" for pole in np.linalg.eigvals(self.A))
        std = ", ".join(f"{value:.3g}" for value in np.sqrt(self.R))
        beside = f"; found: {said(self.findings)}" if self.findings else ""
        doubt = f"; doubtful: {self.warning}" if self.warning else ""
        p, m = self.D.shape
        return (
            f"StateSpaceModel(n={len(self.A)}, {m} input(s), {p} output(s), poles {poles}, noise {std})"
            + beside
            + doubt
        )

    @property
    def R(self) -> Array:
        """Variance of the ordinary noise of each output, shape (p,)."""
        return np.array([one.R for one in self.noise])

    @property
    def theta(self) -> Array:
        """All entries of A, B, C, and D and K if there are any, shape (s,)."""
        parts = [self.A, self.B, self.C]
        parts += [self.D] * self.structure.feedthrough + [self.K] * self.structure.disturbance
        return np.concatenate([part.ravel() for part in parts])

    def to_control(self, dt: Any = "recorded") -> control.StateSpace:
        """Return the way from u to y.

        Parameters
        ----------
        dt : float, True or "recorded", default "recorded"
            Sampling period in s; True leaves it open.

        Returns
        -------
        control.StateSpace
        """
        import control

        return control.ss(self.A, self.B, self.C, self.D, coefficients.period(dt, self.dt))

    def reduced(self, n: int) -> control.StateSpace:
        """Return a system with fewer states: the basis is balanced, and those that do least are left out.

        Parameters
        ----------
        n : int
            How many states are left, 1 to those that there are.

        Returns
        -------
        control.StateSpace

        Raises
        ------
        ValueError
            If there are not so many.
        """
        import control

        if _checks.count("n", n, 1) > len(self.A):
            raise ValueError(f"n: expected 1 to {len(self.A)} states, got {n}")
        A, B, C = self.A[:n, :n], self.B[:n], self.C[:, :n]
        return control.ss(A, B, C, self.D, coefficients.period("recorded", self.dt))

    def to_continuous(self, dt: float | None = None, level: float = 0.95) -> ContinuousModel:
        """Return the system in continuous time whose samples this model gives, with inputs held between them.

        Parameters
        ----------
        dt : float, optional
            Sampling period in s. Default: as the index told it.
        level : float, default 0.95
            Probability of the region of each pole.

        Returns
        -------
        ContinuousModel

        Raises
        ------
        ValueError
            If there is no dt, or a pole is at 0 or on the negative real axis.
        """
        n = len(self.A)
        part = slice(0, n * n)
        return continuous(
            (self.A, self.B, self.C, self.D), [0] * self.B.shape[1], self.dt if dt is None else dt, self.theta[part],
            self.P[part, part], lambda theta: np.linalg.eigvals(theta.reshape(n, n)), level,
        )  # fmt: skip

    def to_frame(self) -> Any:
        """Return poles, their sizes and standard deviations as a pandas DataFrame.

        Returns
        -------
        pandas.DataFrame
            A row for each pole: real, imag, size, std_real, std_imag.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        found = self.poles()
        std = np.sqrt(np.maximum(np.diagonal(found.covariance, axis1=1, axis2=2), 0.0))
        columns = {"real": found.values.real, "imag": found.values.imag, "size": np.abs(found.values)}
        return table({**columns, "std_real": std[:, 0], "std_imag": std[:, 1]}, range(1, len(self.A) + 1), "pole")

    def simulate(self, u: ArrayLike, start: Any = "rest") -> Array:
        """Run the model on inputs alone.

        Parameters
        ----------
        u : array_like, shape (N, m)
            Inputs; where one is NaN it keeps the value before, and a warning says so.
        start : {"rest", "continued"} or tuple of two recordings (y, u), default "rest"
            From rest; from where the recording of the model ended; from where this recording ended.

        Returns
        -------
        ndarray, shape (N, p)

        Raises
        ------
        ValueError
            If u or start does not fit.
        """
        axis, _, u = self._recording(None, u)
        signal = held_input(self._signals, u, self.operating_point) - self.operating_point
        x = np.zeros(len(self.A))
        if isinstance(start, tuple) and len(start) == 2:
            _, before, acted = self._recording(*start)
            began, q = self._started(*self._checked(before, acted))
            x = began.states(q, 0)[-1]
        elif _checks.option("start", start, ("rest", "continued")) == "continued":
            x = self.end
        model = self._residuals(np.zeros((len(signal), len(self.C))), signal)
        model.weights = [np.zeros((len(signal), len(self.C)))]
        found = -model.residuals(self._packed(model, x)).reshape(len(signal), -1)
        if not np.isfinite(found).all():
            raise ValueError("A: the output overflows: the model as it stands is unstable")
        return self._labelled(axis, found)

    def predict(self, y: ArrayLike, u: ArrayLike, steps: int = 1) -> Array:
        """Predict each output from the samples up to ``steps`` before it; without disturbance from the inputs alone.

        Parameters
        ----------
        y : array_like, shape (N, p)
            Outputs, which tell the start; NaN where one is missing.
        u : array_like, shape (N, m)
            Inputs.
        steps : int, default 1
            How many samples ahead. Inputs are taken as known.

        Returns
        -------
        ndarray, shape (N, p)

        Raises
        ------
        ValueError, TypeError
            If they do not fit, or steps is no positive integer.
        """
        steps = _checks.count("steps", steps, 1)
        axis, y, u = self._recording(y, u)
        measured, signal = self._checked(y, u)
        return self._labelled(axis, self._ahead(*self._started(measured, signal), signal, steps))

    def free_run(self, y: ArrayLike, u: ArrayLike) -> Array:
        """Compute the outputs from inputs alone, beginning with the state that y tells.

        Parameters
        ----------
        y : array_like, shape (N, p)
            Outputs; NaN where one is missing.
        u : array_like, shape (N, m)
            Inputs.

        Returns
        -------
        ndarray, shape (N, p)

        Raises
        ------
        ValueError
            If they do not fit.
        """
        axis, y, u = self._recording(y, u)
        measured, signal = self._checked(y, u)
        return self._labelled(axis, self._ahead(*self._started(measured, signal, True), signal, 1))

    def residuals(self, y: ArrayLike, u: ArrayLike) -> Array:
        """Return measured less predicted outputs.

        Parameters
        ----------
        y : array_like, shape (N, p)
            Outputs.
        u : array_like, shape (N, m)
            Inputs.

        Returns
        -------
        ndarray, shape (N, p)
            NaN where y is missing.

        Raises
        ------
        ValueError
            If they do not fit.
        """
        axis, y, u = self._recording(y, u)
        measured, signal = self._checked(y, u)
        return self._labelled(axis, measured - self._ahead(*self._started(measured, signal), signal, 1))

    def fit(self, y: ArrayLike, u: ArrayLike) -> Array:
        """Compute how well the model's output, from inputs alone, agrees with a recording.

        Parameters
        ----------
        y : array_like, shape (N, p)
            Outputs; NaN does not count.
        u : array_like, shape (N, m)
            Inputs.

        Returns
        -------
        ndarray, shape (p,)
            Percent, for each output; see `fit_percent`.

        Raises
        ------
        ValueError
            If they do not fit, or an output is constant.
        """
        _, y, u = self._recording(y, u)
        measured, signal = self._checked(y, u)
        return np.atleast_1d(fit_percent(measured, self._ahead(*self._started(measured, signal, True), signal, 1)))

    def poles(self, level: float = 0.95, rng: Any = None) -> Regions:
        """Return the poles, the eigenvalues of A, with regions.

        Parameters
        ----------
        level : float, default 0.95
            Probability of each region.
        rng : numpy.random.Generator or int, optional
            Where a region is sampled.

        Returns
        -------
        Regions

        Raises
        ------
        ValueError
            If level is no probability.
        """
        n = len(self.A)
        part = slice(0, n * n)
        return regions(
            self.theta[part], self.P[part, part], lambda t: np.linalg.eigvals(t.reshape(n, n)).astype(complex), level,
            rng,
        )  # fmt: skip

    def frequency_response(
        self, omega: ArrayLike, output: int = 0, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> FrequencyResponse:
        """Return the frequency response from the inputs to one output, with bands.

        Parameters
        ----------
        omega : array_like, shape (k,)
            Frequencies in rad/s, in [0, pi/dt].
        output : int, default 0
            Which output.
        level : float, default 0.95
            Probability of the band at each frequency.
        dt : float, optional
            Sampling period in s. Default: that of the recording, else 1.
        rng : numpy.random.Generator or int, optional
            Where bands are sampled.

        Returns
        -------
        FrequencyResponse

        Raises
        ------
        ValueError
            If an argument is out of range.
        """
        period = (self.dt or 1.0) if dt is None else _checks.positive("dt", dt)
        w = np.atleast_1d(_checks.numbers("omega", omega))
        if w.ndim != 1 or not ((w >= 0.0) & (w <= np.pi / period * (1.0 + 1e-9))).all():
            raise ValueError(f"omega: expected frequencies from 0 to pi/dt = {np.pi / period:.4g} rad/s")
        which, z = self._output(output), np.exp(1j * period * w)

        def response(theta: Array) -> Any:
            A, B, C, D = self._matrices(theta)
            shifted = z[:, None, None] * np.eye(len(A)) - A
            return (C[which] @ np.linalg.solve(shifted, np.broadcast_to(B, (z.size, *B.shape))) + D[which]).T

        center = response(self.theta)

        def logarithm(thetas: Array) -> Array:
            ratio = np.array([response(theta) for theta in thetas]) / np.where(center == 0.0, 1.0, center)
            return np.stack((np.log(np.abs(ratio)), np.angle(ratio)), axis=1)

        with np.errstate(divide="ignore", invalid="ignore"):
            low, high, sampled = bands(self._stable, self.theta, self.P, logarithm, level, rng)
        size, phase = np.abs(center), np.unwrap(np.angle(center), axis=-1)
        one = _squeezed
        return FrequencyResponse(
            w, one(center), one(size), one(size * np.exp(low[0])), one(size * np.exp(high[0])), one(phase),
            one(phase + low[1]), one(phase + high[1]), float(level), period, one(sampled.any(axis=0)),
        )  # fmt: skip

    def step_response(
        self, steps: int = 50, output: int = 0, level: float = 0.95, dt: float | None = None, rng: Any = None
    ) -> StepResponse:
        """Return what one output does after a unit step of each input, with bands.

        Parameters
        ----------
        steps : int, default 50
            How many samples.
        output : int, default 0
            Which output.
        level : float, default 0.95
            Probability of the band at each time.
        dt : float, optional
            Sampling period in s. Default: that of the recording, else 1.
        rng : numpy.random.Generator or int, optional
            Where bands are sampled.

        Returns
        -------
        StepResponse

        Raises
        ------
        ValueError
            If an argument is out of range.
        """
        length, which = _checks.count("steps", steps, 1), self._output(output)
        period = (self.dt or 1.0) if dt is None else _checks.positive("dt", dt)

        def steps_of(thetas: Array) -> Array:
            found = np.empty((len(thetas), self.B.shape[1], length))
            for row, theta in zip(found, thetas, strict=True):
                A, B, C, D = self._matrices(theta)
                x = np.zeros(B.shape)
                for k in range(length):
                    row[:, k] = C[which] @ x + D[which]
                    x = A @ x + B
            return found

        center = steps_of(self.theta[None])[0]
        low, high, sampled = bands(self._stable, self.theta, self.P, steps_of, level, rng)
        one, time = _squeezed, period * np.arange(length, dtype=float)
        return StepResponse(time, one(center), one(center + low), one(center + high), float(level), one(sampled))

    # Helpers.

    @property
    def _signals(self) -> Signals:
        """How many inputs and outputs there are."""
        return Signals(self.B.shape[1], len(self.C))

    def _output(self, output: Any) -> int:
        """Return the number of an output or raise."""
        if _checks.count("output", output) >= len(self.C):
            raise ValueError(f"output: expected 0 to {len(self.C) - 1}, got {output}")
        return int(output)

    def _matrices(self, theta: Array) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D of other parameters."""
        n, (p, m) = len(self.A), self.D.shape
        ends = np.cumsum([n * n, n * m, p * n, p * m])
        D = theta[ends[2] : ends[3]].reshape(p, m) if self.structure.feedthrough else self.D
        A, B, C = np.split(theta[: ends[2]], ends[:2])
        return A.reshape(n, n), B.reshape(n, m), C.reshape(p, n), D

    def _stable(self, theta: Array) -> bool:
        """Tell whether the model is stable for other parameters."""
        return bool(np.abs(np.linalg.eigvals(self._matrices(theta)[0])).max() < 1.0)

    def _recording(self, y: Any, u: Any) -> tuple[TimeAxis, Any, Any]:
        """Return the time axis of a recording and its signals."""
        axis, y, u = recording(None, y=y, u=u)
        axis.require_period(self.dt)
        return axis, y, u

    def _checked(self, y: Any, u: Any) -> tuple[Array, Array]:
        """Return outputs, NaN where they are missing or filled, and inputs from their operating point; or raise."""
        measured = np.column_stack([fill_values(one).signal for one in measured_outputs(y, len(self.C)).T])
        return measured, recorded_input(self._signals, u, len(measured)) - self.operating_point

    def _labelled(self, axis: TimeAxis, values: Array) -> Any:
        """Return outputs on the index of the recording."""
        return values if axis.index is None else table(dict(enumerate(values.T)), axis.index)

    def _residuals(self, y: Array, u: Array) -> StateSpaceResiduals:
        """Return what gives the residuals of a recording."""
        return StateSpaceResiduals(len(self.A), [(y, u)], self.structure.feedthrough, self.structure.disturbance)

    def _packed(self, model: StateSpaceResiduals, x: Array) -> Array:
        """Return the free parameters with a start."""
        return np.concatenate((self.theta, self.level, x))

    def _ahead(self, model: StateSpaceResiduals, q: Array, u: Array, steps: int) -> Array:
        """Return the outputs predicted so many samples ahead."""
        x = model.states(q, 0)[:-1]
        for _ in range(min(steps, len(u)) - 1):
            x = np.concatenate((x[:1], x[:-1] @ self.A.T + u[:-1] @ self.B.T))
        return np.asarray(x @ self.C.T + u @ self.D.T + self.level)

    def _started(self, y: Array, u: Array, alone: bool = False) -> tuple[StateSpaceResiduals, Array]:
        """Return residuals and free parameters of a recording whose start it tells; alone: without innovations."""
        known = ~np.isnan(y)
        model = self._residuals(np.nan_to_num(y), u)
        noise = Noises(self.noise, np.tile(np.arange(len(self.C)), len(y)))
        model.weights = [np.zeros(y.shape) if alone else known.astype(float)]
        q, n, rows = self._packed(model, np.zeros(len(self.A))), len(self.A), known.ravel()
        for _ in range(1 if alone or not self.structure.disturbance else 3):
            scale = np.sqrt(noise.variance[rows])
            q[-n:] = 0.0
            J = -model.jacobian(q)[rows, -n:] / scale[:, None]
            if rows.any():
                q[-n:] = robust_regression(J, model.residuals(q)[rows] / scale)
            if not alone and self.structure.disturbance:
                model.weights = [noise.weights(model.residuals(q)).reshape(y.shape) * known]
        return model, q


def _squeezed(rows: Any) -> Any:
    """Return the only row, where there is one input."""
    return rows[0] if len(rows) == 1 else rows
