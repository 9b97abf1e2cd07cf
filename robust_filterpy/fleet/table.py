"""Tables of many keys: every key's samples through the model, a row or key that is refused losing nobody else's."""

from __future__ import annotations

from collections import Counter
from itertools import compress
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _state
from robust_filterpy._fill_values import without_fill_values
from robust_filterpy._warning import warn
from robust_filterpy.fleet.models import Model
from robust_filterpy.fleet.reading import NOBODY, Rows, grouped, read_array, read_table, say, strays
from robust_filterpy.fleet.states import States, taken
from robust_filterpy.fleet.stepping import Outcome, advance, owned, started
from robust_filterpy.fusion import Fusion


class _Keys(NamedTuple):
    """The keys of a table, and their rows."""

    names: list[Any]
    order: np.ndarray
    starts: np.ndarray


def filter_table(model: Model, table: Any, *, key: str = "device", sort: bool = True) -> Any:
    """Filter a table of many keys, each from the model's start.

    Parameters
    ----------
    model : FilterModel or TrackerModel
        What all keys have in common, and which columns are its time, measurements and inputs.
    table : DataFrame or Arrow table
        A row for each sample, in any order. Of pandas, polars, Arrow, or any other kind that narwhals reads.
    key : str, default "device"
        Column that says whose sample it is.
    sort : bool, default True
        Whether the samples of each key are taken in order of their times. With False they are taken as they stand, and
        one that is not later than that before it is late, as in a stream. Without times the rows have to be in order.

    Returns
    -------
    DataFrame or Arrow table
        Key, time, ``model.columns`` and ``error`` for each row that was not dropped, with the index and in the order of
        the table. A row that was refused has NaN and the reason, with the key's name, in ``error``; one whose
        measurement was refused has the reason there, too; otherwise that is missing.

    Warns
    -----
    UserWarning
        If a measurement has fill values (-9999), which repeat exactly and far outside the rest of the table, and are
        taken for missing.
    UserWarning
        If more than half of the rows, or of those of a key, have an error, as those of a column of text have.

    Raises
    ------
    ValueError
        If a column is missing, or there are too few or too many.
    TypeError
        If model is none, or table no table.

    Examples
    --------
    >>> import pandas as pd
    >>> from robust_filterpy import RobustKalmanFilter
    >>> from robust_filterpy.fleet import FilterModel
    >>> kf = RobustKalmanFilter(1, 1)
    >>> kf.H, kf.Q = np.eye(1), 0.01 * np.eye(1)
    >>> table = pd.DataFrame({"device": ["a", "b", "a", "b"], "t": [0.0, 1.0, 1.0, 1.0], "z": [0.1, 0.0, 1e6, 5.0]})
    >>> found = filter_table(FilterModel(kf, time="t", measurements=["z"]), table)
    >>> found["x0"].round(2).tolist()
    [0.05, 0.0, 0.61, nan]
    >>> found["error"][3]
    "device 'b': time: expected a sample later than the one at 1, got 1, a duplicate"
    """
    if not isinstance(model, Model):
        raise TypeError(f"model: expected a FilterModel or a TrackerModel, got {type(model).__name__}")
    _, read, outcome = _taken(model, None, table, key, sort, whole=True)
    output = _output(model, read, outcome)
    if not outcome.reasons:
        return output
    names = read.keys or []
    keys = [None if names[row] is NOBODY else names[row] for row in outcome.retained.tolist()]
    refused = [(name, why) for name, why in zip(keys, outcome.errors, strict=True) if why is not None]
    bad, rows = Counter(name for name, _ in refused), Counter(keys)
    most = [(name, why) for name, why in dict(reversed(refused)).items() if 2 * bad[name] > rows[name]]
    if 2 * len(refused) > len(keys) or most:
        which = ", ".join(f"{name!r} ({bad[name]} of {rows[name]})" for name, _ in most[:5])
        first = most[0][1] if most else refused[0][1]
        mend = "; sort=True puts the samples of each key in order" if first.endswith(", late") else ""
        warn(
            f"filter_table: {len(refused)} of {len(keys)} rows have an error, most of those of {len(most)} {key}(s): "
            f"{which}; the first: {first}{mend}"
        )
    return output


