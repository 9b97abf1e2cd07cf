"""What `ParameterTracker` and `TrackerBank` are: n actuators whose parameters are followed, a tracker's with n = 1."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks, _state
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import FillValues
from robust_filterpy._progress import stages
from robust_filterpy._warning import warn
from robust_filterpy.correction.options import Information, Scaling
from robust_filterpy.identification.models.model import Model
from robust_filterpy.identification.models.regressor import GUARDS, Guard, Layout
from robust_filterpy.identification.models.results import Sample, TrackingResult
from robust_filterpy.identification.models.signals import TimeAxis
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive import recursion, setup, track
from robust_filterpy.identification.recursive.recursion import GRADIENTS, REGRESSORS, Form, Gradient, Regressor, State
from robust_filterpy.identification.recursive.watch import News
from robust_filterpy.influence.functions import Influence

#: Samples that a tracker looks at before it takes a stand: OutputError(4, 4) with 10 % outliers needs about as many.
START = 400

_Kind = TypeVar("_Kind", bound="Following")
# What a user sets, by its name in a state, and as the user gave it.
_BY_HAND = {"Q": "Q", "F": "F", "alpha_sq": "forgetting"}


def _matrix(name: str, doc: str) -> Any:
    """Return a property that reads and sets the part of a matrix that is theta's."""

    def read(self: Following) -> Array:
        own = self.form.own
        values = np.asarray(self._alone(self._now.settings[name][:, own[:, None], own]))
        # What is written into a copy would be lost without a word.
        values.flags.writeable = False
        return values

    return property(read, lambda self, value: self._set(**{name: value}), doc=doc)


