"""Many keys with one filter or kind of tracker: those with equally many steps together by the kernel, or one by one.

However a recording is cut into batches, and whichever keys come together, the numbers are the same to the last bit:
every step that the kernel can take is the kernel's, and the definition takes single steps.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._arrays import noise_covariance, process_noise, state_of
from robust_filterpy._checks import Array
from robust_filterpy._warning import mute
from robust_filterpy.correction import spread
from robust_filterpy.correction.options import Choices
from robust_filterpy.filters.kalman import RobustKalmanFilter, replaced
from robust_filterpy.filters.notices import StuckSensorWarning, say_stuck_among
from robust_filterpy.fleet.states import FLEET
from robust_filterpy.identification.models.signals import measured_output, recorded_input
from robust_filterpy.identification.recursive.tracker import ParameterTracker
from robust_filterpy.kernel import series as kernel
from robust_filterpy.kernel.series import Model, Rows

#: What an impossible step raises.
REFUSED = (ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError)
#: Takes samples of a key by a filter or tracker, from one row of the work to another, or raises.
Through: TypeAlias = Callable[[Any, "Work", int, int], None]
# Numbers of a group of keys that are worked on at once: what stays in a processor's cache.
_GROUP = 100_000


class Work(NamedTuple):
    """What some keys bring, and what becomes of it: written into by who advances them."""

    #: States in columns, a row for each key.
    entries: dict[str, np.ndarray]
    #: Measurements of all steps, shape (N, m), NaN where missing; those of a key together.
    z: Array
    #: Inputs, shape (N, p).
    u: Array | None
    #: First step of each key, and the end, shape (K + 1,).
    bounds: np.ndarray
    #: What the model gives for each step, shape (N, c).
    columns: Array
    #: Keys that could not go on: how many steps they took, and why. -1: their state is refused.
    stopped: dict[int, tuple[int, str]]
    #: Steps whose measurement was refused, and so was as if missing.
    missed: dict[int, str]
    #: Of a key, by its place.
    name: Callable[[int], Any] = int


class Plain(NamedTuple):
    """A `RobustKalmanFilter` as the kernel takes it."""

    choices: Choices
    #: With no input.
    model: Model
    B: Array | None
    alpha_sq: float


def plain(kf: Any, update: Mapping[str, Any]) -> Plain | None:
    """Return what the kernel needs, None if it does not serve this filter on this machine, however long the batch."""
    # An R or H of the user's own is for `update` to look at.
    if update or type(kf) is not RobustKalmanFilter or replaced(kf) or kf.noise or not kernel.serves(kf.choices):
        return None
    _, P = state_of(kf)
    n, m = kf.dim_x, kf.dim_z
    F, H = _checks.matrix("F", kf.F, (n, n), "dim_x"), _checks.matrix("H", kf.H, (m, n), "dim_z")
    Q, R = process_noise(kf.Q, None, n) * np.ones((n, n)), noise_covariance(kf.R, None, m)
    if not all((a == a.T).all() for a in (Q, R, P)):
        return None
    B = None if kf.B is None or np.ndim(kf.B) != 2 else _checks.numbers("B", kf.B)
    model = Model(F[None, None], Q[None, None], H[None, None], R[None, None], np.zeros((1, 1, n)))
    return Plain(kf.choices, model, B, float(kf.state()["alpha_sq"]))


def require_consistent(kf: Any, update: Mapping[str, Any]) -> None:
    """Raise unless the filter can take a step."""
    trial = copy.deepcopy(kf)
    trial.restore(trial.state())
    trial.predict()
    try:
        trial.update(np.zeros(kf.dim_z), **update)
    except TypeError as error:
        raise TypeError(f"update: expected the further arguments of {type(kf).__name__}.update, {error}") from None


def advance_filters(kf: Any, update: Mapping[str, Any], series: Plain | None, work: Work) -> None:
    """Take the steps of all keys; kf stays as it is."""
    steps, through = np.diff(work.bounds), partial(_through_filter, update)
    if series is None:
        worker, settings, m = copy.deepcopy(kf), kf.state(), kf.dim_z
        learns = getattr(getattr(kf, "policy", None), "noise", None) is not None
        if learns:
            mute(StuckSensorWarning, worker)
        work.columns[:] = np.nan
        for i in range(len(steps)):
            _alone(worker, settings, through, work, i, 0, int(steps[i]))
        if learns:
            # Of no reading else is the weight 0.
            some = np.flatnonzero(steps)
            left_out = np.maximum.reduceat(work.columns[:, -m:] == 0.0, work.bounds[some]) if len(some) else some
            say_stuck_among("step", "key", np.reshape(left_out, (-1, m)), lambda i: work.name(int(some[i])))
        return
    x, P, memory = _moving(work)
    good = np.isfinite(x).all(axis=1) & _checks.are_covariances(P, _checks.GATHERED, _checks.ROUNDING)
    good &= np.isfinite(memory).all(axis=(1, 2))
    worker = kf if good.all() else copy.deepcopy(kf)
    for i in np.flatnonzero(~good).tolist():
        # Says what is wrong with the state.
        _alone(worker, {}, through, work, i, 0, int(steps[i]))
    before = memory.copy()
    n, m, able = kf.dim_x, kf.dim_z, np.flatnonzero(good & (steps > 0))
    for members in _groups(steps[able], lambda k: _GROUP // max(int(steps[able[k]]) * (2 * n + m), n * n)):
        _together(series, kf, through, work, able[members])
    if memory.size:
        # Of a key it is said once: its state knows.
        memory = _moving(work)[2]
        before, memory = before[:, :, spread.FILLED], memory[:, :, spread.FILLED]
        say_stuck_among("step", "key", (before == 0.0) & (memory > 0.0), work.name)


def _moving(work: Work) -> tuple[Array, Array, Array]:
    """Return x, without the axis of a column, P and the memory of the sensors of all keys, to be written into."""
    x, P = work.entries["x"], work.entries["P"]
    return x.reshape(-1, P.shape[-1]), P, work.entries.get("spread", np.zeros((len(x), 0, 0)))


def _through_filter(update: Mapping[str, Any], kf: Any, work: Work, first: int, stop: int) -> None:
    """Predict and correct by the samples from first to stop, or raise."""
    for k in range(first, stop):
        kf.predict(**({} if work.u is None else {"u": work.u[k]}))
        # A model's functions are not asked about what is missing: they may be what has failed.
        kf.update(None if np.isnan(work.z[k]).all() else work.z[k], **update)
        std = np.sqrt(np.maximum(np.diagonal(kf.P), 0.0))
        work.columns[k] = np.concatenate((np.ravel(kf.x), std, np.ravel(kf.weights)))


def _alone(
    worker: Any, settings: Mapping[str, Array], through: Through, work: Work, i: int, first: int, stop: int
) -> bool:
    """Take some of the steps of one key by the filter's or tracker's own methods; return whether it can go on."""
    names = work.entries.keys() - FLEET.keys()
    stood = {**settings, **{name: work.entries[name][i] for name in names}}
    try:
        worker.restore(stood)
    except REFUSED as error:
        # After some steps by the kernel: its rounding may leave no covariance where R is singular and nothing moves.
        work.stopped[i] = first or -1, str(error)
        return False
    goes_on = _take(worker, stood, through, work, i, int(work.bounds[i]) + first, int(work.bounds[i]) + stop)
    for name, value in worker.state().items():
        if name in names:
            work.entries[name][i] = value
    return goes_on


def _take(
    worker: Any, stood: Mapping[str, Array], through: Through, work: Work, i: int, first: int, stop: int
) -> bool:
    """Take samples of a key, or halves of them until the one that is refused, as if missing; return if it can go on."""
    try:
        through(worker, work, first, stop)
        return True
    except REFUSED as error:
        worker.restore(stood)
        why = str(error)
    if stop - first > 1:
        middle = (first + stop) // 2
        halves = (first, middle), (middle, stop)
        return all(_take(worker, worker.state(), through, work, i, *half) for half in halves)
    if work.missed.pop(first, None) is not None:
        step = int(first - work.bounds[i])
        work.stopped[i] = step, f"step {step}: {why}"
        return False
    work.missed[first], work.z[first] = f"update: {why}; as if it were missing", np.nan
    return _take(worker, stood, through, work, i, first, stop)


def _groups(of: np.ndarray, size: Callable[[int], int]) -> Iterator[np.ndarray]:
    """Yield the places of equal numbers, as many at once as size says of the first of them."""
    order = np.argsort(of, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(of[order])) + 1) if len(of) else ():
        share = max(1, size(int(members[0])))
        yield from (members[first : first + share] for first in range(0, len(members), share))


def _together(series: Plain, kf: Any, through: Through, work: Work, rows: np.ndarray) -> None:
    """Advance keys with equally many steps: by the kernel, and each step that it declines by the filter's methods."""
    n, m = kf.dim_x, kf.dim_z
    steps = int(work.bounds[rows[0] + 1] - work.bounds[rows[0]])
    every = work.bounds[rows][:, None] + np.arange(steps)
    z, Bu = work.z[every], series.model.Bu
    if work.u is not None and series.B is not None:
        Bu = np.ascontiguousarray(work.u[every] @ series.B.T)
    columns = [np.empty((len(rows), steps, width)) for width in (n, n, m)]
    moving, learns = _moving(work), "spread" in work.entries

    def by_kernel(own: slice, k: int) -> np.ndarray:
        """Take steps of some keys from one on and return the first that the kernel declines, of each."""
        keys, out = rows[own], [column[own] for column in columns]
        model = series.model._replace(Bu=Bu if len(Bu) == 1 else Bu[own])
        # Copies, since what is written to a part of a fancy index is lost.
        x, P, memory = (whole[keys] for whole in moving)
        into = Rows(out[0], out[1], weights=out[2], log_likelihood=np.zeros(len(keys)))
        done = kernel.filter_series(
            series.choices, z[own], model, x, P, into,
            memory=memory if learns else None, alpha_sq=series.alpha_sq, start=k,
        )  # fmt: skip
        for whole, part in zip(moving, (x, P, memory), strict=True):
            whole[keys] = part
        taken = slice(k, int(done.max()))
        mean, variance, weight = (part[:, taken] for part in out)
        std = np.sqrt(np.maximum(variance, 0.0))
        work.columns[every[own, taken]] = np.concatenate((mean, std, weight), axis=2)
        return done

    done = by_kernel(slice(None), 0)
    declined = np.flatnonzero(done < steps).tolist()
    # A copy takes a third of a single step.
    worker = copy.deepcopy(kf) if declined else kf
    for s in declined:
        k = int(done[s])
        while k < steps and _alone(worker, {}, through, work, int(rows[s]), k, k + 1):
            k = int(by_kernel(slice(s, s + 1), k + 1)[0])


