"""One pure step: states and a batch of samples in, the next states and what the model makes of them out.

A step of one key, a table of many, and a message are the same call with another number of keys.
"""

from __future__ import annotations

from collections.abc import Mapping
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
    z, u = rows.z[order], None if rows.u is None else rows.u[order]
    times = None if rows.times is None else rows.times[order]
    time, grid = entries["time"][:, 0].copy(), entries["grid"].copy()
    clocks = Clocks(time, grid[:, 0], grid[:, 1], entries["elsewhere"].copy())
    line = placed(times, starts, clocks, model.dt, rows.instants)
    batch = Batch(rows, order, starts, of, model.late == "drop", clocks, line)
    work, at, held = _steps(model, entries, batch, z, u)
    model.advance(work)
    return _gathered(model, begun, batch, work, at, held)


def _steps(
    model: Model, entries: dict[str, np.ndarray], batch: Batch, z: Array, u: Array | None
) -> tuple[Work, np.ndarray, Array | None]:
    """Return the steps that the samples make, which of them each sample is (-1: none), and the last inputs."""
    step, steps, of = batch.line.step, batch.line.steps, batch.of
    if u is not None:
        # Before there is an input nothing has begun.
        step, steps = _from_first_input(step, steps, u, of, entries["input"])
    bounds = np.concatenate(([0], np.cumsum(steps)))
    taken = step >= 0
    at = np.where(taken, bounds[of] + step, -1)
    total = int(bounds[-1])
    if taken.all() and total == len(z):
        whole = np.ascontiguousarray(z)
    else:
        whole = np.full((total, z.shape[1]), np.nan)
        whole[at[taken]] = z[taken]
    held = None if u is None else _held(u, at, bounds, entries["input"])
    columns = np.empty((total, len(model.columns)))
    keys, firsts = batch.rows.keys, batch.order[batch.starts[:-1]] if len(batch.order) else batch.order

    def name(i: int) -> Any:
        """Return a key, or its place where there is one alone."""
        key = i if keys is None else keys[firsts[i]]
        return key.item() if isinstance(key, np.generic) else key

    return Work(entries, whole, held, bounds, columns, {}, {}, name), at, held


def _from_first_input(
    step: np.ndarray, steps: np.ndarray, u: Array, of: np.ndarray, before: Array
) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps without those of keys that have had no input yet."""
    good: np.ndarray = np.asarray(np.isfinite(u).all(axis=1))
    if good.all():
        return step, steps
    step, steps = step.copy(), steps.copy()
    waiting: np.ndarray = np.asarray(np.isnan(before).any(axis=1))
    for i in np.unique(of[~good & waiting[of]]).tolist():
        mine = np.flatnonzero(of == i)
        begins = [row for row in mine.tolist() if good[row] and step[row] >= 0]
        first = int(step[begins[0]]) if begins else int(steps[i])
        step[mine] = np.where(step[mine] >= first, step[mine] - first, -1)
        steps[i] -= first
    return step, steps


def _held(u: Array, at: np.ndarray, bounds: np.ndarray, before: Array) -> Array:
    """Return the input of every step: its own, or the one before it."""
    total = int(bounds[-1])
    if total == len(u) and np.isfinite(u).all() and (at >= 0).all():
        return np.ascontiguousarray(u)
    good: np.ndarray = np.asarray(np.isfinite(u).all(axis=1)) & (at >= 0)
    whole = np.concatenate((before, np.full((total, u.shape[1]), np.nan)))
    whole[len(before) + at[good]] = u[good]
    source = np.full(total, -1)
    source[at[good]] = len(before) + at[good]
    first = bounds[:-1][np.diff(bounds) > 0]
    keys = np.flatnonzero(np.diff(bounds) > 0)
    source[first] = np.where(source[first] < 0, keys, source[first])
    # The last one of the same key, since each key's first step has one.
    last = np.maximum.accumulate(np.where(source >= 0, np.arange(total), 0))
    return np.ascontiguousarray(whole[source[last]])


def _gathered(model: Model, begun: np.ndarray, batch: Batch, work: Work, at: np.ndarray, held: Array | None) -> Outcome:
    """Return what became of the rows, and write times, inputs and counts into the states."""
    entries, bounds = work.entries, work.bounds
    rows, order, starts, line = batch.rows, batch.order, batch.starts, batch.line
    said: Reasons = {}
    refused = {i: text for i, (k, text) in work.stopped.items() if k < 0}
    ends = np.diff(bounds)
    for i, (k, text) in work.stopped.items():
        if k >= 0:
            ends[i] = k
        for place in range(starts[i], starts[i + 1]):
            if k < 0 or at[place] >= bounds[i] + k:
                at[place] = -1
                said[place] = text
    for place, text in {**line.noted, **({} if batch.drops else line.late)}.items():
        said.setdefault(place, text)
    if work.missed:
        where = {int(one): place for place, one in enumerate(at.tolist()) if one in work.missed}
        said.update({where[one]: text for one, text in work.missed.items() if one in where})
    taken = at >= 0
    columns = np.full((len(rows.z), len(model.columns)), np.nan)
    columns[order[taken]] = work.columns[at[taken]]
    retained = np.ones(len(rows.z), dtype=bool)
    if batch.drops:
        retained[order[list(line.late)]] = False
    _count(entries, batch, taken, said, refused)
    reasons = dict(rows.said)
    for place, text in said.items():
        say(reasons, int(order[place]), text)
    _keep(batch, work, at, held)
    moved = begun | (np.bincount(batch.of[taken], minlength=len(begun)) > 0)
    return Outcome(entries, moved, columns, np.flatnonzero(retained), reasons, refused)


def _count(
    entries: dict[str, np.ndarray], batch: Batch, taken: np.ndarray, said: Reasons, refused: Mapping[int, str]
) -> None:
    """Count refused and dropped samples, and have the first one after refused ones of a batch before say so."""
    counts, starts, of = entries["refused"], batch.starts, batch.of
    if taken.all() and not (counts[:, 0] > 0.0).any():
        return
    so_far = np.nan_to_num(counts)
    dropped = np.zeros(len(taken), dtype=bool)
    if batch.drops:
        dropped[list(batch.line.late)] = True
    for i in np.unique(np.concatenate((of[~taken], np.flatnonzero(so_far[:, 0] > 0)))).tolist():
        if i in refused or starts[i] == starts[i + 1]:
            continue
        mine = slice(starts[i], starts[i + 1])
        good = np.flatnonzero(taken[mine])
        if good.size and so_far[i, 0]:
            first = int(starts[i] + good[0])
            note = f"refused before this sample: {so_far[i, 0]:.0f}, in the batches before"
            said[first] = f"{said[first]}; {note}" if first in said else note
        after = int(good[-1]) + 1 if good.size else 0
        lost = int((~taken[mine] & ~dropped[mine])[after:].sum())
        now = (0.0 if good.size else so_far[i, 0]) + lost, so_far[i, 1] + int(dropped[mine].sum())
        counts[i] = now if any(now) else np.nan


def _keep(batch: Batch, work: Work, at: np.ndarray, held: Array | None) -> None:
    """Write the times and inputs of the last samples into the states."""
    entries, line, clocks, starts = work.entries, batch.line, batch.clocks, batch.starts
    steps, times = np.diff(work.bounds), batch.rows.times
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
