"""Tables of many keys: every key's samples through the model, a key that is refused losing nobody else's."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.fleet.batches import Batch
from robust_filterpy.fleet.models import Job, Model
from robust_filterpy.fleet.stepping import Prepared, next_state, spread
from robust_filterpy.fleet.timeline import Timeline, seconds, timeline

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["filter_table", "step_table"]

_REFUSED = (ValueError, TypeError, np.linalg.LinAlgError)


class _Sorted(NamedTuple):
    """The rows of a table, those of a key together."""

    order: np.ndarray
    """Row of the table, for each row here."""
    keys: Any
    starts: np.ndarray
    """First row of each key, and the end; shape (keys + 1,)."""
    times: Array | None
    z: Array
    u: Array | None


def filter_table(
    table: pd.DataFrame,
    model: Model,
    *,
    key: str = "device",
    time: str | None = None,
    measurements: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    sort: bool = False,
) -> pd.DataFrame:
    """Filter a table of many keys, each from the model's start.

    Parameters
    ----------
    table : pandas.DataFrame
        A row for each sample; those of a key in order, whatever stands between them.
    model : FilterModel or TrackerModel
        What all keys have in common.
    key : str, default "device"
        Column that says whose sample it is.
    time, measurements, inputs : optional
        Columns, as in `Model`; as the model has them if not given.
    sort : bool, default False
        Whether to put the samples of each key in order of time first, as an engine that has shuffled them needs.

    Returns
    -------
    pandas.DataFrame
        Key, time, ``model.columns`` and ``error`` for each row that was taken, with the index and in the order of the
        table. A key that was refused has NaN and the reason, with the key's name, in ``error``; otherwise that is None.

    Raises
    ------
    ValueError, TypeError
        If a column is missing, or model is no model.

    Notes
    -----
    The function that engines call on their partitions: see `robust_filterpy.fleet.dask` and
    `robust_filterpy.fleet.spark`. All keys with equally many samples go through the compiled loops together, and every
    key's numbers are those of `step`, to the last bit.

    Examples
    --------
    >>> import pandas as pd
    >>> from robust_filterpy import RobustKalmanFilter
    >>> from robust_filterpy.fleet import FilterModel
    >>> kf = RobustKalmanFilter(1, 1)
    >>> kf.H, kf.Q = np.eye(1), 0.01 * np.eye(1)
    >>> table = pd.DataFrame({"device": ["a", "b", "a", "b"], "t": [0, 0, 1, 0], "z": [0.1, 5.0, 1e6, 5.0]})
    >>> found = filter_table(table, FilterModel(kf), time="t", measurements=["z"])
    >>> found["x0"].round(2).tolist()
    [0.05, nan, 0.61, nan]
    >>> found["error"][1][:50]
    "device 'b': time: expected each sample later than "
    """
    return step_table(model, None, table, key=key, time=time, measurements=measurements, inputs=inputs, sort=sort)[1]


def step_table(
    model: Model,
    states: Mapping[Any, Mapping[str, Any]] | None,
    table: pd.DataFrame,
    *,
    key: str = "device",
    time: str | None = None,
    measurements: Sequence[str] | None = None,
    inputs: Sequence[str] | None = None,
    sort: bool = False,
) -> tuple[dict[Any, dict[str, Array]], pd.DataFrame]:
    """Take the next samples of many keys, as `step` does those of one, and change nothing.

    Parameters
    ----------
    model : FilterModel or TrackerModel
        What all keys have in common.
    states : mapping of key to state, or None
        What the call before returned; keys that it does not hold start.
    table, key, time, measurements, inputs, sort
        As in `filter_table`.

    Returns
    -------
    states : dict of key to state
        Of all keys so far; that of a key that was refused is as it was.
    output : pandas.DataFrame
        As in `filter_table`.

    Raises
    ------
    ValueError, TypeError
        As in `filter_table`.
    """
    if not isinstance(model, Model):
        raise TypeError(f"model: expected a FilterModel or a TrackerModel, got {type(model).__name__}")
    model = model.reading(time=time, measurements=measurements, inputs=inputs)
    names = _names(table, model, key)
    states = {} if states is None else dict(states)
    errors: dict[int, str] = {}
    rows = _sorted(table, model, key, names, sort, errors)
    output = np.empty((len(rows.order), len(model.columns)))
    taken = np.ones(len(rows.order), dtype=bool)
    jobs, ready = [], []
    quick = _in_step(model, rows, states)
    for i, (name, start, stop) in enumerate(
        zip(rows.keys, rows.starts[:-1].tolist(), rows.starts[1:].tolist(), strict=True)
    ):
        if i in errors:
            continue
        z, u = rows.z[start:stop], None if rows.u is None else rows.u[start:stop]
        times, state = None if rows.times is None else rows.times[start:stop], states.get(name)
        try:
            if quick[i]:
                line = Timeline(_EVERY, _EVERY, stop - start, np.nan if times is None else times[-1])
                one = Prepared(Batch(times, z, u, _nothing), line, Job(state, z, u))
            else:
                one = _slowly(model, state, times, z, u)
        except _REFUSED as error:
            errors[i] = f"{key} {name!r}: {error}"
            continue
        jobs.append(one.job)
        ready.append((i, name, start, stop, one))
    for (i, name, start, stop, one), done in zip(ready, model.advance(jobs), strict=True):
        if isinstance(done, Exception):
            errors[i] = f"{key} {name!r}: {done}"
            continue
        kept, place = one.line.kept, one.line.place
        if kept is _EVERY:
            output[start:stop] = done.columns
        else:
            taken[start:stop] = False
            taken[start + kept], output[start + kept] = True, done.columns[place]
        states[name] = next_state(done.state, one)
    for i in errors:
        output[rows.starts[i] : rows.starts[i + 1]] = np.nan
    return states, _assembled(table, model, key, rows, output, taken, errors)


#: Stands for all rows of a key, each a step.
_EVERY = np.zeros(0, dtype=int)


def _nothing(found: Any, rows: Any) -> Any:
    """Return nothing: the whole table is put together at the end."""


def _names(table: Any, model: Model, key: str) -> tuple[list[str], list[str]]:
    """Return the columns of measurements and of inputs, or raise if the table lacks one."""
    columns = list(getattr(table, "columns", ()))
    inputs = list(model.inputs or ())
    measurements = model.measurements
    if measurements is None:
        measurements = tuple(name for name in columns if name not in (key, model.time) and name not in inputs)
    missing = [name for name in (key, model.time, *measurements, *inputs) if name is not None and name not in columns]
    if missing:
        raise ValueError(f"table: expected the columns {missing}, got {columns}")
    m, p = model.widths
    for what, names, allowed in (("measurements", measurements, (m,)), ("inputs", inputs, (0, p))):
        if len(names) not in allowed:
            raise ValueError(f"{what}: expected {allowed[-1]} column(s) for the model, got {list(names)}")
    return list(measurements), inputs


def _sorted(
    table: Any, model: Model, key: str, names: tuple[list[str], list[str]], sort: bool, errors: dict[int, str]
) -> _Sorted:
    """Return the rows of each key together, and note the keys whose columns hold no numbers."""
    import pandas as pd

    codes, keys = pd.factorize(table[key], use_na_sentinel=False)
    order = np.argsort(codes, kind="stable")
    starts = np.searchsorted(codes[order], np.arange(len(keys) + 1))
    listed = keys.tolist()
    for i, absent in enumerate(pd.isna(keys)):
        if absent:
            errors[i] = f"{key}: expected a name or number in each row, got none"
    times = None if model.time is None else _column(table[model.time], seconds, order, starts, listed, key, errors)
    if sort and times is not None:
        within = np.lexsort((times, codes[order]))
        order, times = order[within], times[within]
    measured = [_column(table[name], _measured(name), order, starts, listed, key, errors) for name in names[0]]
    inputs = [_column(table[name], _given(name), order, starts, listed, key, errors) for name in names[1]]
    z = np.column_stack(measured) if measured else np.empty((len(order), 0))
    return _Sorted(order, listed, starts, times, z, np.column_stack(inputs) if inputs else None)


def _column(
    column: Any, convert: Any, order: np.ndarray, starts: np.ndarray, keys: list[Any], key: str, errors: dict[int, str]
) -> Array:
    """Return a column as numbers in the order of the keys; where that fails, key by key, and note what failed."""
    values = column.to_numpy()[order]
    try:
        return np.asarray(convert(values))
    except _REFUSED:
        found = np.full(len(values), np.nan)
    for i, (start, stop) in enumerate(zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True)):
        try:
            found[start:stop] = convert(values[start:stop])
        except _REFUSED as error:
            errors.setdefault(i, f"{key} {keys[i]!r}: {error}")
    return found


def _measured(name: str) -> Any:
    """Return what makes numbers of a measured column."""

    def convert(values: Any) -> Array:
        """Return measurements, NaN where missing, or raise."""
        found = _checks.numbers(name, values)
        if np.isinf(found).any():
            raise ValueError(f"{name}: expected finite numbers or NaN (missing), got infinity")
        return found

    return convert


def _given(name: str) -> Any:
    """Return what makes numbers of a column of inputs."""

    def convert(values: Any) -> Array:
        """Return inputs, or raise."""
        found = _checks.numbers(name, values)
        if not np.isfinite(found).all():
            raise ValueError(f"{name}: expected finite numbers, since an input cannot be missing")
        return found

    return convert


def _in_step(model: Model, rows: _Sorted, states: Mapping[Any, Any]) -> np.ndarray:
    """Return for which keys every sample is a step, all at once; the others are looked at one by one."""
    count = len(rows.starts) - 1
    if rows.times is None or not count:
        return np.ones(count, dtype=bool)
    last = np.full(count, np.nan)
    if states:
        for i, name in enumerate(rows.keys):
            state = states.get(name)
            if state is not None and "time" in state:
                last[i] = np.ravel(state["time"])[0]
    apart = np.diff(rows.times, prepend=np.nan)
    apart[rows.starts[:-1]] = rows.times[rows.starts[:-1]] - last
    if model.dt is None:
        # A first sample comes after nothing.
        bad = ~(apart > 0.0)
        bad[rows.starts[:-1]] &= ~np.isnan(last)
    else:
        bad = ~(np.abs(apart / model.dt - 1.0) <= 0.25)
        bad[rows.starts[:-1]] &= ~np.isnan(last)
    return np.asarray(np.add.reduceat(bad, rows.starts[:-1]) == 0)


def _slowly(model: Model, state: Any, times: Array | None, z: Array, u: Array | None) -> Prepared:
    """Return one key's samples with the steps that they make, or raise."""
    last = np.nan if state is None or "time" not in state else float(np.ravel(state["time"])[0])
    line = timeline(times, len(z), last, model.dt, model.late)
    batch = Batch(times, z, u, _nothing)
    return Prepared(batch, line, Job(state, *spread(batch, line, state)))


def _assembled(
    table: Any, model: Model, key: str, rows: _Sorted, output: Array, taken: np.ndarray, errors: dict[int, str]
) -> Any:
    """Return the output as a data frame, in the order of the table."""
    import pandas as pd

    back = np.empty(len(rows.order), dtype=int)
    back[rows.order] = np.arange(len(rows.order))
    kept = taken[back]
    chosen = back[kept]
    said = np.full(len(rows.order), None, dtype=object)
    for i, sentence in errors.items():
        said[rows.starts[i] : rows.starts[i + 1]] = sentence
    copied = [key] if model.time is None else [key, model.time]
    found = table.loc[:, copied] if kept.all() else table.loc[kept, copied]
    result = pd.DataFrame(output[chosen], columns=list(model.columns), index=found.index, copy=False)
    for place, name in enumerate(copied):
        result.insert(place, name, found[name])
    result["error"] = pd.Series(said[chosen], index=found.index, dtype=object)
    return result
