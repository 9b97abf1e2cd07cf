"""One pure step: states and a batch of samples in, the next states and what the model makes of them out.

A step of one key, a table of many, and a message are the same call with another number of keys.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _state
from robust_filterpy._checks import Array
from robust_filterpy.fleet._advancing import Work
from robust_filterpy.fleet.models import Model
from robust_filterpy.fleet.reading import Clocks, Placed, Reasons, Rows, placed, say
from robust_filterpy.fleet.states import checked, empty


class Outcome(NamedTuple):
    """What became of the rows of a batch."""

    #: States after it, a row for each key.
    entries: dict[str, np.ndarray]
    #: Which keys have a state now, shape (K,).
    moved: np.ndarray
    #: What the model gives for each row, shape (N, c), NaN where it was refused.
    columns: Array
    #: Rows that were not dropped.
    retained: np.ndarray
    #: What is wrong with rows.
    reasons: Reasons
    #: Keys whose states were refused, and why.
    refused: dict[int, str]

    @property
    def errors(self) -> np.ndarray:
        """What is wrong with each row that was not dropped, or None."""
        errors = np.full(len(self.columns), None, dtype=object)
        for row, text in self.reasons.items():
            errors[row] = text
        return errors[self.retained]


def owned(model: Model, state: Any) -> dict[str, Array]:
    """Return the entries of a state of this model, or raise."""
    entries = checked(state, model)
    if "model" in entries and entries["model"][0] != model.fingerprint:
        raise _state.StateError(
            "state: expected one of this model, got one of a model with other matrices, choices or sampling period; "
            "model.adopt(state) goes on from it nevertheless"
        )
    return entries


def started(model: Model, count: int) -> dict[str, np.ndarray]:
    """Return states at the start, in columns."""
    entries = {name: empty(count, shape) for name, shape in model.shapes.items()}
    for name, value in {**model.start(), "model": model.fingerprint}.items():
        # Of any length each key has an array of its own.
        for row in range(count) if entries[name].dtype == object else (slice(None),):
            entries[name][row] = value
    return entries


class Batch(NamedTuple):
    """Samples of many keys, in the order of the keys and in that of time."""

    #: As they came.
    rows: Rows
    #: The rows in the order of the keys.
    order: np.ndarray
    #: Where each key's rows begin, and the end, shape (K + 1,).
    starts: np.ndarray
    #: The key of each.
    of: np.ndarray
    #: Whether late samples are left out without a word.
    drops: bool
    #: Of the keys before.
    clocks: Clocks
    line: Placed


def advance(
    model: Model, entries: dict[str, np.ndarray], begun: np.ndarray, rows: Rows, order: np.ndarray, starts: np.ndarray
) -> Outcome:
    """Take the samples of many keys, whose states are written over."""
    of = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    if rows.u is not None:
        # Before there is an input nothing has begun.
        waiting, given = np.isnan(entries["input"]).any(axis=1)[of], np.isfinite(rows.u[order]).all(axis=1)
        so_far = np.concatenate(([0], np.cumsum(given)))
        there = ~waiting | (so_far[1:] > so_far[starts[of]])
        order, of = order[there], of[there]
        starts = np.searchsorted(of, np.arange(len(starts)))
    times = None if rows.times is None else rows.times[order]
    time, grid = entries["time"][:, 0].copy(), entries["grid"].copy()
    clocks = Clocks(time, grid[:, 0], grid[:, 1], entries["elsewhere"].copy())
    line = placed(times, starts, clocks, model.dt, rows.instants)
    batch = Batch(rows, order, starts, of, model.late == "drop", clocks, line)
    work, at = _steps(model, entries, batch)
    model.advance(work)
    return _gathered(model, begun, batch, work, at)


def _steps(model: Model, entries: dict[str, np.ndarray], batch: Batch) -> tuple[Work, np.ndarray]:
    """Return the steps that the samples make, and which of them each sample is (-1: none)."""
    rows, order, line = batch.rows, batch.order, batch.line
    bounds = np.concatenate(([0], np.cumsum(line.steps)))
    taken, z = line.step >= 0, rows.z[order]
    at = np.where(taken, bounds[batch.of] + line.step, -1)
    whole = np.full((bounds[-1], z.shape[1]), np.nan)
    whole[at[taken]] = z[taken]
    held = None if rows.u is None else _held(rows.u[order], at, bounds, entries["input"])

    def name(i: int) -> Any:
        """Return a key, or its place where there is one alone."""
        return i if rows.keys is None else rows.keys[order[batch.starts[i]]]

    return Work(entries, whole, held, bounds, np.empty((len(whole), len(model.columns))), {}, {}, name), at


def _held(u: Array, at: np.ndarray, bounds: np.ndarray, before: Array) -> Array:
    """Return the input of every step: its own, or the one before it."""
    given = np.isfinite(u).all(axis=1) & (at >= 0)
    of = np.repeat(np.arange(len(before)), np.diff(bounds))
    whole, last = np.empty((len(of), u.shape[1])), np.full(len(of), -1)
    whole[at[given]], last[at[given]] = u[given], at[given]
    last = np.maximum.accumulate(last)
    return np.where((last >= bounds[of])[:, None], whole[last], before[of])


def _gathered(model: Model, begun: np.ndarray, batch: Batch, work: Work, at: np.ndarray) -> Outcome:
    """Return what became of the rows, and write times, inputs and counts into the states."""
    rows, order, starts, line, bounds = batch.rows, batch.order, batch.starts, batch.line, work.bounds
    said: Reasons = {}
    for i, (k, text) in work.stopped.items():
        for place in range(starts[i], starts[i + 1]):
            if k < 0 or at[place] >= bounds[i] + k:
                at[place] = -1
                said[place] = text
    for place, text in {**line.noted, **({} if batch.drops else line.late)}.items():
        said.setdefault(place, text)
    if work.missed:
        where = {int(one): place for place, one in enumerate(at.tolist()) if one in work.missed}
        said.update({where[one]: text for one, text in work.missed.items() if one in where})
    taken, retained = at >= 0, np.ones(len(rows.z), dtype=bool)
    columns = np.full((len(rows.z), len(model.columns)), np.nan)
    columns[order[taken]] = work.columns[at[taken]]
    if batch.drops and line.late:
        late, dropped = list(line.late), work.entries["dropped"]
        retained[order[late]] = False
        keys, counts = np.unique(batch.of[late], return_counts=True)
        dropped[keys] = np.nan_to_num(dropped[keys]) + counts[:, None]
    reasons = dict(rows.said)
    for place, text in said.items():
        say(reasons, int(order[place]), text)
    _keep(batch, work, at)
    moved = begun | (np.bincount(batch.of[taken], minlength=len(begun)) > 0)
    refused = {i: text for i, (k, text) in work.stopped.items() if k < 0}
    return Outcome(work.entries, moved, columns, np.flatnonzero(retained), reasons, refused)


def _keep(batch: Batch, work: Work, at: np.ndarray) -> None:
    """Write the times and inputs of the last samples into the states."""
    entries, line, clocks, starts = work.entries, batch.line, batch.clocks, batch.starts
    steps, times, held = np.diff(work.bounds), batch.rows.times, work.u
    if times is not None:
        times = times[batch.order]
        entries["time"][:, 0], entries["grid"][:] = line.clocks.last, np.column_stack(line.clocks[1:3])
        entries["elsewhere"][:] = line.clocks.elsewhere
    if held is not None:
        some = steps > 0
        entries["input"][some] = held[work.bounds[1:][some] - 1]
    for i, (k, _) in work.stopped.items():
        # It stands where it stopped, after k steps.
        mine = slice(starts[i], starts[i + 1])
        done = np.flatnonzero(at[mine] >= 0)
        left = float(steps[i] - max(k, 0))
        entries["time"][i], entries["grid"][i] = clocks.last[i], (clocks.origin[i], clocks.step[i])
        if times is not None and done.size:
            entries["time"][i] = times[mine][done[-1]]
            entries["grid"][i] = line.clocks.origin[i], line.clocks.step[i] - left
        if held is not None and k > 0:
            entries["input"][i] = held[work.bounds[i] + k - 1]
