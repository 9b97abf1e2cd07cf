"""What `ParameterTracker` and `TrackerBank` are: n actuators whose parameters are followed, a tracker's with n = 1."""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Sequence
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks, _state
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import FillValues
from robust_filterpy._progress import stages
from robust_filterpy._warning import warn
from robust_filterpy.filters.snapshot import put_back, snapshot
from robust_filterpy.filters.states import go_on_with, kept_with
from robust_filterpy.identification.models.signals import TimeAxis
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.identification.recursive import setup, track
from robust_filterpy.identification.recursive.recursion import REGRESSORS, Form, Regressor, State, checked
from robust_filterpy.identification.recursive.watch import News

_Kind = TypeVar("_Kind", bound="Following")
# What a user sets, by its name in a state, and as the user gave it.
_BY_HAND = {"Q": "Q", "F": "F", "alpha_sq": "forgetting"}


def _matrix(name: str, doc: str) -> Any:
    """Return a property that reads and writes the part of a matrix of the filters that is theta's."""

    def read(self: Following) -> Array:
        own = self.form.own
        values = np.array([getattr(kf, name) for kf in self._filters], dtype=float)[:, own[:, None], own]
        values = values[0] if (values == values[0]).all() else values
        # What is written into a copy would be lost without a word.
        values.flags.writeable = False
        return values

    def write(self: Following, value: ArrayLike) -> None:
        own = self.form.own
        rows = setup.of_each(self.n, {name: value})
        matrices = setup.for_each(lambda row: setup.checked_values(len(own), **row)[name], rows)
        self._filters = self._apart() if len(rows) > 1 else self._filters
        for kf, matrix in zip(self._filters, matrices * len(self._filters), strict=False):
            setattr(kf, name, setup.embedded(getattr(kf, name), own, matrix))
        self._used = None

    return property(read, write, doc=doc)


