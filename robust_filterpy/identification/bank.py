"""TrackerBank: the parameters of many actuators of one structure, advanced together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array, numbers
from robust_filterpy.identification import _bank_setup, _model
from robust_filterpy.identification._bank_steps import (
    Past,
    all_bounded,
    all_gradients,
    all_pushed,
    all_repaired,
    all_restrained,
    all_tempering,
    are_stable,
    rowwise,
)
from robust_filterpy.identification._conditioning import SHARP
from robust_filterpy.identification._regressor import Layout
from robust_filterpy.identification.guard import GUARDS
from robust_filterpy.identification.results import Coefficients, Intervals, TrackingResult, intervals
from robust_filterpy.identification.structures import Structure
from robust_filterpy.identification.tracker import _WINDUP, GRADIENTS, ParameterTracker
from robust_filterpy.influence.functions import Influence

__all__ = ["BankResult", "BankSample", "TrackerBank"]


class BankSample(NamedTuple):
    """What one update did to each of n actuators; see `Sample`.

    Attributes
    ----------
    prediction : ndarray, shape (n,)
        phi(k)' theta(k-1), before y(k) is used (paper 22).
    residual : ndarray, shape (n,)
        y(k) - prediction (23); NaN where y is missing.
    weights : ndarray, shape (n,)
        psi(e)/e; NaN where there was no correction (y missing, or adaptation off).
    guard : ndarray of int, shape (n,)
        0: step taken as it is; h > 0: halved h times; -1: not taken.
    """

    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray


class BankResult(NamedTuple):
    """What recordings of n actuators gave: the columns of a `TrackingResult` with an axis of actuators.

    Attributes
    ----------
    theta, std : ndarray, shape (K, n, n_theta)
        Parameters and their standard deviations, after each of the K samples that were kept.
    prediction, residual, weights : ndarray, shape (K, n)
        As in `BankSample`.
    guard : ndarray of int, shape (K, n)
        As in `BankSample`.
    sample : ndarray of int, shape (K,)
        Which samples were kept.
    """

    theta: Array
    std: Array
    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray
    sample: np.ndarray

    def tracker(self, i: int) -> TrackingResult:
        """Return what actuator i gave.

        Parameters
        ----------
        i : int
            Which actuator.

        Returns
        -------
        TrackingResult
            A row for each sample that was kept.
        """
        return TrackingResult(*(column[:, i] for column in self[:6]))

    def confidence_intervals(self, level: float = 0.95) -> Intervals:
        """Return theta -+ z std for every sample that was kept, z the normal quantile of the level.

        Parameters
        ----------
        level : float, default 0.95
            Probability of the interval, in (0, 1).

        Returns
        -------
        Intervals
            lower, upper, each of shape (K, n, n_theta).
        """
        return intervals(self.theta, self.std, level)


class _Now(NamedTuple):
    """Parameters, covariances and past signals at one moment; no array in it is ever written into."""

    theta: Array
    P: Array
    past: Past


class TrackerBank:
    """Follow the parameters of n actuators of one structure; equal to a loop over n `ParameterTracker`.

    Parameters
    ----------
    n : int
        Number of actuators, >= 1.
    structure : ARX, OutputError, ARMAX, FIR or LinearRegression
        What phi is made of.
    theta : array_like, shape (n_theta,) or (n, n_theta), or float, optional
        Parameters to start from. Default: 0.
    P : array_like, shape (n_theta, n_theta) or (n, n_theta, n_theta), or float, or shape (n,), optional
        Their covariances; a number p stands for p I. Default: 100 I.
    Q : array_like, any shape that P may have, optional
        Covariance of a step of theta (paper 8). Default: 0.
    R : float, or array_like, shape (n,), optional
        Variance of the ordinary noise. Default: 1.
    F : array_like, shape (n_theta, n_theta) or (n, n_theta, n_theta), optional
        Transition matrix C of (9). Default: the identity.
    forgetting : float, or array_like, shape (n,), optional
        Forgetting factor in (0, 1].
    gradient, guard : str, or list of n str
        As in `ParameterTracker`.
    influence, scaling, information : optional
        As in `RobustKalmanFilter`, or lists of n. Actuators that choose alike are corrected together: a few different
        choices cost little, n different ones as much as a loop.

    Attributes
    ----------
    n : int
        As given.
    structure : Structure
        As given.
    Q, F : ndarray, shape (n_theta, n_theta) or (n, n_theta, n_theta)
        As given; may be changed between samples.
    R : ndarray, shape (n,), or float
        As given; may be changed between samples.

    Raises
    ------
    ValueError, TypeError
        As by `ParameterTracker`; the message names the actuators.

    Notes
    -----
    The equations, the gradient, the guard and the treatment of extremes are `ParameterTracker`'s, with an axis of
    actuators; the correction is `FilterBank`'s with H = phi' of each. The filters are always the robust ones: for the
    Kalman baseline pass ``influence=Linear()``.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import ARX
    >>> rng = np.random.default_rng(1)
    >>> gains = np.linspace(1.0, 2.0, 100)
    >>> u = rng.choice([-1.0, 1.0], 400)
    >>> y = np.zeros((400, 100))
    >>> for k in range(1, 400):
    ...     y[k] = 0.8 * y[k - 1] + gains * u[k - 1] + 0.1 * rng.normal(size=100)
    >>> y[rng.random(y.shape) < 0.01] = np.nan
    >>> bank = TrackerBank(100, ARX(1, 1), R=0.01)
    >>> result = bank.run(y, u, keep="last")
    >>> result.theta.shape, bool(np.abs(bank.coefficients.b[:, 0] - gains).max() < 0.05)
    ((1, 100, 2), True)
    """

    def __init__(
        self,
        n: int,
        structure: Structure,
        *,
        theta: ArrayLike = 0.0,
        P: ArrayLike = 100.0,
        Q: ArrayLike = 0.0,
        R: ArrayLike = 1.0,
        F: ArrayLike | None = None,
        forgetting: ArrayLike | None = None,
        gradient: str | Sequence[str] = "filtered",
        guard: str | Sequence[str] = "halve",
        influence: Influence | Sequence[Influence] | None = None,
        scaling: str | Sequence[str] | None = None,
        information: str | Sequence[str] | None = None,
    ) -> None:
        """Set up n filters and a memory at rest."""
        self.n = n = _checks.count("n", n, 1)
        if not isinstance(structure, Structure):
            raise TypeError(f"structure: expected ARX(..), OutputError(..) or another structure, got {structure!r}")
        self.structure, d = structure, structure.n_theta
        self._gradient = _bank_setup.options("gradient", gradient, n, GRADIENTS)
        self._guard = _bank_setup.options("guard", guard, n, GUARDS)
        choices = {"influence": influence, "scaling": scaling, "information": information}
        self._groups = _bank_setup.groups(n, d, choices)
        self._layout = Layout(structure)
        start = _bank_setup.parameters(structure, theta, n)
        covariance = np.array(np.broadcast_to(_bank_setup.covariances("P", P, n, d), (n, d, d)), order="C")
        self.Q = _bank_setup.covariances("Q", Q, n, d)
        self.R = _bank_setup.variances(R, n).copy()
        self.F = _bank_setup.transitions(F, n, d)
        self._forgetting = _bank_setup.factors(forgetting, n)
        self._alpha_sq = (1.0 / np.sqrt(self._forgetting)) ** 2
        self._windup = _WINDUP * np.maximum(np.trace(covariance, axis1=1, axis2=2), 1e-300)
        self._now = _Now(start, covariance, Past.at_rest(self._layout, n))
        self.enabled = True
        self._initial = self.state()

    def __repr__(self) -> str:
        """Show the size and the structure."""
        return f"TrackerBank(n={self.n}, {self.structure})"

    # The models as they stand.

    @property
    def theta(self) -> Array:
        """Parameters, shape (n, n_theta)."""
        return self._now.theta.copy()

    @property
    def P(self) -> Array:
        """Covariances of the parameters, shape (n, n_theta, n_theta)."""
        return self._now.P.copy()

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, shape (n, n_theta)."""
        return np.sqrt(np.maximum(np.einsum("ijj->ij", self._now.P), 0.0))

    @property
    def coefficients(self) -> Coefficients:
        """a, b and c of the models, each with a leading axis of n; see `Coefficients`."""
        a, b, c = _model.coefficients(self.structure, self.theta.T)
        return Coefficients(a.T, tuple(part.T for part in b) if isinstance(b, tuple) else b.T, c.T)

    @property
    def enabled(self) -> np.ndarray:
        """Which actuators adapt, bool, shape (n,); False freezes theta and P, while predictions go on.

        May be set, to one bool or to a mask, and written into.
        """
        return self._enabled

    @enabled.setter
    def enabled(self, value: bool | ArrayLike) -> None:
        mask = np.asarray(value)
        if mask.dtype != bool or mask.shape not in ((), (self.n,)):
            raise TypeError(f"enabled: expected a bool or a mask of {self.n} bools, got {value!r}")
        self._enabled = np.array(np.broadcast_to(mask, self.n))

    def predict(self, u: ArrayLike | None = None) -> Array:
        """Predict the next outputs, phi(k+1)' theta (paper 22), and change nothing.

        Parameters
        ----------
        u : array_like, shape (n,) or (n, n_inputs), optional
            The next inputs, in the forms of `update`; needed if one acts at once (nk = 0).

        Returns
        -------
        ndarray, shape (n,)

        Raises
        ------
        ValueError
            If the next input is needed and not given, or F or Q would make theta or P infinite.
        """
        layout, past = self._layout, self._now.past
        if u is None and layout.direct:
            raise ValueError(f"u: expected the next input, which acts at once in {self.structure}, got None")
        width = self.structure.n_inputs
        values = np.zeros((self.n, width)) if u is None else _bank_setup.inputs(self.structure, u, self.n)
        phi = past.regressors(layout, past.with_inputs(layout, values))
        with np.errstate(over="ignore", invalid="ignore"):
            return all_bounded(rowwise(phi, self._predicted(self._now)[0]))

    def tracker(self, i: int) -> ParameterTracker:
        """Return a tracker of one actuator that goes on where the bank is, and resets to where the bank began.

        Parameters
        ----------
        i : int
            Which actuator, from 0.

        Returns
        -------
        ParameterTracker
            Independent of the bank.

        Raises
        ------
        IndexError
            If there is no such actuator.
        TypeError
            If i is no integer.
        """
        if isinstance(i, bool) or not isinstance(i, (int, np.integer)):
            raise TypeError(f"actuator: expected an integer from 0 to {self.n - 1}, got {i!r}")
        if not 0 <= i < self.n:
            raise IndexError(f"actuator: expected 0 to {self.n - 1}, got {i}")
        start = self._row(self._initial, i)
        choices = next(group.bank._choices for group in self._groups if i in np.arange(self.n)[group.rows])
        tracker = ParameterTracker(
            self.structure,
            **{name: start[name] for name in ("theta", "P", "Q", "R", "F")},
            forgetting=float(self._forgetting[i]),
            gradient=str(self._gradient[i]),
            guard=str(self._guard[i]),
            influence=choices.influence,
            scaling=choices.scaling,
            information=choices.information,
        )
        tracker.restore(self._row(self._arrays(), i))
        return tracker

    # The recursion.

    def update(self, y: ArrayLike | None, u: ArrayLike | None = None, R: ArrayLike | None = None) -> BankSample:
        """Take one sample of every actuator: the outputs y(k) and the inputs u(k).

        Parameters
        ----------
        y : array_like, shape (n,), or None
            Measured outputs; NaN where one is missing, None if all are.
        u : array_like, shape (n,), or (n, n_inputs) for several inputs, optional
            Inputs of the same sample; a number, or shape (n_inputs,), for all actuators alike.
        R : float, or array_like, shape (n,), optional
            Variances of the noise in this sample. Default: the bank's R.

        Returns
        -------
        BankSample
            prediction, residual, weights, guard, each of shape (n,).

        Raises
        ------
        ValueError, TypeError
            If y is infinite, u not finite, R not positive or a shape wrong; no actuator has changed then.
        LinAlgError
            If a filter refuses its sample; no actuator has changed then.
        """
        outputs = _bank_setup.outputs(y, self.n, False)
        inputs = _bank_setup.inputs(self.structure, u, self.n)
        variances = _bank_setup.variances(self.R if R is None else R, self.n)
        self._now, sample = self._advance(self._now, outputs, inputs, variances)
        return sample

    def run(
        self, y: ArrayLike, u: ArrayLike | None = None, R: ArrayLike | None = None, *, keep: str | int = "all"
    ) -> BankResult:
        """Take whole recordings; the numbers are those of `update`, sample by sample.

        Parameters
        ----------
        y : array_like, shape (N, n)
            Measured outputs, N >= 1; NaN where one is missing.
        u : array_like, shape (N, n), or (N, n, n_inputs) for several inputs, optional
            Inputs; shape (N,), or (N, n_inputs), for all actuators alike.
        R : array_like, shape (N, n), or (N,) for all actuators alike, or float, optional
            Variances of the noise in each sample. Default: the bank's R.
        keep : {"all", "last"} or int, default "all"
            Which samples to return: all, the last, or every keep-th (samples keep - 1, 2 keep - 1, ..), so that
            memory is bounded.

        Returns
        -------
        BankResult
            theta, std, prediction, residual, weights, guard, with axes (samples kept, n, ..).

        Raises
        ------
        ValueError, TypeError
            If y or u is empty or not finite, R not positive, or a shape wrong; no actuator has changed then.
        LinAlgError
            If a filter refuses a sample; the message names both, and no actuator has changed then.
        """
        outputs = _bank_setup.outputs(y, self.n, True)
        length = len(outputs)
        signal = _bank_setup.inputs(self.structure, u, self.n, length)
        noise = _bank_setup.recorded_variances(self.R, R, self.n, length)
        every = _every(keep, length)
        kept = np.arange(every - 1, length, every)
        theta, variance = np.empty((2, kept.size, self.n, self._layout.n))
        prediction, residual, weights = np.empty((3, kept.size, self.n))
        guard = np.empty((kept.size, self.n), dtype=np.int64)
        now, k = self._now, 0
        try:
            for k in range(length):
                now, sample = self._advance(now, outputs[k], signal[k], noise[k])
                at, due = divmod(k + 1, every)
                if due == 0:
                    prediction[at - 1], residual[at - 1], weights[at - 1], guard[at - 1] = sample
                    theta[at - 1], variance[at - 1] = now.theta, np.einsum("ijj->ij", now.P)
        except (ValueError, TypeError, np.linalg.LinAlgError) as error:
            error.args = (f"sample {k}: {error}", *error.args[1:])
            raise
        self._now = now
        return BankResult(theta, np.sqrt(np.maximum(variance, 0.0)), prediction, residual, weights, guard, kept)

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")
    def _advance(self, now: _Now, y: Array, u: Array, R: Array) -> tuple[_Now, BankSample]:
        """Return what one checked sample makes of now; changes nothing."""
        layout, past, known = self._layout, now.past, y == y
        inputs = past.with_inputs(layout, u)
        phi = past.regressors(layout, inputs)
        theta, P = self._predicted(now)
        prediction = rowwise(phi, theta)
        G, filtered, gradients = self._gain_regressor(phi, theta, past.gradients)
        theta, P, weights = self._corrected(theta, P, G, filtered, y, prediction, R)
        events, free = np.zeros(self.n, dtype=np.int64), (self._guard == "none") | ~self._enabled
        if layout.part is not None and not free.all():
            theta, events = all_restrained(theta, now.theta, layout.part, free, self._guard == "halve")
        after = rowwise(phi, theta)
        outputs, residuals = past.outputs, past.residuals
        if self.structure.uses_model_output:
            outputs = all_pushed(outputs, -all_bounded(after))
        elif layout.na:
            outputs = all_pushed(outputs, -np.where(known, y, all_bounded(prediction)))
        if layout.nc:
            residuals = all_pushed(residuals, np.where(known, all_bounded(y - after), 0.0))
        after_all = _Now(theta, P, Past(outputs, inputs, residuals, gradients))
        return after_all, BankSample(prediction, y - prediction, weights, events)

    def _predicted(self, now: _Now) -> tuple[Array, Array]:
        """Return theta and P one step on (paper 8), where adaptation is on and P has not wound up."""
        theta, P, d = now.theta, now.P, self._layout.n
        F, Q = (_bank_setup.matrices(name, getattr(self, name), self.n, d) for name in "FQ")
        drifts, forgets = bool(Q.any()), self._alpha_sq != 1.0
        if F.ndim == 3 or not np.array_equal(F, np.eye(d)):
            theta, P = (F @ theta[:, :, None])[:, :, 0], F @ P @ np.swapaxes(F, -1, -2)
        elif not (drifts or forgets.any()):
            return theta, P
        moves = self._enabled
        if forgets.any():
            moves = moves & (~forgets | (np.einsum("ijj->i", now.P) <= self._windup))
            P = P * self._alpha_sq[:, None, None]
        if drifts:
            P = P + Q
        if not moves.all():
            theta = np.where(moves[:, None], theta, now.theta)
            P = np.where(moves[:, None, None], P, now.P)
        if not np.isfinite(theta.sum() + P.sum()):
            finite = np.isfinite(theta).all(axis=1) & np.isfinite(P).all(axis=(1, 2))
            _bank_setup.require("predict: expected finite theta and P, got NaN or infinity; check Q and F", finite)
        return theta, P

    def _gain_regressor(self, phi: Array, theta: Array, past: Array) -> tuple[Array, np.ndarray, Array]:
        """Return what the gain of each actuator is computed from, whether it is not phi, and the past with it."""
        filtered = self._gradient == "filtered"
        if self._layout.part is None or not filtered.any():
            return phi, np.zeros(self.n, dtype=bool), past
        coefficients = theta[:, self._layout.part]
        G, usable = all_gradients(phi, coefficients, past), filtered
        free = self._guard == "none"
        if free.any():
            usable = filtered & (~free | are_stable(coefficients))
        if not usable.all():
            G = np.where(usable[:, None], G, phi)
        moved = all_pushed(past, G)
        return G, filtered, moved if filtered.all() else np.where(filtered[:, None, None], moved, past)

    def _corrected(
        self, theta: Array, P: Array, G: Array, filtered: np.ndarray, y: Array, prediction: Array, R: Array
    ) -> tuple[Array, Array, Array]:
        """Return theta, P and psi(e)/e after the measurements that are there."""
        taken = (y == y) & self._enabled
        if not taken.any():
            return theta, P, np.full(self.n, np.nan)
        square, trace = rowwise(G, G), np.einsum("ijj->i", P)
        sharp = taken & (square * trace > SHARP * R)
        factor, apart, target = np.ones(self.n), filtered, y
        if sharp.any():
            factor = all_tempering(square, trace, R)
            G, apart = G * factor[:, None], filtered | (factor < 1.0)
        if apart.any():
            # So that the filter's own innovation, target - G theta, is y - phi' theta.
            target = np.where(apart, (y - prediction) * factor + rowwise(G, theta), y)
        target = np.where(taken, target, np.nan)
        _bank_setup.require("theta: expected finite predictions, got infinity", ~taken | (np.abs(target) < np.inf))
        moved, left, weights = np.empty_like(theta), np.empty_like(P), np.empty(self.n)
        for rows, bank in self._groups:
            bank.x, bank.P, bank.H, bank.R = theta[rows], P[rows], G[rows][:, None], R[rows][:, None, None]
            try:
                bank.update(target[rows][:, None])
            except (ValueError, np.linalg.LinAlgError) as error:
                error.args = (_renamed(str(error), np.arange(self.n)[rows]), *error.args[1:])
                raise
            moved[rows], left[rows], weights[rows] = bank.x, bank.P, bank.weights[:, 0]
        if sharp.any():
            left[sharp] = all_repaired(left[sharp])
        return moved, left, weights

    # Interruption.

    def state(self) -> dict[str, Array]:
        """Return everything the recursion needs to go on, as plain arrays.

        Returns
        -------
        dict of str to ndarray
            What `ParameterTracker.state` returns, with a leading axis of n; Q and F without it if they are shared.
            ``numpy.savez(file, **state)`` stores it.
        """
        return {name: np.array(value, order="C") for name, value in self._arrays().items()}

    def restore(self, state: Any) -> None:
        """Go back to a state of this bank, or of another one with the same n and structure.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `state`, or what ``numpy.load`` makes of a file that holds it.

        Raises
        ------
        ValueError
            If an array is missing, does not fit or is not finite, a variance is not positive, P not positive
            semidefinite, or a model unstable that the guard keeps stable; nothing has changed then.
        TypeError
            If state is no mapping.

        Notes
        -----
        The continuation is the same to the last bit.
        """
        found = _bank_setup.checked_state(state, self._layout, self.n, self._guard != "none")
        self._now = _Now(found["theta"], found["P"], Past(*(found[name] for name in Past._fields)))
        self._enabled, self._alpha_sq = found["enabled"], found["alpha_sq"]
        self.Q, self.R, self.F = found["Q"], found["R"], found["F"]

    def reset(self) -> None:
        """Go back to the start: theta, P, Q, R, F and the memory as they were when the bank was made."""
        self.restore(self._initial)

    def _arrays(self) -> dict[str, Array]:
        """Return the arrays of `state`, not copied."""
        theta, P, past = self._now
        arrays = {"theta": theta, "P": P, **past._asdict(), "enabled": self._enabled}
        # What a user sets may be a list.
        arrays |= {name: numbers(name, getattr(self, name)) for name in "QF"}
        return arrays | {"R": np.broadcast_to(self.R, self.n), "alpha_sq": self._alpha_sq}

    def _row(self, state: dict[str, Array], i: int) -> dict[str, Array]:
        """Return the state of one actuator's tracker."""
        row = {name: value if name in ("Q", "F") and value.ndim == 2 else value[i] for name, value in state.items()}
        return {**row, "R": np.reshape(row["R"], (1, 1))}


def _every(keep: Any, length: int) -> int:
    """Return which samples to keep: each of how many."""
    if isinstance(keep, str):
        return 1 if _checks.option("keep", keep, ("all", "last")) == "all" else length
    return _checks.count("keep", keep, 1)


def _renamed(message: str, rows: np.ndarray) -> str:
    """Return the message of a `FilterBank` with its filter's number as an actuator's."""
    head, colon, rest = message.partition(": ")
    word, _, number = head.partition(" ")
    return f"actuator {rows[int(number)]}: {rest}" if colon and word == "filter" and number.isdigit() else message
