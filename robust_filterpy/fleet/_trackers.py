"""Many keys with one kind of tracker: by the kernel, keys that are looked at after equally many samples together.

What the kernel does not serve, and what is refused, goes one key after the other through the same tracker.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from robust_filterpy import _state
from robust_filterpy._checks import Array
from robust_filterpy.correction import spread
from robust_filterpy.fleet._filters import REFUSED, Work
from robust_filterpy.identification.models.results import Columns
from robust_filterpy.identification.models.signals import measured_output, recorded_input
from robust_filterpy.identification.recursive.tracker import ParameterTracker, keeps_spread

# What the model says, not the state.
_SETTINGS = ("Q", "F", "alpha_sq", _state.LABEL)
# As many keys at once as stay in a processor's cache.
_GROUP = 500


def start(tracker: ParameterTracker) -> dict[str, Array]:
    """Return what a tracker's steps move, as it is; of a sensor of which nothing was learned yet, zeros."""
    unknown = {"filter_spread": spread.begin(1)} if keeps_spread(tracker) else {}
    return {**unknown, **{name: value for name, value in tracker.state().items() if name not in _SETTINGS}}


def shapes(tracker: ParameterTracker) -> dict[str, _state.Shape]:
    """Return the shapes of that; how long a recording is kept for a start or watched, no one knows beforehand."""
    sizes: dict[str, _state.Shape] = {name: value.shape for name, value in start(tracker).items()}
    return {**sizes, **{name: (None, *sizes[name][1:]) for name in ("start", "followed")}}


def advance(tracker: ParameterTracker, work: Work) -> None:
    """Take the samples of all keys."""
    settings = {name: value for name, value in tracker.state().items() if name in _SETTINGS and name != _state.LABEL}
    done = np.zeros(len(work.bounds) - 1, dtype=bool)
    for rows in _groups(work) if tracker.is_one_of_many else ():
        try:
            _together(tracker, settings, work, rows)
            done[rows] = True
        except REFUSED:
            continue
    for i in np.flatnonzero(~done).tolist():
        try:
            tracker.restore({**settings, **{name: column[i] for name, column in work.entries.items()}})
        except REFUSED as error:
            work.stopped[i] = -1, str(error)
            continue
        first, stop = int(work.bounds[i]), int(work.bounds[i + 1])
        before = tracker.state()
        try:
            _through(tracker, work, first, stop)
        except REFUSED:
            tracker.restore(before)
            _one_by_one(tracker, work, i)
        for name, value in start(tracker).items():
            work.entries[name][i] = value


def _groups(work: Work) -> Iterator[np.ndarray]:
    """Yield keys with equally many samples, and as many until the next look at them unless there is one sample."""
    steps = np.diff(work.bounds)
    phases = np.stack((steps, work.entries["recursion"][:, 6], work.entries["watch"][:, 2] % 40.0), axis=1)
    phases[steps == 1, 1:] = 0.0
    _, of = np.unique(phases, axis=0, return_inverse=True)
    order = np.argsort(of.ravel(), kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(of.ravel()[order])) + 1):
        if len(members) > 1 and steps[members[0]]:
            yield from (members[k : k + _GROUP] for k in range(0, len(members), _GROUP))


def _together(tracker: ParameterTracker, settings: dict[str, Array], work: Work, rows: np.ndarray) -> None:
    """Take the samples of keys with equally many, or raise; nothing has changed then."""
    every = work.bounds[rows][:, None] + np.arange(work.bounds[rows[0] + 1] - work.bounds[rows[0]])
    y = measured_output(work.z[every].ravel()).reshape(every.shape)
    u = recorded_input(tracker.structure, None if work.u is None else work.u[every.ravel()], every.size)
    states = {name: column[rows] for name, column in work.entries.items()}
    out, after = tracker.together(states | settings, y, u.reshape(*every.shape, -1))
    _shown(tracker, work, every, out)
    for name, column in after.items():
        work.entries[name][rows] = column


def _shown(tracker: ParameterTracker, work: Work, places: Any, out: Columns) -> None:
    """Write what samples gave into the columns."""
    own = tracker.form.own
    std = np.sqrt(np.maximum(out.variance[..., own], 0.0))
    numbers = np.stack((out.prediction, out.residual, out.weights, out.guard), axis=-1)
    work.columns[places] = np.concatenate((out.theta[..., own], std, numbers), axis=-1)


def _through(tracker: ParameterTracker, work: Work, first: int, stop: int) -> None:
    """Take the samples from first to stop, or raise."""
    if first == stop:
        return
    y, u = measured_output(work.z[first:stop]), None if work.u is None else work.u[first:stop]
    _shown(tracker, work, slice(first, stop), tracker.advance(y, recorded_input(tracker.structure, u, len(y)), None))


def _one_by_one(tracker: ParameterTracker, work: Work, i: int) -> None:
    """Take the samples of a key one by one; an output that is refused is as if missing."""
    for k in range(int(work.bounds[i]), int(work.bounds[i + 1])):
        before = tracker.state()
        try:
            _through(tracker, work, k, k + 1)
        except REFUSED as refusal:
            tracker.restore(before)
            work.missed[k], work.z[k] = f"update: {refusal}; as if it were missing", np.nan
            try:
                _through(tracker, work, k, k + 1)
            except REFUSED as error:
                tracker.restore(before)
                del work.missed[k]
                work.stopped[i] = int(k - work.bounds[i]), f"step {k - work.bounds[i]}: {error}"
                return
