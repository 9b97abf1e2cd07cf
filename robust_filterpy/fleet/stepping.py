"""One pure step: a state and a batch of one key's samples in, the next state and what the model makes of them out."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _state
from robust_filterpy._checks import Array
from robust_filterpy.fleet.batches import Batch, read
from robust_filterpy.fleet.models import Job, Model
from robust_filterpy.fleet.timeline import Timeline, seconds, timeline

__all__ = ["step"]


class Prepared(NamedTuple):
    """A batch of one key, ready for its model."""

    batch: Batch
    line: Timeline
    job: Job


def step(model: Model, state: Mapping[str, Any] | None, batch: Any) -> tuple[dict[str, Array] | None, Any]:
    """Take one key's next samples and change nothing: the signature of stateful maps everywhere.

    Parameters
    ----------
    model : FilterModel or TrackerModel
        What all keys have in common.
    state : mapping of str to ndarray, or None
        What the step before returned, or `unpack` made of it; None at the start. A filter's or tracker's own
        ``state()`` serves too, its matrices being the model's.
    batch : array_like, shape (N, columns), or DataFrame, or Arrow table
        The samples in order, N >= 0. An array has the time first, if ``model.time`` is set, then the measurements, then
        the inputs; a table has columns by name. NaN is a missing measurement.

    Returns
    -------
    state : dict of str to ndarray, or None
        What the next step goes on from; None if there has been no sample yet.
    output : mapping of str to ndarray, or DataFrame, or Arrow table
        ``model.columns`` for each sample that was taken, in the form of the batch: columns by name for an array, and
        the times too for a table, whose index is kept.

    Raises
    ------
    ValueError, TypeError
        If the state is of another model, a column is missing or holds no numbers, or a sample is late and
        ``model.late`` is "refuse". state and batch are as they were, and can be used again.
    LinAlgError
        If a correction is impossible; the step is named.

    Notes
    -----
    However a recording is cut into batches, the numbers are the same to the last bit, on machines with the same
    processor, packages and compiled kernels (``python -m robust_filterpy compile``).

    Examples
    --------
    >>> from robust_filterpy import RobustKalmanFilter
    >>> from robust_filterpy.fleet import FilterModel
    >>> kf = RobustKalmanFilter(1, 1)
    >>> kf.H, kf.Q = np.eye(1), 0.01 * np.eye(1)
    >>> model = FilterModel(kf)
    >>> state, output = step(model, None, [[0.1], [-0.2]])
    >>> state, output = step(model, state, [[1e6], [np.nan], [0.1]])
    >>> bool(np.abs(output["x0"]).max() < 1.0), output["weight0"].round(2)
    (True, array([ 0., nan,  1.]))
    """
    ready = prepared(model, state, batch)
    if not len(ready.job.z):
        kept = None if state is None else {name: np.array(state[name], dtype=float) for name in state}
        return kept, output_of(model, ready, np.empty((0, len(model.columns))))
    (done,) = model.advance([ready.job])
    if isinstance(done, Exception):
        raise done
    return next_state(done.state, ready), output_of(model, ready, done.columns)


def prepared(model: Model, state: Mapping[str, Any] | None, batch: Any) -> Prepared:
    """Return a batch with the steps that it makes, or raise."""
    if not isinstance(model, Model):
        raise TypeError(f"model: expected a FilterModel or a TrackerModel, got {type(model).__name__}")
    if state is not None:
        _state.kind_of(state)
    m, p = model.widths
    found = read(batch, model, m, p)
    times = None if found.times is None else seconds(found.times)
    last = float(np.ravel(state["time"])[0]) if state is not None and "time" in state else np.nan
    line = timeline(times, len(found.z), last, model.dt, model.late)
    return Prepared(found, line, Job(state, *spread(found, line, state)))


def spread(batch: Batch, line: Timeline, state: Mapping[str, Any] | None) -> tuple[Array, Array | None]:
    """Return measurements and inputs of every step: NaN in a gap, and the input before it."""
    z, u = batch.z, batch.u
    if line.steps == len(z) == len(line.kept):
        return np.ascontiguousarray(z), None if u is None else np.ascontiguousarray(u)
    whole = np.full((line.steps, z.shape[1]), np.nan)
    whole[line.place] = z[line.kept]
    if u is None:
        return whole, None
    chosen = u[line.kept]
    before = np.ravel(state["input"]) if state is not None and "input" in state else chosen[0]
    held = np.vstack((before[None], chosen))[np.searchsorted(line.place, np.arange(line.steps), side="right")]
    return whole, np.ascontiguousarray(held)


def next_state(state: dict[str, Array], ready: Prepared) -> dict[str, Array]:
    """Return the model's state with the time and the input of the last sample, where there are any."""
    state = dict(state)
    if ready.batch.times is not None:
        state["time"] = np.array([ready.line.last])
        if ready.job.u is not None:
            state["input"] = ready.job.u[-1].copy()
    return state


def output_of(model: Model, ready: Prepared, columns: Array) -> Any:
    """Return what a model made of a batch, in the form of the batch."""
    place, rows = ready.line.place, ready.line.kept
    found = {name: columns[place, j] for j, name in enumerate(model.columns)}
    return ready.batch.like(found, rows)