def step(
    model: Model | Fusion, state: Any, batch: Any, *, key: str | None = None, sort: bool = False
) -> tuple[Any, Any]:
    """Take the next samples, of one key or of many, and change nothing: the signature of stateful maps everywhere.

    Parameters
    ----------
    model : FilterModel, TrackerModel or Fusion
        What all keys have in common. Of a `robust_filterpy.fusion.Fusion` it is `Fusion.step`, whose batch has a row
        for each reading.
    state : mapping of str to ndarray, or None; with key, States, or mapping of key to state, or Arrow table of states
        What the step before returned, or `pack` made of it, or JSON of its lists; None at the start. A filter's or
        tracker's own ``state()`` serves too, its matrices being the model's.
    batch : array_like, shape (N, columns), or DataFrame, or Arrow table
        The samples in order, N >= 0. An array has the time first, if ``model.time`` is set, then the measurements, then
        the inputs; a table has columns by name. NaN is a missing measurement.
    key : str, optional
        Column of a table that says whose sample it is, of many keys; those that state does not hold start. Default: all
        samples are of one.
    sort : bool, default False
        With key, as in `filter_table`; by default a late sample is one, whether its batch or the one before has the
        newer.

    Returns
    -------
    state : dict of str to ndarray, or None; with key, States
        What the next step goes on from; None if there has been no sample yet. With key a mapping of all keys so far;
        the state of one that was refused is as it was.
    output : mapping of str to ndarray, or DataFrame, or Arrow table
        ``model.columns`` for each sample, in the form of the batch: columns by name for an array, and the times too for
        a table, whose index is kept; and ``error``: None, or what is wrong with the sample.

    Raises
    ------
    ValueError
        If the state is damaged or of another model (`Model.adopt` asks for it nevertheless), or a column is missing.
        state and batch are as they were, and can be used again.
    TypeError
        If model or state is something else.

    Notes
    -----
    However a recording is cut into batches, the numbers are the same to the last bit, on machines with the same
    processor and packages, of which all or none have the kernel (``python -m robust_filterpy`` says so).

    One bad sample costs one sample. A measurement that is no number is missing; a step with an input that is none holds
    the one before it; a sample that has no time, is late, or lies off the grid is refused, and has NaN. ``error`` says
    which.

    Examples
    --------
    >>> from robust_filterpy import RobustKalmanFilter
    >>> from robust_filterpy.fleet import FilterModel
    >>> kf = RobustKalmanFilter(1, 1)
    >>> kf.H, kf.Q = np.eye(1), 0.01 * np.eye(1)
    >>> model = FilterModel(kf)
    >>> state, output = step(model, None, [[0.1], [-0.2]])
    >>> state, output = step(model, state, [[1e6], [np.nan], ["text"], [0.1]])
    >>> bool(np.abs(output["x0"]).max() < 1.0), output["weight0"].round(2)
    (True, array([ 0., nan, nan,  1.]))
    >>> output["error"][2]
    "z: expected a finite number or NaN (missing), got 'text'"
    """
    if isinstance(model, Fusion):
        return model.step(state, batch)
    if not isinstance(model, Model):
        raise TypeError(f"model: expected a FilterModel or a TrackerModel, got {type(model).__name__}")
    if key is not None:
        states, rows, outcome = _taken(model, state, batch, key, sort)
        return states, _output(model, rows, outcome)
    before = None if state is None else owned(model, state)
    is_table = hasattr(batch, "columns") or hasattr(batch, "schema")
    rows = read_table(batch, model, None) if is_table else read_array(batch, model)
    entries = started(model, 1)
    if before is not None:
        for name, value in before.items():
            entries[name][0] = value
    _, order, starts = grouped(None, len(rows.z))
    outcome = advance(model, entries, np.array([before is not None]), rows, order, starts)
    if 0 in outcome.refused:
        raise _state.StateError(outcome.refused[0])
    after = States(model.label, [], outcome.entries).row(0) if outcome.moved[0] else None
    return after, _output(model, rows, outcome)


