"""State-space models of several outputs: x(k+1) = A x + B u + K e, y = C x + D u + level + e.

Residuals of a state-space model and their derivatives by all entries of its matrices.

    x(k+1) = A x + B u + K w(k) e(k),   yhat = C x + D u + level,   e = y - yhat

w are weights of the residuals, 0 where y is missing: an outlier does not enter the state. The matrices are those of one
basis of the state; the derivatives along a change of basis are 0, and a search by least squares of least length leaves
the basis where it is (McKelvey, Helmersson and Ribarits, Automatica 40, 2004).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.identification.models import signals
from robust_filterpy.identification.models.noise import Noises, OutputResiduals, with_linear
from robust_filterpy.identification.models.recording import measurements
from robust_filterpy.identification.models.regressor import period
from robust_filterpy.identification.models.responses import System
from robust_filterpy.identification.models.results import Identified, signals_of
from robust_filterpy.identification.models.signals import Signals, TimeAxis

if TYPE_CHECKING:
    import control

# Derivatives of so many samples at a time.
_CHUNK: Final = 4096


class Matrices(NamedTuple):
    """A state-space model of one recording.

    Attributes
    ----------
    A, B, C, D, K : ndarray
        Its matrices; D and K are 0 where the structure has none.
    start : ndarray, shape (n,)
        State in the first sample.
    level : ndarray, shape (p,)
        What is added to y.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    K: Array
    start: Array
    level: Array