class Following:
    """n actuators whose parameters are followed; they can go back to a state or the start."""

    structure: Structure
    n: int
    form: Form
    #: Of the recording, for a tracker.
    dt: float | None
    _name: ClassVar[str] = "ParameterTracker"
    #: What is set of each actuator, or of all alike, and the definition of a sample.
    _filters: list[Any]
    _now: State
    _enabled: np.ndarray
    _initial: dict[str, Array]
    #: Whether somebody has the filter, who may read and write in it without asking.
    _asked: bool
    _used: tuple[Any, track.Settings] | None
    #: The last time that a recording had, and how many samples came after it.
    _time: tuple[Any, int] | None

    Q = _matrix("Q", "Covariance of a step of theta (paper 8), shape (d, d) or (n, d, d); may be set, to q for q I.")
    F = _matrix("F", "Transition matrix C of (9), shape (d, d) or (n, d, d); may be set.")

    def _alone(self, values: Any) -> Any:
        """Return what actuators have, of a tracker that of its one."""
        return values

    def _standing(self) -> State:
        """Return where they stand, samples that wait for a look among it."""
        return self._now

    def _named(self, which: list[int]) -> str:
        """Return some actuators as a message begins with them."""
        return ""

    def _like(self, kind: type[_Kind], which: np.ndarray) -> _Kind:
        """Return some of the actuators as they stand, one of them several times too."""
        part = object.__new__(kind)
        filters = self._filters if len(self._filters) == 1 else [self._filters[i] for i in which]
        vars(part).update({
            **vars(self), "n": len(which), "form": self.form._replace(flags=self.form.flags[which]),
            "_now": self.now.rows(which), "_enabled": self._enabled[which], "_filters": filters, "_used": None,
            "_asked": False,
        })  # fmt: skip
        return part

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what is made anew, which holds functions."""
        return {**vars(self), "_used": None}

    # The models as they stand.

    @property
    def now(self) -> State:
        """Everything that the recursion goes on from, with an axis of actuators in front."""
        return track.settled(self.form, self._standing())[0]

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
        return np.asarray(self._alone(self._standing().theta[:, self.form.own]))

    @property
    def P(self) -> Array:
        """Covariance of the parameters, shape (d, d), of a bank (n, d, d)."""
        return np.asarray(self._alone(self._standing().P[:, self.form.own[:, None], self.form.own]))

    @property
    def std(self) -> Array:
        """Standard deviations of the parameters, of theta's shape; infinite until the start has found a model."""
        std = np.sqrt(np.maximum(np.einsum("ijj->ij", self._standing().P), 0.0))[:, self.form.own]
        return np.asarray(self._alone(np.where(self._now.begun[:, None], std, np.inf)))

    @property
    def R(self) -> Any:
        """Variance of the ordinary noise, of a bank shape (n,), as it is followed; may be set, and is then not."""
        return self._alone(self._standing().scale[:, 0].copy())

    @R.setter
    def R(self, value: ArrayLike) -> None:
        scale = self._now.scale.copy()
        scale[:, 0], scale[:, 3] = setup.variances(value, self.n), 0.0
        self._now = self._standing().with_parts(scale=scale)
        if self._asked:
            self._load()

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
        theta, places = self._standing().theta, self.structure.polynomials
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
        return self._alone(track.predicted(self.form, self._using(), self.now, values))

    # The recursion.

    def _using(self, first: int | None = None) -> track.Settings:
        """Return what may have been changed since the last call; first: number of a recording's first sample."""
        key = first, self._enabled.tobytes()
        if self._used is not None and self._used[0] == key and not self._asked:
            return self._used[1]
        filters, n, names = self._filters, self.n, self._named

        def place(k: int, i: int) -> str:
            return names([i]) if first is None else f"sample {first + k}: {names([i])}"

        plain = all(setup.is_plain(kf, self.form.layout.n) for kf in filters)
        rules = track.rules_of(tuple(kf.choices for kf in filters)) if plain else None
        F, Q = (np.array([getattr(kf, name) for kf in filters], dtype=float)[:, None] for name in "FQ")
        alpha_sq, flags = np.array([float(vars(kf)["_alpha_sq"]) for kf in filters]), self.form.flags.copy()
        flags[:, 3] = self._enabled
        using = track.Settings(
            rules, F, Q, alpha_sq.repeat(n // len(filters)), flags, lambda i: filters[i % len(filters)], place
        )
        self._used = key, using
        return using

    def _taken(self, first: int | None, y: Array, u: Array, R: Array | None) -> Array:
        """Take checked samples (n, N), and say what is to be said; the caller undoes what is refused."""
        using = self._using(first)
        if self._asked and y.shape[1] == 1:
            # By the definition, the filter shows its correction.
            using = using._replace(rules=None)
        self._now, out, news = track.advance(self.form, using, self._standing(), y, u, R)
        if self._asked:
            self._load()
        self._say(news)
        return out

    def _updated(self, y: Any, u: Any, R: Any) -> Array:
        """Take one sample of each actuator and return prediction, residual, weight and guard, (n, 4)."""
        outputs, inputs = setup.outputs(y, self.n)[:, None], setup.inputs(self.structure, u, self.n)[:, None]
        variances = None if R is None else setup.variances(R, self.n)[:, None]
        before = self._held()
        try:
            out = self._taken(None, outputs, inputs, variances)
            if self._time is not None:
                self._time = self._time[0], self._time[1] + 1
            return out[:, 0, -4:]
        except BaseException:
            self._put_back(before)
            raise

    def _recorded(
        self, axis: TimeAxis, fills: Sequence[FillValues], u: Array, R: Any, progress: bool | None,
        names: Sequence[str] = (),
    ) -> list[Any]:  # fmt: skip
        """Take recordings; return theta, std, .. after every sample, axes (N, n, ..)."""
        axis.require_period(self.dt)
        y, own = np.column_stack([fill.signal for fill in fills]), self.form.own
        length, time = len(y), self._time_after(axis, len(y))
        variances = None if R is None else setup.variances(R, self.n, length)
        # If somebody has the filter, the last one by itself, which the filter shows.
        ends, parts = sorted({0, length - self._asked, length}), []
        before = self._held()
        try:
            with stages(self._name, progress):
                for part in map(slice, ends, ends[1:]):
                    noise = None if variances is None else variances[part].T
                    parts.append(self._taken(part.start, y[part].T, u[part].swapaxes(0, 1), noise))
            self.dt, self._time = axis.dt if self.dt is None else self.dt, time
            filled = [f"{name}{fill.said}" for name, fill in zip(names or [""], fills, strict=True) if fill.values]
            if filled:
                which = "fill values, by actuator " if names else ""
                warn(f"{self._name}: y has {which}{'; '.join(filled)}", UserWarning)
        except BaseException:
            self._put_back(before)
            raise
        out = np.concatenate(parts, axis=1).swapaxes(0, 1)
        *others, guard = np.ascontiguousarray(np.moveaxis(out[..., -4:], -1, 0))
        std = np.sqrt(np.maximum(out[..., self.form.layout.n + own], 0.0))
        return [out[..., own], std, *others, guard.astype(np.int64)]

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

    def _held(self) -> tuple[Any, ...]:
        """Return what a call changes."""
        # A filter that nobody has seen and that keeps nothing is written over when it is needed.
        seen = self._filters if self._asked or self._using().rules is None else ()
        return [snapshot(kf) for kf in seen], self._now, self._time, self.dt

    def _put_back(self, before: tuple[Any, ...]) -> None:
        """Undo what was refused, or interrupted."""
        states, self._now, self._time, self.dt = before
        for kf, state in zip(self._filters, states, strict=False):
            put_back(kf, state)

    def _load(self) -> None:
        """Let a filter of its own hold theta, P and R of its actuator."""
        now = self._now
        if len(self._filters) == self.n:
            for i, kf in enumerate(self._filters):
                setup.load(kf, now.theta[i], now.P[i], float(now.scale[i, 0]))

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
        arrays = {**self.now.arrays(), "enabled": self._enabled, **self._settings()}
        return _state.labelled(self.kind, {name: self._alone(value) for name, value in arrays.items()})

    def _settings(self) -> dict[str, Array]:
        """Return what may be set of each actuator's filter, and what that keeps of its sensor."""
        each = [{**setup.settings(kf), **kept_with(kf)} for kf in self._filters]
        stacked = {name: np.stack([one[name] for one in each]) for name in each[0]}
        return {name: values.repeat(self.n // len(each), axis=0) for name, values in stacked.items()}

    @property
    def _axes(self) -> tuple[int, ...]:
        """The axes that come first in a state."""
        return (self.n,)

    def _go_back(self, state: Any) -> None:
        """Take over a state, or raise; nothing has changed then."""
        _state.require_kind(state, self.kind)
        axes, first = self._axes, setup.settings(self._filters[0])
        stored = checked(state, self.form, axes, {name: (*axes, *value.shape) for name, value in first.items()})
        rows = {name: value if axes and value.ndim else value[None] for name, value in stored.items()}
        given = {name: rows[name] for name in first if name in rows}
        filters = self._apart() if any((values != values[:1]).any() for values in given.values()) else self._filters
        for i, kf in enumerate(filters):
            kept = {name: state[name][i] if axes else state[name] for name in state if name.startswith("filter_")}
            go_on_with(kf, rows["theta"][i], rows["P"][i], kept)
            setup.apply_settings(kf, {name: values[i % len(values)] for name, values in given.items()})
        self._filters, self._now, self._enabled = filters, self._now.restored(rows), rows["enabled"]
        self._time, self._used = None, None
        self._load()

    def _apart(self) -> list[Any]:
        """Return a filter for each actuator."""
        filters = self._filters
        return filters if len(filters) == self.n else [copy.deepcopy(filters[0]) for _ in range(self.n)]

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
        before = self._settings()
        self._go_back(state)
        after = self._settings()
        other = [
            f"{word} of the state, {_given(key, after[key])}, took the place of what was set, "
            f"{_given(key, before[key])}"
            for key, word in _BY_HAND.items()
            if key in before and not np.array_equal(before[key], after[key])
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
