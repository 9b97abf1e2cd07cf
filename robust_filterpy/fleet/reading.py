"""From the forms that engines hand over to numbers: arrays, and tables of any kind that narwhals knows.

What is no number, and no time, costs its row alone: the others go on, and its reason stands in its row.
"""

from __future__ import annotations

import numbers
from collections.abc import Callable, Hashable, Iterable, Sequence
from datetime import datetime
from os import PathLike
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from robust_filterpy import _checks, _stamps
from robust_filterpy._checks import Array

#: What is wrong with some of the rows.
Reasons: TypeAlias = dict[int, str]
Columns: TypeAlias = Sequence[tuple[str, np.ndarray]]

#: Whose a row is that says nobody's name.
NOBODY = object()
_MISSING = ("NoneType", "NAType", "NaTType", "MaskedConstant")


class Rows(NamedTuple):
    """Samples in the order of a batch."""

    keys: Sequence[Any] | None
    """Whose each is; None if all are of one."""
    times: Array | None
    """Shape (N,), in seconds, NaN where there is none."""
    z: Array
    """Measurements, shape (N, m), NaN where missing."""
    u: Array | None
    """Inputs, shape (N, p), NaN where there is none."""
    said: Reasons
    """What is wrong with a row, though the others go on."""
    like: Callable[[np.ndarray, dict[str, Any]], Any]
    """From the rows that were taken, and the columns that belong to them, to the form of the batch."""
    instants: bool
    """Whether times were instants rather than seconds."""


def read_array(batch: Any, model: Any) -> Rows:
    """Return the samples of an array, or of rows of anything: the time first, measurements, inputs; or raise."""
    m, p = model.widths
    timed = int(model.time is not None)
    widths = [timed + m + p] if model.inputs else sorted({timed + m, timed + m + p})
    values, said = _as_array(batch, widths)
    if values.ndim == 1 and widths[0] == 1:
        values = values[:, None]
    if values.ndim != 2 or values.shape[1] not in widths:
        what = ", ".join([*(["a time"] if timed else []), f"{m} measurement(s)", *([f"{p} input(s)"] if p else [])])
        raise ValueError(
            f"batch: expected shape (samples, {' or '.join(map(str, widths))}), {what} in a row, got {values.shape}"
        )
    z = [("z" if m == 1 else f"z{i}", values[:, timed + i]) for i in range(m)]
    given = range(timed + m, values.shape[1])
    u = [("u" if p == 1 else f"u{i}", values[:, j]) for i, j in enumerate(given)]
    return _rows(len(values), None, values[:, 0] if timed else None, z, u, said, lambda rows, columns: columns)


def _rows(
    n: int, keys: Sequence[Any] | None, stamps: np.ndarray | None, measured: Columns, inputs: Columns, said: Reasons,
    like: Callable[[np.ndarray, dict[str, Any]], Any],
) -> Rows:  # fmt: skip
    """Return samples of columns with their names; what is no number is named."""
    times = None if stamps is None else seconds(stamps, said)
    z = [_column(name, values, said, "a finite number or NaN (missing)", True) for name, values in measured]
    what = "a finite number, since an input cannot be missing; the one before it is held"
    u = [_column(name, values, said, what, False) for name, values in inputs]
    instants = stamps is not None and _are_instants(stamps)
    z_rows = np.column_stack(z) if z else np.empty((n, 0))
    return Rows(keys, times, z_rows, np.column_stack(u) if u else None, said, like, instants)


def _as_array(batch: Any, widths: list[int]) -> tuple[np.ndarray, Reasons]:
    """Return rows as an array, of objects if they are not all numbers; rows of another length are named."""
    if isinstance(batch, np.ndarray):
        return batch, {}
    try:
        values = np.asarray(batch)
        if values.dtype.kind in "fiumM":
            return values, {}
    except (TypeError, ValueError, OverflowError):
        pass
    rows = list(batch) if isinstance(batch, Iterable) and not isinstance(batch, (str, bytes)) else [batch]
    rows = [[row] if widths == [1] and not isinstance(row, (list, tuple, np.ndarray)) else row for row in rows]
    width = next((len(row) for row in rows if hasattr(row, "__len__") and len(row) in widths), widths[-1])
    cells, said = np.full((len(rows), width), None, dtype=object), {}
    for i, row in enumerate(rows):
        if isinstance(row, (list, tuple, np.ndarray)) and len(row) == width:
            for j, value in enumerate(row):
                cells[i, j] = value
        else:
            said[i] = f"row: expected {width} number(s), got {_checks.shown(row)}"
    return cells, said