class StateSpaceResiduals(OutputResiduals):
    """Residuals of recordings of several outputs, one row of y after the other.

    The free parameters are [A, B, C, D if any, K if any, level of each recording, start of each].

    Parameters
    ----------
    n : int
        Number of states.
    recordings : list of (ndarray, shape (N, p); ndarray, shape (N, m))
        y, NaN where it is missing, and u.
    feedthrough, disturbance : bool
        Whether there is a D, and a K.
    """

    def __init__(self, n: int, recordings: list[tuple[Array, Array]], feedthrough: bool, disturbance: bool) -> None:
        """Find the place of each matrix among the parameters."""
        super().__init__([y for y, _ in recordings])
        self.recordings, self.order = [(np.nan_to_num(y), u) for y, u in recordings], n
        self.feedthrough, self.disturbance = feedthrough, disturbance
        p, m = recordings[0][0].shape[1], recordings[0][1].shape[1]
        shapes = {"A": (n, n), "B": (n, m), "C": (p, n), "D": (p, m * feedthrough), "K": (n, p * disturbance)}
        self.shapes, self.places, end = shapes, {}, 0
        for name, (rows, columns) in shapes.items():
            self.places[name] = slice(end, end + rows * columns)
            end += rows * columns
        self.inputs, self.shared = m, end
        self.n = end + len(recordings) * (p + n)
        self.weights = [(~np.isnan(y)).astype(float) for y, _ in recordings]

    def matrices(self, q: Array, i: int = -1) -> Matrices:
        """Return the matrices among free parameters, with level and start of one recording."""
        matrices = {name: q[self.places[name]].reshape(shape) for name, shape in self.shapes.items()}
        if not matrices["D"].size:
            matrices["D"] = np.zeros((self.outputs, self.inputs))
        if not matrices["K"].size:
            matrices["K"] = np.zeros((self.order, self.outputs))
        own = q[self.shared :].reshape(len(self.recordings), -1)[i]
        return Matrices(**matrices, start=own[self.outputs :], level=own[: self.outputs])

    def packed(self, matrices: Matrices, own: Array) -> Array:
        """Return free parameters, with level and start of each recording in a row."""
        parts = [getattr(matrices, name).ravel() for name, (r, c) in self.shapes.items() if r * c]
        return np.concatenate((*parts, own.ravel()))

    def is_stable(self, q: Array) -> bool:
        """Tell whether the prediction is stable; without disturbance it is the model."""
        one = self.matrices(q)
        return bool(np.abs(np.linalg.eigvals(one.A - one.K @ one.C)).max(initial=0.0) < 1.0)

    def residuals(self, q: Array) -> Array:
        """Return e of all recordings, shape (sum of N p,)."""
        return np.concatenate([self._own(q, i)[1].ravel() for i in range(len(self.recordings))])

    def jacobian(self, q: Array) -> Array:
        """Return the derivatives of the residuals, shape (sum of N p, n)."""
        return np.concatenate([self._derivatives(q, i) for i in range(len(self.recordings))])

    def states(self, q: Array, i: int) -> Array:
        """Return the states of a recording, one after the last sample too."""
        return self._own(q, i)[0]

    def _own(self, q: Array, i: int) -> tuple[Array, Array]:
        """Return states and residuals of a recording."""
        one, (y, u) = self.matrices(q, i), self.recordings[i]
        x, states = one.start, np.empty((len(y) + 1, self.order))
        forcing, measured = u @ one.B.T, y - u @ one.D.T - one.level
        weights = self.weights[i] if one.K.any() else None
        with np.errstate(over="ignore", invalid="ignore"):
            for k in range(len(y)):
                states[k] = x
                moved = one.A @ x + forcing[k]
                x = moved if weights is None else moved + one.K @ (weights[k] * (measured[k] - one.C @ x))
            states[-1] = x
            return states, measured - states[:-1] @ one.C.T

    def _derivatives(self, q: Array, i: int) -> Array:
        """Return the derivatives of the residuals of a recording."""
        one, (y, u) = self.matrices(q, i), self.recordings[i]
        states, e = self._own(q, i)
        n, p, columns = self.order, self.outputs, self._columns(i)
        S = np.zeros((n, columns.size))
        S[:, -n:] = np.eye(n)
        weighted = self.weights[i] * e
        J = np.zeros((len(y), p, self.n))
        for start in range(0, len(y), _CHUNK):
            part = slice(start, min(start + _CHUNK, len(y)))
            x = states[:-1][part]
            direct, forced = self._by_entries(p, C=x, D=u[part]), self._by_entries(n, A=x, B=u[part], K=weighted[part])
            direct[:, range(p), self.shared + np.arange(p)] = 1.0
            moved = np.empty((len(direct), n, columns.size))
            for k in range(len(direct)):
                moved[k] = S
                S = one.A @ S + forced[k]
                if one.K.any():
                    gain = one.K * self.weights[i][part][k]
                    S = S - gain @ (one.C @ moved[k] + direct[k])
            J[part][:, :, columns] = -(one.C @ moved + direct)
        return J.reshape(-1, self.n)

    def _columns(self, i: int) -> Any:
        """Return which free parameters a recording depends on."""
        own = self.shared + i * (self.outputs + self.order)
        return np.concatenate((np.arange(self.shared), np.arange(own, own + self.outputs + self.order)))

    def _by_entries(self, rows: int, **multiplied: Array) -> Array:
        """Return the derivatives of M v by the entries of each matrix M, for signals v, shape (N, rows, columns)."""
        columns = np.zeros((len(next(iter(multiplied.values()))), rows, self.shared + self.outputs + self.order))
        for name, signal in multiplied.items():
            width = self.shapes[name][1]
            for j in range(rows if width else 0):
                columns[:, j, self.places[name].start + width * j + np.arange(width)] = signal
        return columns


