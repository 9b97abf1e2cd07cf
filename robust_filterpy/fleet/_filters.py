"""Many keys with one filter: by the kernel, keys with equally many steps together, or one by one.

However a recording is cut into batches, and whichever keys come together, the numbers are the same to the last bit:
every step that the kernel can take is the kernel's, and the definition takes single steps.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._arrays import noise_covariance, process_noise, state_of
from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Choices
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.filters.states import moved_shapes
from robust_filterpy.kernel import series as kernel
from robust_filterpy.kernel.records import Model, Output

#: What an impossible step raises.
REFUSED = (ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError)
# Numbers of a group of keys that are worked on at once: what stays in a processor's cache.
_GROUP = 100_000


class Work(NamedTuple):
    """What some keys bring, and what becomes of it: written into by who advances them."""

    entries: dict[str, np.ndarray]
    """States in columns, a row for each key."""
    z: Array
    """Measurements of all steps, shape (N, m), NaN where missing; those of a key together."""
    u: Array | None
    """Inputs, shape (N, p)."""
    bounds: np.ndarray
    """First step of each key, and the end, shape (K + 1,)."""
    columns: Array
    """What the model gives for each step, shape (N, c)."""
    stopped: dict[int, tuple[int, str]]
    """Keys that could not go on: how many steps they took, and why. -1: their state is refused."""
    missed: dict[int, str]
    """Steps whose measurement was refused, and so was as if missing."""


class Plain(NamedTuple):
    """A `RobustKalmanFilter` as the kernel takes it."""

    choices: Choices
    F: Array
    Q: Array
    H: Array
    R: Array
    B: Array | None
    alpha_sq: float

    def through(self, z: Array, Bu: Array, moving: Moving, kept: Output, start: int = 0) -> np.ndarray:
        """Advance keys in place and return the first step of each that the kernel has not taken."""
        model = Model(self.F[None, None], self.Q[None, None], self.H[None, None], self.R[None, None], Bu)
        return kernel.filter_series(
            self.choices, z, model, moving.x, moving.P, kept,
            memory=moving.memory, alpha_sq=self.alpha_sq, start=start,
        )  # fmt: skip


def plain(kf: Any, update: Mapping[str, Any]) -> Plain | None:
    """Return what the kernel needs, None if it does not serve this filter on this machine, however long the batch."""
    # An R or H of the user's own is for `update` to look at.
    if update or type(kf) is not RobustKalmanFilter or {"predict", "update"} & vars(kf).keys():
        return None
    if kf.inv is not np.linalg.inv or not (kf.policy.by_kernel and kernel.serves(kf.choices)):
        return None
    _, P = state_of(kf)
    n, m = kf.dim_x, kf.dim_z
    F, H = _checks.matrix("F", kf.F, (n, n), "dim_x"), _checks.matrix("H", kf.H, (m, n), "dim_z")
    Q, R = process_noise(kf.Q, None, n) * np.ones((n, n)), noise_covariance(kf.R, None, m)
    if not all((a == a.T).all() for a in (Q, R, P)):
        return None
    B = None if kf.B is None or np.ndim(kf.B) != 2 else _checks.numbers("B", kf.B)
    return Plain(kf.choices, F, Q, H, R, B, float(kf.state()["alpha_sq"]))


class Moving(NamedTuple):
    """What steps move of some keys, advanced in place."""

    x: Array
    """(keys, n)"""
    P: Array
    """(keys, n, n)"""
    memory: Array | None
    """What is known of the sensors, (keys, m, 10); None if nothing is learnt of them."""

    def of(self, s: int) -> Moving:
        """Return that of one key, the same numbers."""
        return Moving(*(None if a is None else a[s : s + 1] for a in self))  # type: ignore[arg-type]

    def lend(self, kf: Any) -> None:
        """Let a filter stand where the one key stands."""
        known: dict[str, Array] = {} if self.memory is None else {"spread": self.memory[0]}
        kf.restore({"x": self.x[0].reshape(np.shape(kf.x)), "P": self.P[0], **known})

    def take(self, kf: Any) -> None:
        """Let the one key stand where a filter stands."""
        self.x[0], self.P[0] = np.ravel(kf.x), kf.P
        if self.memory is not None:
            self.memory[0] = kf.state().get("spread", 0.0)


def require_consistent(kf: Any, update: Mapping[str, Any]) -> None:
    """Raise unless the filter can take a step."""
    trial = copy.deepcopy(kf)
    trial.restore(trial.state())
    trial.predict()
    try:
        trial.update(np.zeros(kf.dim_z), **update)
    except TypeError as error:
        raise TypeError(f"update: expected the further arguments of {type(kf).__name__}.update, {error}") from None


def start(kf: Any) -> dict[str, Array]:
    """Return what a filter's steps move, as it is; of sensors of which nothing is known yet, zeros."""
    empty = {name: np.zeros([size or 0 for size in shape]) for name, shape in moved_shapes(kf).items()}
    known = kf.state()
    return {name: known.get(name, value) for name, value in empty.items()}


