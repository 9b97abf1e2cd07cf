"""Tables of many keys: every key's samples through the model, a row or key that is refused losing nobody else's."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._fill_values import without_fill_values
from robust_filterpy._warning import warn
from robust_filterpy.fleet.models import Model
from robust_filterpy.fleet.reading import NOBODY, Rows, read_table, reasons, say
from robust_filterpy.fleet.states import States, taken
from robust_filterpy.fleet.stepping import advance, owned, started
from robust_filterpy.fleet.timeline import grouped, strays


class _Keys(NamedTuple):
    """The keys of a table, and their rows."""

    names: list[Any]
    order: np.ndarray
    starts: np.ndarray


def filter_table(
    table: Any,
    model: Model,
    *,
    key: str = "device",
    sort: bool = True,
) -> Any:
    """Filter a table of many keys, each from the model's start.

    Parameters
    ----------
    table : DataFrame or Arrow table
        A row for each sample, in any order. Of pandas, polars, Arrow, or any other kind that narwhals reads.
    model : FilterModel or TrackerModel
        What all keys have in common, and which columns are its time, measurements and inputs.
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
    >>> found = filter_table(table, FilterModel(kf, time="t", measurements=["z"]))
    >>> found["x0"].round(2).tolist()
    [0.05, 0.0, 0.58, nan]
    >>> found["error"][3]
    "device 'b': time: expected a sample later than the one at 1, got 1, a duplicate"
    """
    found = _taken(model, None, table, key, sort, whole=True)[1]
    refused, keys = reasons(found, key)
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
    return found


def step_table(
    model: Model,
    states: Any,
    table: Any,
    *,
    key: str = "device",
    sort: bool = False,
) -> tuple[States, Any]:
    """Take the next samples of many keys, as `step` does those of one, and change nothing.

    Parameters
    ----------
    model : FilterModel or TrackerModel
        What all keys have in common.
    states : States, or mapping of key to state, or Arrow table of states, or None
        What the call before returned, or its ``to_arrow()``; keys that it does not hold start.
    table, key
        As in `filter_table`.
    sort : bool, default False
        As in `filter_table`; by default a late sample is one, whether its batch or the one before has the newer.

    Returns
    -------
    states : States
        Of all keys so far, a mapping; that of a key that was refused is as it was.
    output : DataFrame or Arrow table
        As in `filter_table`.

    Raises
    ------
    ValueError, TypeError
        As in `filter_table`.
    """
    return _taken(model, states, table, key, sort)


def _taken(model: Model, states: Any, table: Any, key: str, sort: bool, whole: bool = False) -> tuple[States, Any]:
    """Return states and output of the next samples of many keys, or of all that there are."""
    if not isinstance(model, Model):
        raise TypeError(f"model: expected a FilterModel or a TrackerModel, got {type(model).__name__}")
    rows = read_table(table, model, key)
    before = taken(states, model)
    keys = _known_ones(_Keys(*grouped(rows.keys, len(rows.z))), before, model, rows)
    if sort and rows.times is not None and _out_of_order(rows.times[keys.order], keys.starts):
        of = np.repeat(np.arange(len(keys.names)), np.diff(keys.starts))
        keys = keys._replace(order=keys.order[np.lexsort((rows.times[keys.order], of))])
    if whole:
        rows.z[keys.order] = without_fill_values(f"{key}s' measurements", rows.z[keys.order])[0]
    if whole and sort and model.dt is not None and rows.times is not None:
        for row in keys.order[strays(rows.times[keys.order], keys.starts, model.dt)].tolist():
            say(rows.said, row, f"time: expected one near the others of its {key}, got one far before them")
            rows.times[row] = np.nan
    places = before.find(keys.names)
    entries, known = started(model, len(keys.names)), places >= 0
    for name, column in entries.items():
        column[known] = before.columns[name][places[known]]
    entries["model"][:] = model.fingerprint
    outcome = advance(model, entries, known, rows, keys.order, keys.starts)
    for row, sentence in outcome.told.items():
        own = NOBODY if rows.keys is None else rows.keys[row]
        if own is not NOBODY:
            outcome.told[row] = f"{key} {(own.item() if isinstance(own, np.generic) else own)!r}: {sentence}"
    outcome.moved[list(outcome.refused)] = False
    names, moved = keys.names, np.flatnonzero(outcome.moved)
    if len(moved) < len(names):
        names, places = [names[i] for i in moved.tolist()], places[moved]
        entries = {name: column[moved] for name, column in entries.items()}
    after = before.updated(names, places, entries)
    every = len(outcome.kept) == len(rows.z)
    columns = {
        name: outcome.columns[:, j] if every else outcome.columns[outcome.kept, j]
        for j, name in enumerate(model.columns)
    }
    return after, rows.like(outcome.kept, {**columns, "error": outcome.errors})


def _out_of_order(times: np.ndarray, starts: np.ndarray) -> bool:
    """Tell whether some key's samples, which stand together, are in another order than their times."""
    with np.errstate(invalid="ignore"):
        back = np.diff(np.where(np.isnan(times), np.inf, times)) < 0.0
    begins = starts[1:-1]
    back[begins[(begins > 0) & (begins < len(times))] - 1] = False
    return bool(back.any())


def _known_ones(keys: _Keys, before: States, model: Model, rows: Rows) -> _Keys:
    """Return the keys without nobody, and without those whose states are damaged or of another model, named."""
    prints = before.columns["model"][:, 0]
    others = np.flatnonzero((prints != model.fingerprint) & ~np.isnan(prints))
    strange = set(before.odd) | {before.name(i) for i in others.tolist()}
    gone = [i for i, name in enumerate(keys.names) if name is NOBODY or name in strange] if (
        strange or any(name is NOBODY for name in keys.names)) else []  # fmt: skip
    if not gone:
        return keys
    lost = np.zeros(len(keys.order), dtype=bool)
    for i in gone:
        mine = slice(keys.starts[i], keys.starts[i + 1])
        lost[mine] = True
        if keys.names[i] is not NOBODY:
            why = _refusal(before[keys.names[i]], model)
            for row in keys.order[mine].tolist():
                rows.said[row] = why
    counts = np.delete(np.diff(keys.starts), gone)
    left = set(gone)
    names = [name for i, name in enumerate(keys.names) if i not in left]
    return _Keys(names, keys.order[~lost], np.concatenate(([0], np.cumsum(counts))))


def _refusal(state: Mapping[str, Any], model: Model) -> str:
    """Return what is wrong with a state."""
    try:
        owned(model, state)
    except (TypeError, ValueError) as error:
        return str(error)
    return "state: expected one of this model"
