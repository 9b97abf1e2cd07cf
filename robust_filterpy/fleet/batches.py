"""One key's samples in any of the forms that engines hand over: an array, a data frame, an Arrow table."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array


class Batch(NamedTuple):
    """Samples, and how to return what comes of them in the same form."""

    times: Any
    """N times, or None."""
    z: Array
    """Measurements, shape (N, m)."""
    u: Array | None
    """Inputs, shape (N, p), or None."""
    like: Callable[[dict[str, Any], np.ndarray], Any]
    """From columns, and which rows they belong to, to the form of the batch."""


def read(batch: Any, columns: Any, m: int, p: int) -> Batch:
    """Return the samples of a batch, or raise.

    Parameters
    ----------
    batch : array_like, shape (N, m) or (N, m + p), or DataFrame, or Arrow table
        Samples; with a column of times in front, if columns.time is set.
    columns : Columns
        Names of a table's columns.
    m, p : int
        Number of measurements and of inputs.

    Returns
    -------
    Batch
        times, z, u, like.

    Raises
    ------
    ValueError, TypeError
        If a column is missing or holds something else than numbers, or there are too few or too many.
    """
    if hasattr(batch, "columns") or hasattr(batch, "schema"):
        return _read_table(batch, columns, m, p)
    values = np.asarray(batch)
    timed = columns.time is not None
    if values.ndim == 1 and m == 1 and not timed and p == 0:
        values = values[:, None]
    widths = [timed + m + p] if columns.inputs else sorted({timed + m, timed + m + p})
    if values.ndim != 2 or values.shape[1] not in widths:
        what = ", ".join([*(["a time"] if timed else []), f"{m} measurement(s)", *([f"{p} input(s)"] if p else [])])
        raise ValueError(
            f"batch: expected shape (samples, {' or '.join(map(str, widths))}), {what} in a row, got {values.shape}"
        )
    z = _finite_or_missing("batch", values[:, int(timed) : timed + m])
    u = values[:, timed + m :] if values.shape[1] > timed + m else None
    u = None if u is None else _finite("batch", u)
    return Batch(values[:, 0] if timed else None, z, u, lambda found, rows: found)


def _read_table(batch: Any, columns: Any, m: int, p: int) -> Batch:
    """Return the samples of a data frame or an Arrow table."""
    names = list(batch.schema.names if hasattr(batch, "schema") and hasattr(batch.schema, "names") else batch.columns)
    inputs = columns.inputs or ()
    measurements = columns.measurements
    if measurements is None:
        measurements = tuple(name for name in names if name != columns.time and name not in inputs)
    wanted = [*([columns.time] if columns.time is not None else []), *measurements, *inputs]
    missing = [name for name in wanted if name not in names]
    if missing:
        raise ValueError(f"batch: expected the columns {missing}, got {names}")
    if len(measurements) != m:
        raise ValueError(f"measurements: expected {m} column(s) for the model, got {list(measurements)}")
    if len(inputs) not in (0, p):
        raise ValueError(f"inputs: expected {p} column(s) for the model, got {list(inputs)}")
    z = np.column_stack([_finite_or_missing(name, _values(batch, name)) for name in measurements])
    u = np.column_stack([_finite(name, _values(batch, name)) for name in inputs]) if inputs else None
    return Batch(None if columns.time is None else _values(batch, columns.time), z, u, _writer(batch, columns.time))


def _values(batch: Any, name: Any) -> np.ndarray:
    """Return a column as an array."""
    column = batch[name] if not hasattr(batch, "column") else batch.column(name)
    if hasattr(column, "combine_chunks") or type(column).__module__.startswith("pyarrow"):
        return np.asarray(column.to_numpy(zero_copy_only=False) if not hasattr(column, "chunks") else column.to_numpy())
    found = column.to_numpy()
    return np.asarray(found)


def _finite_or_missing(name: str, values: Any) -> Array:
    """Return measurements, NaN where they are missing, or raise."""
    found = _checks.numbers(str(name), values)
    if np.isinf(found).any():
        row = int(np.argmax(np.isinf(found.reshape(len(found), -1)).any(axis=1)))
        raise ValueError(f"{name}: expected finite numbers or NaN (missing), got infinity in row {row}")
    return found


def _finite(name: str, values: Any) -> Array:
    """Return inputs, or raise."""
    found = _checks.numbers(str(name), values)
    if not np.isfinite(found).all():
        row = int(np.argmin(np.isfinite(found.reshape(len(found), -1)).all(axis=1)))
        raise ValueError(f"{name}: expected finite numbers, since an input cannot be missing, got others in row {row}")
    return found


def _writer(batch: Any, time: Any) -> Callable[[dict[str, Any], np.ndarray], Any]:
    """Return what makes a table of the kind of the batch, with its times."""

    def like(found: dict[str, Any], rows: np.ndarray) -> Any:
        """Return columns as a table, for some rows of the batch."""
        kept = {} if time is None else {time: _values(batch, time)[rows]}
        found = {**kept, **found}
        if hasattr(type(batch), "from_pydict"):
            return type(batch).from_pydict(found)
        table = type(batch)(found)
        if hasattr(batch, "index"):
            table.index = batch.index[rows]
        return table

    return like