def advance(kf: Any, update: Mapping[str, Any], series: Plain | None, work: Work) -> None:
    """Take the steps of all keys; kf stays as it is."""
    if series is None:
        worker = copy.deepcopy(kf)
        settings = kf.state()
        for i in range(len(work.bounds) - 1):
            _alone(worker, update, settings, work, i)
        return
    # Written into in place, without the axis of a column.
    x, P = work.entries["x"].reshape(-1, kf.dim_x), work.entries["P"]
    memory = work.entries.get("spread")
    good = np.isfinite(x).all(axis=1) & _checks.are_covariances(P, _checks.GATHERED, _checks.ROUNDING)
    if memory is not None:
        good &= np.isfinite(memory).all(axis=(1, 2))
    for i in np.flatnonzero(~good).tolist():
        _explain(copy.deepcopy(kf), work, i)
    for rows in _groups(good, np.diff(work.bounds), kf):
        own = Moving(x[rows], P[rows], None if memory is None else memory[rows])
        _together(series, kf, update, work, own, rows)
        x[rows], P[rows] = own.x, own.P
        if memory is not None:
            memory[rows] = own.memory


def _explain(worker: Any, work: Work, i: int) -> None:
    """Say what is wrong with the state of a key."""
    try:
        worker.restore({name: work.entries[name][i] for name in moved_shapes(worker)})
        work.stopped[i] = -1, "state: expected finite numbers and a covariance"
    except REFUSED as error:
        work.stopped[i] = -1, str(error)


def _alone(worker: Any, update: Mapping[str, Any], settings: Mapping[str, Array], work: Work, i: int) -> None:
    """Take the steps of one key by the filter's own methods."""
    try:
        worker.restore({**settings, **{name: work.entries[name][i] for name in moved_shapes(worker)}})
    except REFUSED as error:
        work.stopped[i] = -1, str(error)
        return
    first = work.bounds[i]
    for k in range(first, work.bounds[i + 1]):
        if not _step(worker, update, work, i, k):
            break
        work.columns[k] = _shown(worker)
    for name, value in start(worker).items():
        work.entries[name][i] = value


def _shown(worker: Any) -> Array:
    """Return a row of what a filter gives."""
    std = np.sqrt(np.maximum(np.diagonal(worker.P), 0.0))
    return np.concatenate((np.ravel(worker.x), std, np.ravel(worker.weights)))


def _step(worker: Any, update: Mapping[str, Any], work: Work, i: int, k: int) -> bool:
    """Predict and correct once; a measurement that is refused is as if missing. Return whether there was a step."""
    try:
        if work.u is None:
            worker.predict()
        else:
            worker.predict(u=work.u[k])
        try:
            worker.update(work.z[k], **update)
        except REFUSED as error:
            worker.update(None, **update)
            work.missed[k] = f"update: {error}; as if it were missing"
    except REFUSED as error:
        # A refused call changes nothing: the filter stands where it stood before the step.
        work.stopped[i] = int(k - work.bounds[i]), f"step {k - work.bounds[i]}: {error}"
        return False
    return True


def _groups(good: np.ndarray, steps: np.ndarray, kf: Any) -> Iterator[np.ndarray]:
    """Yield keys with equally many steps, as many at once as stay in a processor's cache."""
    n, m = kf.dim_x, kf.dim_z
    order = np.argsort(steps, kind="stable")
    order = order[good[order] & (steps[order] > 0)]
    for members in np.split(order, np.flatnonzero(np.diff(steps[order])) + 1):
        if len(members):
            share = max(1, _GROUP // max(int(steps[members[0]]) * (2 * n + m), n * n))
            yield from (members[first : first + share] for first in range(0, len(members), share))


def _together(series: Plain, kf: Any, update: Mapping[str, Any], work: Work, moving: Moving, rows: np.ndarray) -> None:
    """Advance keys with equally many steps."""
    n, m = len(series.F), len(series.H)
    first, steps = work.bounds[rows], int(work.bounds[rows[0] + 1] - work.bounds[rows[0]])
    every = first[:, None] + np.arange(steps)
    z = work.z[every]
    if work.u is None or series.B is None:
        Bu = np.zeros((1, 1, n))
    else:
        Bu = np.ascontiguousarray(work.u[every] @ series.B.T)
    kept = Output(
        np.empty((len(rows), steps, n)), np.empty((len(rows), steps, 1, n)), np.empty((len(rows), 0, n)),
        np.empty((len(rows), 0, n, n)), np.empty((len(rows), steps, m)), np.zeros(len(rows)),
    )  # fmt: skip
    done = series.through(z, Bu, moving, kept)
    declined = np.flatnonzero(done < steps).tolist()
    # A copy takes a third of a single step.
    worker = copy.deepcopy(kf) if declined else kf
    for s in declined:
        one, part = moving.of(s), Output(*(a[s : s + 1] for a in kept))
        onwards = partial(series.through, z[s : s + 1], Bu if len(Bu) == 1 else Bu[s : s + 1], one, part)
        _mixed(worker, update, work, int(rows[s]), int(done[s]), one, part, onwards)
    # A name for each, since what is assigned to a part of a fancy index is lost.
    found = np.concatenate((kept.means, np.sqrt(np.maximum(kept.covariances[:, :, 0], 0.0)), kept.weights), axis=2)
    work.columns[every] = found


def _mixed(
    worker: Any, update: Mapping[str, Any], work: Work, i: int, k: int, moving: Moving, kept: Output,
    onwards: Callable[[int], np.ndarray],
) -> None:  # fmt: skip
    """Go on with one key from step k, which the kernel has declined: that step by the definition, then the kernel."""
    steps, n = kept.means.shape[1:]
    while k < steps:
        moving.lend(worker)
        if not _step(worker, update, work, i, int(work.bounds[i]) + k):
            return
        row = _shown(worker)
        kept.means[0, k], kept.covariances[0, k, 0] = row[:n], np.diagonal(worker.P)
        kept.weights[0, k] = row[2 * n :]
        moving.take(worker)
        k += 1
        if k < steps:
            k = int(onwards(k)[0])