_AUTO = range(1, 9)
# A zero as far out is rounding of one at infinity.
_INFINITE: Final = 1e6


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

    #: No regressor comes from the caller.
    takes_phi: ClassVar[bool] = False

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


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class StateSpaceModel(System, Identified):
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
        Sampling period in s, if the index has it.
    findings : tuple of Finding
        What the recording has besides the model.
    levels : ndarray, shape (n_recordings, p)
        Level of each recording.
    orders : tuple of (int, float)
        The orders that were tried, and the information criterion of each.
    trends : tuple of (int, ndarray)
        Fingerprint of each recording whose levels break, and these, 0 at its end, shape (N, p): methods that are given
        the same y take them off it, and put them back.
    colour : float
        How many times as large standard deviations are as those of white residuals, which P counts.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    K: Array
    level: Array
    level_std: Array
    end: Array
    operating_point: Array
    levels: Array = field(default_factory=lambda: np.zeros((0, 0)))
    orders: tuple[tuple[int, float], ...] = ()

    def __repr__(self) -> str:
        """Show orders, poles and noise."""
        poles = ", ".join(f"{pole:.4g}" for pole in np.linalg.eigvals(self.A))
        std = ", ".join(f"{value:.3g}" for value in np.sqrt(self.R))
        p, m = self.D.shape
        sizes = f"n={len(self.A)}, {m} input(s), {p} output(s)"
        return f"StateSpaceModel({sizes}, poles {poles}, noise {std}){self._remarks}"

    @property
    def _rows(self) -> tuple[tuple[str, ...], Array, Array]:
        """All entries, and the levels."""
        names = tuple(f"{name}[{i},{j}]" for name, part in self._parts.items() for i, j in np.ndindex(part.shape))
        names += tuple(f"level[{j}]" for j in range(self.level.size))
        return names, np.append(self.theta, self.level), np.append(self.std, self.level_std)

    @property
    def _facts(self) -> dict[str, str]:
        """What the table says besides the entries."""
        return super()._facts | {"Largest pole": f"{np.abs(np.linalg.eigvals(self.A)).max():.4g}"}

    # The system.

    @property
    def theta(self) -> Array:
        """All entries of A, B, C, and D and K if there are any, shape (s,)."""
        return np.concatenate([part.ravel() for part in self._parts.values()])

    @property
    def _parts(self) -> dict[str, Array]:
        """The matrices that are estimated, by name, in the order of theta."""
        names = "ABC" + "D" * self.structure.feedthrough + "K" * self.structure.disturbance
        return {name: getattr(self, name) for name in names}

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

        return control.ss(self.A, self.B, self.C, self.D, period(dt, self.dt))

    @property
    def _of_poles(self) -> slice:
        """The entries of A."""
        return slice(0, self.A.size)

    def _matrices(self, theta: Array) -> dict[str, Array]:
        """Return all matrices of other parameters."""
        matrices, start = {"D": self.D, "K": self.K}, 0
        for name, part in self._parts.items():
            matrices[name] = theta[start : start + part.size].reshape(part.shape)
            start += part.size
        return matrices

    def _way(self, theta: Array, delays: Any, output: int, driven: str) -> Any:
        """Return C (zI - A)^-1 B or K of an output at each q^-1, shape (n, m)."""
        one = self._matrices(theta)
        shifted = np.eye(len(self.A)) / delays[:, None, None] - one["A"]
        B = np.broadcast_to(one[driven], (delays.size, *one[driven].shape))
        return one["C"][output] @ np.linalg.solve(shifted, B)

    def _ways(self, thetas: Array, delays: Any, output: int) -> Any:
        """Return C (zI - A)^-1 B + D."""
        each = [self._way(theta, delays, output, "B") + self._matrices(theta)["D"][output] for theta in thetas]
        return np.array([one.T for one in each])

    def _density(self, thetas: Array, delays: Any, output: int) -> Array:
        """Return that of what e of all outputs does to one, flat without a disturbance."""
        n, own = self.theta.size, np.eye(len(self.C))[output]
        each = [np.square(np.abs(self._way(theta, delays, output, "K") + own)) for theta in thetas]
        return np.log([one @ (self.R * np.exp(theta[n:])) for one, theta in zip(each, thetas, strict=True)])

    def _steps(self, thetas: Array, length: int, output: int) -> Array:
        """Return the response of the states."""
        responses = np.empty((len(thetas), self.B.shape[1], length))
        for row, theta in zip(responses, thetas, strict=True):
            one, x = self._matrices(theta), np.zeros(self.B.shape)
            for k in range(length):
                row[:, k] = one["C"][output] @ x + one["D"][output]
                x = one["A"] @ x + one["B"]
        return responses

    def _poles(self, theta: Array) -> Any:
        """Return the eigenvalues of A."""
        return np.linalg.eigvals(theta.reshape(self.A.shape)).astype(complex)

    def _zeros(self, theta: Array, input: int | None, output: int | None) -> Any:
        """Return the transmission zeros, as python-control computes them."""
        import control

        A, B, C, D = (self._matrices(theta)[name] for name in "ABCD")
        rows, columns = (slice(None) if which is None else [which] for which in (output, input))
        try:
            zeros = control.ss(A, B[:, columns], C[rows], D[rows][:, columns], True).zeros()
        except NotImplementedError:
            p, m = D.shape
            raise ValueError(
                f"zeros: expected as many outputs as inputs, got {p} and {m}, for which python-control needs slycot; "
                "install it, or name input= and output="
            ) from None
        return zeros[np.abs(zeros) < _INFINITE]

    def _stable(self, theta: Array) -> bool:
        """Tell whether the model is stable for other parameters."""
        return bool(np.abs(self._poles(theta[self._of_poles])).max() < 1.0)

    # Its outputs.

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
        axis, _, u = signals_of(self, None, u)
        signal = signals.held_input(self._signals, u, self.operating_point) - self.operating_point
        x = np.zeros(len(self.A))
        if isinstance(start, tuple) and len(start) == 2:
            _, _, began, q = self.started(*start)
            x = began.states(q, 0)[-1]
        elif _checks.option("start", start, ("rest", "continued")) == "continued":
            x = self.end
        model = self._residuals(np.zeros((len(signal), len(self.C))), signal)
        model.weights = [np.zeros((len(signal), len(self.C)))]
        output = -model.residuals(self._packed(model, x)).reshape(len(signal), -1)
        if not np.isfinite(output).all():
            raise ValueError("A: the output overflows: the model as it stands is unstable")
        return axis.labelled(output, "simulated")

    def started(
        self, y: Any, u: Any, t: Any = None, alone: bool = False
    ) -> tuple[Array, Array, StateSpaceResiduals, Array]:
        """Return a checked recording, its residuals and their free parameters, with the start that it tells."""
        _, y, u = signals_of(self, y, u, t)
        outputs = signals.measured_outputs(y, len(self.C))
        u = signals.recorded_input(self._signals, u, len(outputs))
        y, u = measurements(outputs, u)[0], u - self.operating_point
        model = self._residuals(y - signals.trend_of(self.trends, y), u)
        q, n, rows = self._packed(model, np.zeros(len(self.A))), len(self.A), model.rows
        noise = Noises(self.noise, model.which)
        if alone:
            model.weights = [np.zeros(y.shape)]
        for _ in range(1 if alone or not self.structure.disturbance else 3):
            q[-n:] = 0.0
            q = with_linear(model, q, slice(-n, None), rows, np.sqrt(noise.variance))
            if not alone and self.structure.disturbance:
                model.weights = model.believed(q, noise)
        return y, u, model, q

    # Helpers.

    @property
    def _signals(self) -> Signals:
        """How many inputs and outputs there are."""
        return Signals(self.B.shape[1], len(self.C))

    def _residuals(self, y: Array, u: Array) -> StateSpaceResiduals:
        """Return what gives the residuals of a recording."""
        return StateSpaceResiduals(len(self.A), [(y, u)], self.structure.feedthrough, self.structure.disturbance)

    def _packed(self, model: StateSpaceResiduals, x: Array) -> Array:
        """Return the free parameters with a start."""
        return np.concatenate((self.theta, self.level, x))

    def _run(self, y: Any, u: Any, t: Any, steps: int) -> tuple[TimeAxis, Any, Any]:
        """Return the time axis, measured outputs, and those so many steps ahead, or with 0 from inputs alone."""
        axis, y, u = signals_of(self, y, u, t)
        measured, signal, model, q = self.started(y, u, alone=not steps)
        x = model.states(q, 0)[:-1]
        for _ in range(min(steps, len(signal)) - 1):
            x = np.concatenate((x[:1], x[:-1] @ self.A.T + signal[:-1] @ self.B.T))
        output = x @ self.C.T + signal @ self.D.T + self.level
        return axis, measured, output + signals.trend_of(self.trends, measured)