def _taken(
    model: Model, states: Any, table: Any, key: str, sort: bool, whole: bool = False
) -> tuple[States, Rows, Outcome]:
    """Take the next samples of many keys, or all that there are; return the states, and what became of the rows."""
    rows = read_table(table, model, key)
    before = taken(states, model)
    keys = _usable(_Keys(*grouped(rows.keys, len(rows.z))), before, model, rows)
    if sort and rows.times is not None:
        of = np.repeat(np.arange(len(keys.names)), np.diff(keys.starts))
        times = np.where(np.isnan(rows.times), np.inf, rows.times)[keys.order]
        # Sorting takes longer than to look whether it is needed.
        if ((times[1:] < times[:-1]) & (of[1:] == of[:-1])).any():
            keys = keys._replace(order=keys.order[np.lexsort((times, of))])
    if whole:
        rows.z[keys.order] = without_fill_values(f"{key}s' measurements", rows.z[keys.order])[0]
    if whole and sort and model.dt is not None and rows.times is not None:
        for row in keys.order[strays(rows.times[keys.order], keys.starts, model.dt)].tolist():
            say(rows.said, row, f"time: expected one near the others of its {key}, got one far before them")
            rows.times[row] = np.nan
    places = before.find(keys.names)
    entries, begun = started(model, len(keys.names)), places >= 0
    for name, column in entries.items():
        column[begun] = before.columns[name][places[begun]]
    entries["model"][:] = model.fingerprint
    outcome = advance(model, entries, begun, rows, keys.order, keys.starts)
    for row, sentence in outcome.reasons.items():
        own = NOBODY if rows.keys is None else rows.keys[row]
        if own is not NOBODY:
            outcome.reasons[row] = f"{key} {own!r}: {sentence}"
    outcome.moved[list(outcome.refused)] = False
    names, moved = keys.names, np.flatnonzero(outcome.moved)
    if len(moved) < len(names):
        names, places = [names[i] for i in moved.tolist()], places[moved]
        entries = {name: column[moved] for name, column in entries.items()}
    return before.updated(names, places, entries), rows, outcome


def _output(model: Model, rows: Rows, outcome: Outcome) -> Any:
    """Return what the model gives for the rows that were taken, in the form of the batch."""
    every = len(outcome.retained) == len(rows.z)
    taken_columns = outcome.columns if every else outcome.columns[outcome.retained]
    columns = {name: taken_columns[:, j] for j, name in enumerate(model.columns)}
    return rows.like(outcome.retained, {**columns, "error": outcome.errors})


def _usable(keys: _Keys, before: States, model: Model, rows: Rows) -> _Keys:
    """Return the keys without nobody, and without those whose states are damaged or of another model, named."""
    prints = before.columns["model"][:, 0]
    others = np.flatnonzero((prints != model.fingerprint) & ~np.isnan(prints)).tolist()
    refused = {NOBODY, *before.odd, *(before.keys_of_rows[i] for i in others)}
    gone = np.array([name in refused for name in keys.names], dtype=bool)
    for i in np.flatnonzero(gone).tolist():
        if keys.names[i] is not NOBODY:
            try:
                owned(model, before[keys.names[i]])
            except (TypeError, ValueError) as error:
                mine = keys.order[keys.starts[i] : keys.starts[i + 1]]
                rows.said.update(dict.fromkeys(mine.tolist(), str(error)))
    counts = np.diff(keys.starts)
    names = list(compress(keys.names, ~gone))
    return _Keys(names, keys.order[~np.repeat(gone, counts)], np.concatenate(([0], np.cumsum(counts[~gone]))))
