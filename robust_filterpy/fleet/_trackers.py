"""Many keys with one kind of tracker, one after the other in the same object."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy import _state
from robust_filterpy._checks import Array
from robust_filterpy.correction import spread
from robust_filterpy.fleet._filters import REFUSED, Work
from robust_filterpy.identification.models.signals import measured_output, recorded_input
from robust_filterpy.identification.recursive.tracker import ParameterTracker, keeps_spread

# What the model says, not the state.
_SETTINGS = ("Q", "F", "alpha_sq", _state.LABEL)


def start(tracker: ParameterTracker) -> dict[str, Array]:
    """Return what a tracker's steps move, as it is; of a sensor of which nothing is known yet, zeros."""
    unknown = {"filter_spread": spread.begin(1)} if keeps_spread(tracker) else {}
    return {**unknown, **{name: value for name, value in tracker.state().items() if name not in _SETTINGS}}


def shapes(tracker: ParameterTracker) -> dict[str, _state.Shape]:
    """Return the shapes of that; how long a recording is kept for a start or watched, no one knows beforehand."""
    found: dict[str, _state.Shape] = {name: value.shape for name, value in start(tracker).items()}
    return {**found, **{name: (None, *found[name][1:]) for name in ("start", "followed")}}


def advance(tracker: ParameterTracker, work: Work) -> None:
    """Take the samples of all keys."""
    settings = {name: value for name, value in tracker.state().items() if name in _SETTINGS and name != _state.LABEL}
    for i in range(len(work.bounds) - 1):
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


def _through(tracker: ParameterTracker, work: Work, first: int, stop: int) -> None:
    """Take the samples from first to stop, or raise."""
    own = tracker.form.own
    d = len(own)
    if first == stop:
        return
    y, u = measured_output(work.z[first:stop]), None if work.u is None else work.u[first:stop]
    out = tracker.advance(y, recorded_input(tracker.structure, u, len(y)), None)
    columns: Any = work.columns[first:stop]
    columns[:, :d], columns[:, d : 2 * d] = out.theta[:, own], np.sqrt(np.maximum(out.variance[:, own], 0.0))
    columns[:, 2 * d :] = np.column_stack((out.prediction, out.residual, out.weights, out.guard))


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
