"""TrackerBank: the parameters of many actuators of one structure, advanced together."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks, _state
from robust_filterpy._brief import brief, lines_of
from robust_filterpy._checks import Array, numbers
from robust_filterpy._fill_values import fill_values
from robust_filterpy._progress import stages
from robust_filterpy._warning import warn
from robust_filterpy.correction.options import Information, Scaling
from robust_filterpy.identification.models import regressor as coefficients
from robust_filterpy.identification.models.regressor import Guard
from robust_filterpy.identification.models.results import Columns, Intervals, TrackingResult, intervals
from robust_filterpy.identification.models.signals import recording, table
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive import setup, track
from robust_filterpy.identification.recursive.recursion import Form, Gradient, Regressor, at_rest
from robust_filterpy.identification.recursive.tracker import ParameterTracker
from robust_filterpy.influence.functions import Influence
from robust_filterpy.kernel.series import plain

__all__ = ["BankResult", "BankSample", "TrackerBank"]

# Numbers in phi that are worked on at once.
_CHUNK = 1_000_000


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

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class _Recorded(NamedTuple):
    """The columns of a `BankResult`; see there."""

    theta: Array
    std: Array
    prediction: Array
    residual: Array
    weights: Array
    guard: np.ndarray
    sample: np.ndarray


class BankResult(_Recorded):
    """What recordings of n actuators gave: the columns of a `TrackingResult` with an axis of actuators.

    A tuple of its first seven attributes.

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
    names : tuple of str, length n_theta
        Names of the parameters.
    actuators : tuple, length n
        The columns of y if it was a pandas DataFrame, otherwise 0, 1, ..
    index : pandas.Index or None
        When the samples that were kept were taken, if the recording was a pandas object.
    """

    names: tuple[str, ...] = ()
    actuators: tuple[Any, ...] = ()
    index: Any = None

    __str__ = brief

    def to_frame(self) -> Any:
        """Return all columns as a pandas DataFrame, a row for each sample that was kept.

        Returns
        -------
        pandas.DataFrame
            Columns (actuator, quantity), the quantities as in `TrackingResult.to_frame`.

        Raises
        ------
        ImportError
            If pandas is not installed.
        """
        actuators = self.actuators or tuple(range(self.theta.shape[1]))
        columns = {
            (actuator, name): column
            for i, actuator in enumerate(actuators)
            for name, column in self.tracker(i).columns().items()
        }
        return table(columns, self.sample, "sample") if self.index is None else table(columns, self.index)

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
        return TrackingResult(*(column[:, i] for column in self[:6])).labelled(self.names, self.index)

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


class TrackerBank(track.Following):
    """Follow the parameters of n actuators of one structure; equal to a loop over n `ParameterTracker`.

    Parameters
    ----------
    n : int
        Number of actuators, >= 1.
    structure : Structure
        What phi is made of: ARX(..), OutputError(..) ..
    theta : array_like, shape (n_theta,) or (n, n_theta), or float, optional
        Parameters to start from. Default: found by the start; 0 with ``start=0``.
    P : array_like, shape (n_theta, n_theta) or (n, n_theta, n_theta), or float, or shape (n,), optional
        Their covariances; a number p stands for p I. Default: found by the start; 100 I with
        ``start=0``.
    Q : array_like, any shape that P may have, optional
        Covariance of a step of theta (paper 8). Default: 0.
    R : float, or array_like, shape (n,), optional
        Variance of the ordinary noise. Default: found from the data and followed. Setting the attribute fixes it.
    F : array_like, shape (n_theta, n_theta) or (n, n_theta, n_theta), optional
        Transition matrix C of (9). Default: the identity.
    forgetting : float, or array_like, shape (n,), optional
        Forgetting factor in (0, 1].
    start : int, optional
        How many samples may be looked at for a model of each actuator, as in `ParameterTracker`. Default: 400, or 0 if
        theta or P is given.
    offset : bool, optional
        Whether there is a constant; default as in `ParameterTracker`.
    regressor, R_memory
        As in `ParameterTracker`.
    gradient, guard : str, or list of n str
        As in `ParameterTracker`.
    influence, scaling, information : optional
        As in `RobustKalmanFilter`, or lists of n.

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

    Warns
    -----
    LostTrackerWarning, StuckSensorWarning
        As `ParameterTracker`; the message names the actuators.

    Notes
    -----
    Everything is `ParameterTracker`'s, by the kernel for all actuators where that serves
    (`robust_filterpy.kernel`), otherwise one actuator after the other. The filters are always the robust
    ones: for the Kalman baseline pass ``influence=Linear()``.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.identification import ARX
    >>> rng = np.random.default_rng(1)
    >>> gains = np.linspace(1.0, 2.0, 5)
    >>> u = rng.choice([-1.0, 1.0], 400)
    >>> y = np.zeros((400, 5))
    >>> for k in range(1, 400):
    ...     y[k] = 0.8 * y[k - 1] + gains * u[k - 1] + 0.1 * rng.normal(size=5)
    >>> y[rng.random(y.shape) < 0.01] = np.nan
    >>> bank = TrackerBank(5, ARX(1, 1), R=0.01)
    >>> result = bank.run(y, u, keep="last")
    >>> result.theta.shape, bool(np.abs(bank.coefficients.b[:, 0] - gains).max() < 0.05)
    ((1, 5, 2), True)
    """

    _name = "TrackerBank"

    def __init__(
        self, n: int, structure: Structure, *, theta: ArrayLike | None = None, P: ArrayLike | None = None,
        Q: ArrayLike | None = None, R: ArrayLike | None = None, F: ArrayLike | None = None,
        forgetting: ArrayLike | None = None, start: int | None = None, offset: bool | None = None,
        regressor: Regressor | None = None, R_memory: int = 150,
        gradient: Gradient | Sequence[Gradient] = "filtered", guard: Guard | Sequence[Guard] = "halve",
        influence: Influence | Sequence[Influence] | None = None, scaling: Scaling | Sequence[Scaling] | None = None,
        information: Information | Sequence[Information] | None = None,
    ) -> None:  # fmt: skip
        """Set up n filters and a memory at rest; so many arguments, since they are those of a `ParameterTracker`."""
        given = {name: value for name, value in locals().items() if name not in ("self", "n", "structure")}
        self.n = n = _checks.count("n", n, 1)
        if not isinstance(structure, Structure):
            raise TypeError(f"structure: expected ARX(..), OutputError(..) or another structure, got {structure!r}")
        self.structure = structure
        # Every actuator is a tracker; one stands for all where they have their options in common.
        own, options = setup.of_each(n, given)
        trackers = setup.for_each(lambda each: ParameterTracker(structure, **each), options)
        one, alike = trackers[0], np.arange(n) % len(trackers)
        self._regressor = one.regressor
        form, forms = one.form, [tracker.form for tracker in trackers]
        words = (np.concatenate([getattr(each, name) for each in forms])[alike] for name in ("gradient", "guard"))
        self.form = Form.of(structure, form.layout, form.has_offset, form.cleans, form.judges, *words)
        # The kernel takes what all have in common once.
        self.Q, self.F = (
            np.stack([getattr(tracker, name) for tracker in trackers]) if name in own else getattr(one, name)
            for name in "QF"
        )
        several = own & {"influence", "scaling", "information"}
        self._choices = tuple(tracker._filter.choices for tracker in (trackers if several else [one]))
        self._alpha_sq = np.array([vars(tracker._filter)["_alpha_sq"] for tracker in trackers])[alike]
        self._made: Any = None
        theta, P, scale = (
            np.concatenate([getattr(tracker.now, name) for tracker in trackers])[alike]
            for name in ("theta", "P", "scale")
        )
        self._now = at_rest(self.form, theta, P, scale, int(one.now.samples[0]), bool(one.now.begun[0]))
        self.enabled = True
        self._first, self._initial = self._now, self.state()

    def __repr__(self) -> str:
        """Show the size and the structure."""
        return f"TrackerBank(n={self.n}, {self.structure})"

    def __str__(self) -> str:
        """Show where the models stand as well."""
        return "\n".join([repr(self), *lines_of({"theta": self.theta, "std": self.std, "R": self.R})])

    # The models as they stand.

    @property
    def theta(self) -> Array:
        """Parameters, shape (n, n_theta)."""
        return self._now.theta[:, self.form.own]

    @property
    def P(self) -> Array:
        """Covariances of the parameters, shape (n, n_theta, n_theta)."""
        return self._now.P[:, self.form.own[:, None], self.form.own]

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, shape (n, n_theta); infinite until the start has found a model."""
        std = np.sqrt(np.maximum(np.einsum("ijj->ij", self._now.P), 0.0))[:, self.form.own]
        return np.where(self._now.begun[:, None], std, np.inf)

    @property
    def R(self) -> Array:
        """Variances of the ordinary noise, as they are followed, shape (n,); may be set, and are then not followed."""
        return self._now.scale[:, 0].copy()

    @R.setter
    def R(self, value: ArrayLike) -> None:
        scale = self._now.scale.copy()
        scale[:, 0], scale[:, 3] = setup.variances(value, self.n), 0.0
        self._now = self._now._replace(scale=scale)

    @property
    def offset(self) -> Array:
        """Constants of the equations, shape (n,); see `ParameterTracker`."""
        return np.array([self.tracker(i).offset for i in range(self.n)])

    @property
    def coefficients(self) -> Any:
        """a, b and c of the models, or b, f, c and d, each with a leading axis of n; see `ParameterTracker`."""
        values = coefficients.coefficients(self.structure, self.theta.T)
        return type(values)(*(tuple(p.T for p in part) if isinstance(part, tuple) else part.T for part in values))

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
        setup.require_next_input(self.structure, u)
        width = self.structure.n_inputs
        values = np.zeros((self.n, width)) if u is None else setup.inputs(self.structure, u, self.n)
        return track.predicted(self.form, self._using(None), self._now, values)

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
        chosen = self._choices[i if len(self._choices) > 1 else 0]
        tracker = ParameterTracker(
            self.structure, start=0, offset=self.form.has_offset, regressor=self._regressor,
            gradient=cast(Gradient, str(self.form.gradient[i])), guard=cast(Guard, str(self.form.guard[i])),
            influence=chosen.influence, scaling=chosen.scaling, information=chosen.information,
        )  # fmt: skip
        initial, now = (whole.rows(np.array([i])) for whole in (self._first, self.now))
        tracker.go_on(self._settings(i), initial, now, bool(self._enabled[i]))
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
        outputs = setup.outputs(y, self.n, False)
        inputs = setup.inputs(self.structure, u, self.n)
        variances = None if R is None else setup.variances(R, self.n)[:, None]
        signals = outputs[:, None], inputs[:, None], variances
        now, out, news, _ = track.step(self.form, self._using(None), self._now, *signals)
        self._say(news)
        self._now = now
        return BankSample(*(column[:, 0] for column in out[2:]))

    def run(
        self,
        y: ArrayLike,
        u: ArrayLike | None = None,
        R: ArrayLike | None = None,
        *,
        keep: str | int = "all",
        progress: bool | None = None,
    ) -> BankResult:
        """Take whole recordings; the numbers are those of `update`, sample by sample.

        Parameters
        ----------
        y : array_like, shape (N, n)
            Measured outputs, N >= 1; NaN where one is missing. A pandas DataFrame has the index of u, in equal steps.
        u : array_like, shape (N, n), or (N, n, n_inputs) for several inputs, optional
            Inputs; shape (N,), or (N, n_inputs), for all actuators alike.
        R : array_like, shape (N, n), or (N,) for all actuators alike, or float, optional
            Variances of the noise in each sample. Default: the bank's R.
        keep : {"all", "last"} or int, default "all"
            Which samples to return: all, the last, or every keep-th (samples keep - 1, 2 keep - 1, ..), so that
            memory is bounded.
        progress : bool, optional
            Say on standard error what it is at: True at once, False never, None from 2 s on.

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

        Warns
        -----
        UserWarning
            If outputs have fill values, which are taken for missing as in `ParameterTracker.run`; it names them.
        """
        columns_of_y = getattr(y, "columns", None)
        axis, y, u, R = recording(self.structure, y=y, u=u, R=R)
        fills = [fill_values(column) for column in setup.outputs(y, self.n, True).T]
        outputs = np.column_stack([fill.signal for fill in fills])
        actuators = tuple(range(self.n) if columns_of_y is None else columns_of_y)
        length = len(outputs)
        signal = setup.inputs(self.structure, u, self.n, length)
        noise = None if R is None else setup.variances(R, self.n, length)
        every = _every(keep, length)
        rows = np.arange(every - 1, length, every)
        columns = Columns.empty(rows.size, self.n, self.form.layout.n)
        now, k, said = self._now, 0, []
        while k < length:
            chunk = slice(k, min(k + max(1, _CHUNK // (self.n * self.form.layout.n)), length))
            R = None if noise is None else noise[chunk].T
            with stages("TrackerBank", progress):
                now, out, news = track.advance(
                    self.form, self._using(k), now, outputs[chunk].T, signal[chunk].swapaxes(0, 1), R
                )
            said += news
            due = np.flatnonzero((rows >= k) & (rows < chunk.stop))
            for column, part in zip(columns, out, strict=True):
                column[due] = part[:, rows[due] - k].swapaxes(0, 1)
            k = chunk.stop
        theta, variance, prediction, residual, weights, guard = columns
        std = np.sqrt(np.maximum(variance[..., self.form.own], 0.0))
        result = BankResult(theta[..., self.form.own], std, prediction, residual, weights, guard, rows)
        result.names, result.index = self.structure.names, None if axis.index is None else axis.index[rows]
        result.actuators = actuators
        self._say(said)
        filled = [f"{name}: {fill.said}" for name, fill in zip(actuators, fills, strict=True) if fill.values]
        if filled:
            warn(f"TrackerBank: y has fill values, by actuator {'; '.join(filled)}", UserWarning)
        self._now = now
        return result

    def _using(self, first: int | None) -> track.Settings:
        """Return what may have been changed since the last call; first: number of its first sample, None for one."""

        def place(k: int, i: int) -> str:
            return f"actuator {i}: " if first is None else f"sample {first + k}: actuator {i}: "

        key = [(a.shape, a.tobytes()) for a in (numbers("F", self.F), numbers("Q", self.Q))]
        if self._made is None or self._made[0] != key:
            # What a sample depends on is made anew where something else has been set, in place too.
            F, Q = (plain(self._matrices(name))[:, None] for name in "FQ")
            self._made = key, (track.rules_of(self._choices), F, Q)
        rules, F, Q = self._made[1]
        return track.Settings(rules, F, Q, self._alpha_sq, self._enabled, self._filter, place)

    def _filter(self, i: int) -> Any:
        """Return a filter of one actuator, for the definition."""
        chosen = self._choices[i if len(self._choices) > 1 else 0]
        choices = {name: getattr(chosen, name) for name in ("influence", "scaling", "information")}
        kf = setup.make_filter(self.form.layout.n, None, choices)
        setup.apply_settings(kf, self._settings(i))
        return kf

    def _settings(self, i: int) -> dict[str, Array]:
        """Return Q, F and alpha_sq of one actuator's filter."""
        matrices = {name: self._matrices(name) for name in "QF"}
        whole = {name: value[i if len(value) > 1 else 0] for name, value in matrices.items()}
        return {**whole, "alpha_sq": np.array(self._alpha_sq[i])}

    def _named(self, which: list[int]) -> str:
        """Return some actuators as a message begins with them."""
        return f"{setup.actuators(np.isin(np.arange(self.n), which))}: "

    def _matrices(self, name: str) -> Array:
        """Return F or Q, which the user may have changed, with the axis (1 or n) in front."""
        own, size = self.form.own, self.form.layout.n
        values = setup.matrices(name, getattr(self, name), self.n, len(own))
        values = values[None] if values.ndim == 2 else values
        if size == len(own):
            return values
        # The constant stays.
        whole = np.tile(np.eye(size) if name == "F" else np.zeros((size, size)), (len(values), 1, 1))
        whole[:, own[:, None], own] = values
        return whole

    # Interruption.

    def state(self) -> dict[str, Array]:
        """Return everything the recursion needs to go on, as plain arrays.

        Returns
        -------
        dict of str to ndarray
            What `ParameterTracker.state` returns, with a leading axis of n but for ``format``; Q and F without it if
            they are shared.
            ``numpy.savez(file, **state)`` stores it.
        """
        settings = {**self._set_by_hand(), "enabled": self._enabled, "R": self._now.scale[:, 0]}
        return _state.labelled(self.kind, {**self.now.arrays(), **settings})

    def _set_by_hand(self) -> dict[str, Any]:
        """Return what the user may have set; a list as well."""
        return {"alpha_sq": self._alpha_sq, **{name: numbers(name, getattr(self, name)) for name in "QF"}}

    def _go_back(self, state: Any) -> None:
        """Take over a state, or raise; nothing has changed then."""
        _state.require_kind(state, self.kind)
        stored = setup.checked_state(state, self.form, self.n)
        self._now = self._now.restored(stored, stored["R"])
        self._enabled, self._alpha_sq = stored["enabled"], stored["alpha_sq"]
        self.Q, self.F = stored["Q"], stored["F"]


def _every(keep: Any, length: int) -> int:
    """Return which samples to keep: each of how many."""
    if isinstance(keep, str):
        return 1 if _checks.option("keep", keep, ("all", "last")) == "all" else length
    return _checks.count("keep", keep, 1)