def read_table(table: Any, model: Any, key: str | None) -> Rows:
    """Return the samples of a table with columns by name, or raise if it lacks one."""
    frame, back = _frame(table)
    names = frame.columns
    given = list(model.inputs or ())
    chosen = model.measurements
    if chosen is None:
        chosen = [name for name in names if name not in (key, model.time) and name not in given]
    missing = [name for name in (key, model.time, *chosen, *given) if name is not None and name not in names]
    if missing:
        mend = "key= names that of the device, time= and measurements= of the model the others"
        raise ValueError(f"table: expected the columns {missing}, got {names}; {mend}")
    m, p = model.widths
    for what, selected, allowed in (("measurements", chosen, (m,)), ("inputs", given, (0, p))):
        if len(selected) not in allowed:
            raise ValueError(f"{what}: expected {allowed[-1]} column(s) for the model, got {list(selected)}")
    said: Reasons = {}
    keys = None if key is None else _keys(key, frame[key], said)
    stamps = None if model.time is None else _stamps.as_numpy(frame[model.time])
    z, u = ([(name, frame[name].to_numpy()) for name in columns] for columns in (chosen, given))
    copied = [name for name in (key, model.time) if name is not None]

    def like(rows: np.ndarray, columns: dict[str, Any]) -> Any:
        """Return columns as a table of the kind of the batch, with its keys and times."""
        import narwhals as nw

        output = frame.select(copied) if len(rows) == len(frame) else frame.select(copied)[rows]
        if not copied and hasattr(table, "index"):
            output = nw.from_native(table[[]].iloc[rows], eager_only=True)
        series = [
            nw.new_series(
                name, *((values, nw.Float64) if values.dtype == float else (values.tolist(), nw.String)),
                backend=frame.implementation,
            )
            for name, values in columns.items()
        ]  # fmt: skip
        if len(output.columns) or hasattr(table, "index"):
            return back(output.with_columns(series))
        return back(nw.concat([one.to_frame() for one in series], how="horizontal"))

    return _rows(len(frame), keys, stamps, z, u, said, like)


def reasons(table: Any, key: str) -> tuple[list[tuple[Any, str]], list[Any]]:
    """Return keys and what the column ``error`` says of the rows that have one, and the keys of all rows."""
    frame, _ = _frame(table)
    bad = frame.filter(~frame["error"].is_null())
    keys = frame[key].to_list() if len(bad) else []
    return list(zip(bad[key].to_list(), bad["error"].to_list(), strict=True)), keys


def _frame(table: Any) -> tuple[Any, Callable[[Any], Any]]:
    """Return a table as the data frame of narwhals, and the way back; or raise."""
    if type(table).__name__ != "RecordBatch":
        mend = "pandas.read_parquet(..) reads a file" if isinstance(table, (str, PathLike)) else "collect what is lazy"
        return _stamps.frame(table, mend), lambda frame: frame.to_native()
    import pyarrow as pa

    def record_batch(frame: Any) -> Any:
        """Return an Arrow record batch."""
        return frame.to_native().combine_chunks().to_batches()[0] if len(frame) else frame.to_native().to_batches()

    return _stamps.frame(pa.Table.from_batches([table])), record_batch


def _keys(key: str, column: Any, said: Reasons) -> Sequence[Any]:
    """Return whose each row is; rows of nobody are named."""
    values = column.to_numpy()
    if values.dtype.kind in "iub":
        return values
    keys = values.tolist()
    for row, name in enumerate(keys):
        if type(name).__name__ in _MISSING or name != name:
            said[row], keys[row] = f"{key}: expected a name or number in each row, got none", NOBODY
        elif not isinstance(name, Hashable):
            said[row] = f"{key}: expected a name or number in each row, got {_checks.shown(name)}"
            keys[row] = NOBODY
    return keys


def _are_instants(stamps: np.ndarray) -> bool:
    """Tell whether some times are dates, or text that is read as such."""
    if stamps.dtype.kind not in "OUT":
        return stamps.dtype.kind == "M"
    return any(isinstance(stamp, (str, datetime, np.datetime64)) for stamp in stamps)


def _column(name: str, values: np.ndarray, said: Reasons, what: str, gaps: bool) -> Array:
    """Return a column as finite numbers, NaN for every other one; those that are not missing are named."""
    if values.dtype.kind in "fiub":
        numbers = values.astype(float)
        bad = np.isinf(numbers) if gaps else ~np.isfinite(numbers)
    else:
        numbers, bad = np.full(len(values), np.nan), np.zeros(len(values), dtype=bool)
        for row, value in enumerate(values.tolist() if values.dtype.kind != "O" else values):
            try:
                numbers[row] = _number(value)
                bad[row] = np.isinf(numbers[row]) if gaps else not np.isfinite(numbers[row])
            except (TypeError, ValueError, OverflowError):
                bad[row] = True
    for row in np.flatnonzero(bad).tolist():
        say(said, row, f"{name}: expected {what}, got {_checks.shown(values[row])}")
    numbers[bad] = np.nan
    return numbers


def _number(value: Any) -> float:
    """Return a number, NaN for what is missing, or raise."""
    if type(value).__name__ in _MISSING:
        return np.nan
    if isinstance(value, (numbers.Real, np.bool_)) or type(value).__name__ == "Decimal":
        return float(value)
    if isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "fiub":
        return float(value)
    raise TypeError


def say(said: Reasons, row: int, sentence: str) -> None:
    """Add what is wrong with a row."""
    said[row] = f"{said[row]}; {sentence}" if row in said else sentence


def seconds(values: np.ndarray, said: Reasons) -> Array:
    """Return times as seconds, shape (N,); dates count from 1970. NaN where there is none, which is named."""
    keys, wrong = _stamps.column(values, loose=True)
    for row, sentence in wrong.items():
        say(said, row, sentence)
    return np.where(np.isin(np.arange(len(keys)), list(wrong)), np.nan, _stamps.seconds(keys))