class Following:
    """n actuators whose parameters are followed; they can go back to a state or the start."""

    structure: Structure
    n: int = 1
    form: Form
    #: Of the recording, for a tracker.
    dt: float | None = None
    _name: ClassVar[str] = "ParameterTracker"
    _now: State
    _enabled: np.ndarray
    _initial: dict[str, Array]
    #: What the kernel is to do of each, with who learns: the same array until that changes.
    _flags: np.ndarray
    _learning: bytes = b""
    #: The last time that a recording had, and how many samples came after it.
    _time: tuple[Any, int] | None = None

    def __init__(
        self, structure: Structure | Model, *, filter: Any = None, theta: ArrayLike | None = None,
        P: ArrayLike | None = None, Q: ArrayLike | None = None, R: ArrayLike | None = None, F: ArrayLike | None = None,
        forgetting: ArrayLike | None = None, start: int | None = None, offset: bool | None = None,
        regressor: Regressor | None = None, R_memory: int = 150, gradient: Gradient = "filtered",
        guard: Guard = "halve", influence: Influence | None = None, scaling: Scaling | None = None,
        information: Information | None = None,
    ) -> None:  # fmt: skip
        """Set up the filter and memories at rest; so many arguments, since each is one of a model's or a filter's."""
        given = {"theta": theta, "P": P, "Q": Q, "R": R, "F": F, "forgetting": forgetting}
        model = structure if isinstance(structure, Model) else None
        self.structure = structure = setup.structure_of(structure)
        _checks.option("gradient", gradient, GRADIENTS)
        _checks.option("guard", guard, GUARDS)
        ready = filter is not None and not isinstance(filter, type)
        warm = theta is not None or P is not None or ready or model is not None
        samples = (0 if warm else START) if start is None else _checks.count("start", start)
        if samples and warm:
            raise ValueError(f"start: expected 0 with theta, P or a filter object or model to begin with, got {start}")
        default: Regressor = "cleaned" if samples or model is not None else "measured"
        judges = "cleaned" == (default if regressor is None else _checks.option("regressor", regressor, REGRESSORS))
        has_offset = setup.has_offset(offset, structure, model, bool(samples))
        layout = Layout(structure.with_constant(), structure.n_inputs) if has_offset else Layout(structure)
        cleans = judges and structure.na + structure.nd > 0
        own = np.delete(np.arange(layout.n), [structure.constant_place] if has_offset else [])
        flags = np.array([gradient == "filtered", GUARDS.index(guard), cleans, True, judges], dtype=np.intp)
        choices = {"influence": influence, "scaling": scaling, "information": information}
        kf = setup.make_filter(layout.n, filter, choices)
        self.form = Form(structure, layout, own, has_offset, cleans, judges, flags, kf, track.rules_of(kf))
        memory = 0.0 if R is not None or ready else float(_checks.count("R_memory", R_memory, 2))
        now = recursion.at_rest(self.form, samples or START, not samples, memory)
        if model is not None:
            now, self.dt = track.gone_on(self.form, now, 0, model), model.dt
        self._enabled, self._flags = np.ones(self.n, dtype=bool), np.tile(flags, (self.n, 1))
        now = setup.with_given(self.form, now.rows(np.zeros(self.n, dtype=int)), given)
        setup.require_stable(self.form, now.theta[:, own])
        self._now = now.with_parts(windup=recursion.WINDUP * np.maximum(np.einsum("ijj->i", now.P), 1e-300))
        if ready and Q is None:
            setup.warn_of_default_noise(kf)
        self._initial = self.state()

    Q = _matrix(
        "Q", "Covariance of a step of theta (paper 8), shape (d, d), of a bank (n, d, d); may be set, to q for q I."
    )
    F = _matrix("F", "Transition matrix C of (9), shape (d, d), of a bank (n, d, d); may be set.")

    def _set(self, **given: Any) -> None:
        """Set what is given, or raise; nothing has changed then."""
        self._now = setup.with_given(self.form, self._now, given)

    def _alone(self, values: Any) -> Any:
        """Return what actuators have, of a tracker that of its one."""
        return values

    def _named(self, which: list[int]) -> str:
        """Return some actuators as a message begins with them."""
        return ""

    def _sample(self, rows: Array) -> Sample:
        """Return what a sample gave, rows of prediction, residual, weight and guard."""
        prediction, residual, weight, guard = rows.T
        return Sample(prediction, residual, weight, guard.astype(np.int64))

    def _place_alone(self, k: int, i: int) -> str:
        """Return how an error names an actuator where there is one sample."""
        return self._named([i])

    def _place(self, k: int, i: int) -> str:
        """Return how an error names a sample of an actuator."""
        return f"sample {k}: {self._named([i])}"

    def _like(self, kind: type[_Kind], which: np.ndarray) -> _Kind:
        """Return some of the actuators as they stand, one of them several times too."""
        part = object.__new__(kind)
        own = {"n": len(which), "_now": self.now.rows(which), "_enabled": self._enabled[which]}
        vars(part).update({**vars(self), **own, "_flags": self._flags[which]})
        return part

    # The models as they stand.

    @property
    def now(self) -> State:
        """Everything that the recursion goes on from, with an axis of actuators in front."""
        return track.settled(self.form, self._now)[0]

    @property
    def regressor(self) -> Regressor:
        """Which outputs phi holds: "measured" or "cleaned"."""
        return REGRESSORS[self.form.judges]

    @property
    def kind(self) -> str:
        """What a state belongs to."""
        return f"{self._name} of {self.structure}"

    @property
    def theta(self) -> Array:
        """Parameters, shape (d,), of a bank (n, d)."""
        return np.asarray(self._alone(self._now.theta[:, self.form.own]))

    @property
    def P(self) -> Array:
        """Covariance of the parameters, shape (d, d), of a bank (n, d, d)."""
        return np.asarray(self._alone(self._now.P[:, self.form.own[:, None], self.form.own]))

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, of theta's shape; infinite until the start has found a model."""
        std = np.sqrt(np.maximum(np.einsum("ijj->ij", self._now.P), 0.0))[:, self.form.own]
        return np.asarray(self._alone(np.where(self._now.begun[:, None], std, np.inf)))

    @property
    def R(self) -> Any:
        """Variance of the ordinary noise, of a bank shape (n,), as it is followed; may be set, and is then not."""
        return self._alone(self._now.scale[:, 0].copy())

    @R.setter
    def R(self, value: ArrayLike) -> None:
        self._set(R=value)

    @property
    def forgetting(self) -> Any:
        """Forgetting factor, in (0, 1], of a bank shape (n,); may be set."""
        return self._alone(1.0 / self._now.settings["alpha_sq"])

    @forgetting.setter
    def forgetting(self, value: ArrayLike) -> None:
        self._set(forgetting=value)

    @property
    def offset(self) -> Any:
        """Constant of the equation: what an OutputError, FIR or LinearRegression adds to the output; 0 without one."""
        a, f, constant = self._at_rest
        return self._alone(self._now.part("centre") * a + _over(constant, f))

    @property
    def level(self) -> Any:
        """What the output is at rest; the center that was taken off y if the model integrates."""
        a, f, constant = self._at_rest
        return self._alone(self._now.part("centre") + _over(constant, a * f))

    @property
    def _at_rest(self) -> tuple[Array, Array, Array]:
        """A(1), F(1) and the constant in phi' theta, for outputs from the center."""
        theta, places = self._now.theta, self.structure.polynomials
        a, f = (1.0 + theta[:, self.form.own[part]].sum(axis=1) for part in (places.a, places.f))
        constant = theta[:, self.structure.constant_place] if self.form.has_offset else np.zeros(self.n)
        return a, f, constant

    @property
    def enabled(self) -> Any:
        """False freezes theta and P, while predictions go on; of a bank a mask, shape (n,), that may be written into.

        May be set, to one bool or to a mask.
        """
        return self._alone(self._enabled)

    @enabled.setter
    def enabled(self, value: bool | ArrayLike) -> None:
        mask = np.asarray(value)
        if mask.dtype != bool or mask.shape not in ((), (self.n,)):
            raise TypeError(f"enabled: expected a bool or a mask of {self.n} bools, got {value!r}")
        self._enabled = np.array(np.broadcast_to(mask, self.n))

    def predict(self, u: ArrayLike | None = None) -> Any:
        """Predict the next output, phi(k+1)' theta (paper 22), and change nothing.

        Parameters
        ----------
        u : float, or array_like, shape (n_inputs,), of a bank (n,) or (n, n_inputs), optional
            The next input, in the forms of `update`; needed if one acts at once (nk = 0).

        Returns
        -------
        float, of a bank ndarray, shape (n,)

        Raises
        ------
        ValueError
            If the next input is needed and not given, or F would make theta infinite.
        """
        setup.require_next_input(self.structure, u)
        width = self.structure.n_inputs
        values = np.zeros((self.n, width)) if u is None else setup.inputs(self.structure, u, self.n)
        return self._alone(track.predicted(self.form, self.now, self._enabled, values))

    # The recursion.

    def _advanced(self, y: Array, u: Array, R: Array | None, place: Callable[[int, int], str]) -> tuple[State, Array]:
        """Return the state after checked samples (n, N), and a row for each; say what is to be said."""
        learning = self._enabled.tobytes()
        if learning != self._learning:
            self._flags, self._learning = self._flags.copy(), learning
            self._flags[:, 3] = self._enabled
        now, out, news = track.advance(self.form, self._now, self._flags, place, (y, u, R))
        self._say(news)
        return now, out

    def update(self, y: Any, u: ArrayLike | None = None, R: ArrayLike | None = None) -> Sample:
        """Take one sample: the output y(k) and the input u(k).

        Parameters
        ----------
        y : float or None, of a bank array_like, shape (n,), or None
            Measured output; NaN or None if it is missing: the recursion then goes on with its own prediction.
        u : float, or array_like, shape (n_inputs,), of a bank shape (n,) or (n, n_inputs), or one for all, optional
            Input of the same sample (which first acts nk samples later); phi(k) for a LinearRegression.
        R : float, of a bank or array_like, shape (n,), optional
            Variance of the noise in this sample. Default: the attribute R.

        Returns
        -------
        Sample
            prediction, residual, weight, guard, of a bank each of shape (n,).

        Raises
        ------
        ValueError, TypeError
            If y is infinite, u not finite or of the wrong length, or R not positive; nothing has changed then.
        LinAlgError
            If a filter refuses its sample; nothing has changed then.
        """
        outputs, inputs = setup.outputs(y, self.n)[:, None], setup.inputs(self.structure, u, self.n)[:, None]
        variances = None if R is None else setup.variances(R, self.n)[:, None]
        now, out = self._advanced(outputs, inputs, variances, self._place_alone)
        sample = self._sample(out[:, 0, -4:])
        self._now, self._time = now, self._time and (self._time[0], self._time[1] + 1)
        return sample

    def _recorded(
        self, axis: TimeAxis, fills: Sequence[FillValues], u: Array, R: Any, progress: bool | None,
        made: Callable[[list[Array]], TrackingResult], names: Sequence[str] = (),
    ) -> TrackingResult:  # fmt: skip
        """Take recordings; return what is made of theta, std, .. after every sample, axes (N, n, ..)."""
        axis.require_period(self.dt)
        y, own = np.stack([fill.signal for fill in fills]), self.form.own
        time = self._time_after(axis, y.shape[1])
        variances = None if R is None else setup.variances(R, self.n, y.shape[1]).T
        with stages(self._name, progress):
            now, out = self._advanced(y, u.swapaxes(0, 1), variances, self._place)
        filled = [f"{name}{fill.said}" for name, fill in zip(names or [""], fills, strict=True) if fill.values]
        if filled:
            which = "fill values, by actuator " if names else ""
            warn(f"{self._name}: y has {which}{'; '.join(filled)}", UserWarning)
        out = out.swapaxes(0, 1)
        *others, guard = np.ascontiguousarray(np.moveaxis(out[..., -4:], -1, 0))
        std = np.sqrt(np.maximum(out[..., self.form.layout.n + own], 0.0))
        result = made([out[..., own], std, *others, guard.astype(np.int64)])
        # At last: who interrupts a call has the state before it.
        self._now, self.dt, self._time = now, axis.dt if self.dt is None else self.dt, time
        return result

    def _time_after(self, axis: TimeAxis, samples: int) -> tuple[Any, int] | None:
        """Return the time after a recording; warn if samples are missing before it, and raise if it goes back."""
        last = None if self.structure.takes_phi else axis.last
        before = self._time
        if last is None:
            return None if before is None else (before[0], before[1] + samples)
        dt = axis.dt if self.dt is None else self.dt
        missing = 0 if before is None else axis.missing_after(before, dt)
        if missing > 0:
            warn(
                f"y: {missing} missing sample(s) between {before[0]} and {axis.index[0]}, which "  # type: ignore[index]
                f"the tracker takes for successive ones; give it the gap first, tracker.run(numpy.full({missing}, "
                "numpy.nan), u) with the u of the gap",
                UserWarning,
            )
        return last, 0

    # Interruption.

    def state(self) -> dict[str, Array]:
        """Return everything the recursion needs to go on, as plain arrays.

        Returns
        -------
        dict of str to ndarray
            theta and P, with the constant where there is one; the signals in memory: outputs (na,), inputs, residuals
            (nc,), undisturbed (nf,), gradients, prefiltered, measured (na,); scale: R, how many samples it stands on,
            the mean of min(e^2, 4), how many samples it remembers, what is rounding; readings: what was learned of the
            steps of y, (7,); centre of y; windup, the limit of tr P; begun, whether there is a model; enabled.
            Of a model that is looked for: samples, of how many; waits, how many until the next look, -1 if none is;
            start: y and u kept for it, (L, 1 + n_inputs), of which kept are its own.
            Of what is watched: restarts, whether it may start anew; seen, how many samples; usual, of ordinary
            residuals the autocovariances and how much of them follows the inputs anyway, (4,); scores and information
            of the gain in the last blocks, (12, 2); followed: the residuals, predictions and inputs it judges that by,
            (L, 2 + n_inputs);
            and the filter's Q, F and alpha_sq, and what else it keeps, as ``filter_..``.
            Of a bank all with a leading axis of n.
            ``format``: version, and name of tracker and structure as character codes. All of float64.
            ``numpy.savez(file, **state)`` stores it.
        """
        arrays = {**self.now.arrays(), "enabled": self._enabled}
        return _state.labelled(self.kind, {name: self._alone(value) for name, value in arrays.items()})

    @property
    def _axes(self) -> tuple[int, ...]:
        """The axes that come first in a state."""
        return (self.n,)

    def _go_back(self, state: Any) -> None:
        """Take over a state, or raise; nothing has changed then."""
        _state.require_kind(state, self.kind)
        kept = [name for name in state if name.startswith("filter_")]
        rows = recursion.checked(state, self.form, self._axes, kept)
        now = self._now.restored(rows)
        for i in range(self.n) if kept else ():
            recursion.load(self.form, now, i, now.theta[i], now.P[i], float(now.scale[i, 0]))
        self._now, self._enabled, self._time = now, rows["enabled"], None

    def restore(self, state: Any) -> None:
        """Go back to a state of this one, or of another with the same structure, number and kind of filter.

        Parameters
        ----------
        state : mapping of str to ndarray
            From `state`, or what ``numpy.load`` makes of a file that holds it.

        Raises
        ------
        ValueError
            If it is of another structure or a newer format, an array is missing, does not fit or is not finite, a
            variance is not positive, P not positive semidefinite, or a model unstable that the guard keeps stable;
            nothing has changed then.
        TypeError
            If state is no mapping.

        Notes
        -----
        The continuation is the same to the last bit. What it has warned of is not in a state; a tracker's from before
        there was a watch in it is watched from here on. Q, F and forgetting are the state's; a warning says which
        values they replace where it was made with others.
        """
        before = self._now.settings
        self._go_back(state)
        after = self._now.settings
        other = [
            f"{word} of the state, {_given(key, after[key])}, took the place of what was set, "
            f"{_given(key, before[key])}"
            for key, word in _BY_HAND.items()
            if not np.array_equal(before[key], after[key])
        ]
        if other:
            warn(f"{self._name}.restore: {'; '.join(other)}; set it again after restore if yours is to hold")

    def reset(self) -> None:
        """Go back to the start: theta, P, Q, R, F and the memory as they were when it was made."""
        self._go_back(self._initial)

    def _say(self, news: News) -> None:
        """Warn of what is wrong, once for all actuators of which it is the same, of each in the order of its news."""
        if not news:
            return
        said: Counter[int] = Counter()
        alike: dict[tuple[int, str, type[UserWarning]], list[int]] = {}
        for one in news:
            alike.setdefault((said[one.actuator], one.said, one.category), []).append(one.actuator)
            said[one.actuator] += 1
        for (_, text, category), which in sorted(alike.items(), key=lambda item: item[0][0]):
            warn(f"{self._name}: {self._named(sorted(which))}{text}", category)


def _over(constant: Array, gain: Array) -> Array:
    """Return what a constant is behind a gain, 0 where that is 0."""
    return constant / np.where(np.abs(gain) > 1e-9, gain, np.inf)


def _given(key: str, value: Any) -> str:
    """Return a setting on a line as a user gives it: of all alike a number, which may multiply I, or an array."""
    number = 1.0 / value if key == "alpha_sq" else value
    number = number[0] if (number == number[:1]).all() else number
    if number.ndim == 2 and np.array_equal(number, number[0, 0] * np.eye(len(number))):
        number = number[0, 0]
    return f"{number:.6g}" if number.ndim == 0 else " ".join(_checks.shown(number).split())