# As many keys at once as stay in a processor's cache.
_TRACKERS = 500


def advance_trackers(tracker: ParameterTracker, work: Work) -> None:
    """Take the samples of all keys."""
    done, steps = np.zeros(len(work.bounds) - 1, dtype=bool), np.diff(work.bounds).tolist()
    for rows in _of_one_phase(work):
        try:
            _samples_together(tracker, work, rows)
            done[rows] = True
        except REFUSED:
            continue
    for i in np.flatnonzero(~done).tolist():
        _alone(tracker, {}, _through_tracker, work, i, 0, steps[i])


def _of_one_phase(work: Work) -> Iterator[np.ndarray]:
    """Yield keys with equally many samples, and as many until the next look at them unless there is one sample."""
    steps = np.diff(work.bounds)
    phases = np.stack((steps, work.entries["waits"], work.entries["seen"] % 40.0), axis=1)
    phases[steps == 1, 1:] = 0.0
    _, of, counts = np.unique(phases, axis=0, return_inverse=True, return_counts=True)
    able = np.flatnonzero((counts[of.ravel()] > 1) & (steps > 0))
    yield from (able[members] for members in _groups(of.ravel()[able], lambda k: _TRACKERS))


def _samples_together(tracker: ParameterTracker, work: Work, rows: np.ndarray) -> None:
    """Take the samples of keys with equally many, or raise; nothing has changed then."""
    every = work.bounds[rows][:, None] + np.arange(work.bounds[rows[0] + 1] - work.bounds[rows[0]])
    y = measured_output(work.z[every].ravel()).reshape(every.shape)
    u = recorded_input(tracker.structure, None if work.u is None else work.u[every.ravel()], every.size)
    states = {name: column[rows] for name, column in work.entries.items()}
    out, after = tracker.together(states, y, u.reshape(*every.shape, -1))
    _write(tracker, work, every, out)
    for name, column in after.items():
        work.entries[name][rows] = column


def _write(tracker: ParameterTracker, work: Work, places: Any, out: Array) -> None:
    """Write what samples gave into the columns."""
    own = tracker.form.own
    std = np.sqrt(np.maximum(out[..., tracker.form.layout.n + own], 0.0))
    work.columns[places] = np.concatenate((out[..., own], std, out[..., -4:]), axis=-1)


def _through_tracker(tracker: ParameterTracker, work: Work, first: int, stop: int) -> None:
    """Take the samples from first to stop, or raise."""
    if first < stop:
        y, u = measured_output(work.z[first:stop]), None if work.u is None else work.u[first:stop]
        out = tracker.advance(y, recorded_input(tracker.structure, u, len(y)), None)
        _write(tracker, work, slice(first, stop), out)
