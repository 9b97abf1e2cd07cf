"""Many keys with one kind of tracker, one after the other in the same object."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.identification import ParameterTracker, _compiled_dispatch
from robust_filterpy.identification._signals import recorded_input, recorded_output
from robust_filterpy.identification.results import Columns

_REFUSED = (ValueError, TypeError, np.linalg.LinAlgError)
# What the model says, not the state.
_SETTINGS = ("Q", "F", "alpha_sq")


class EvenTracker(ParameterTracker):
    """A tracker whose numbers do not depend, to the last bit, on how a recording is cut into batches."""

    def _run_through(self, y: Array, u: Array, R: Array | None, out: Columns, start: int, stop: int) -> None:
        """Advance by the kernel wherever it can, by single steps of the definition elsewhere."""
        if self._is_plain and _compiled_dispatch.serves((self.filter._choices,), math.inf):
            self._run_kernel(y, u, R, out, start, stop, most_odd=1)
        else:
            self._run_stepwise(y, u, R, out, start, stop)


def advance(tracker: EvenTracker, jobs: Sequence[Any]) -> list[tuple[dict[str, Array], Array] | Exception]:
    """Return state and columns of each job, or what was wrong with it."""
    initial = tracker.state()
    found: list[Any] = []
    for job in jobs:
        try:
            found.append(_alone(tracker, initial, job))
        except _REFUSED as error:
            found.append(error)
    return found


def _alone(tracker: EvenTracker, initial: dict[str, Array], job: Any) -> tuple[dict[str, Array], Array]:
    """Take the samples of one key."""
    state = initial
    if job.state is not None:
        moving = {name: value for name, value in job.state.items() if name not in _SETTINGS}
        state = {**{name: initial[name] for name in _SETTINGS if name in initial}, **moving}
    tracker.restore(state)
    n, steps, own = tracker._layout.n, len(job.z), tracker._own
    d = len(own)
    columns = np.empty((steps, 2 * d + 4))
    if steps:
        out = Columns.empty(steps, n)
        tracker._advance(recorded_output(job.z), recorded_input(tracker.structure, job.u, steps), None, out)
        columns[:, :d], columns[:, d : 2 * d] = out.theta[:, own], np.sqrt(np.maximum(out.variance[:, own], 0.0))
        columns[:, 2 * d :] = np.column_stack((out.prediction, out.residual, out.weights, out.guard))
    state = tracker.state()
    return {name: value for name, value in state.items() if name not in _SETTINGS}, columns
