"""Stamps of any library, one or a column: numbers of seconds, or instants as the nanoseconds since 1970."""

from __future__ import annotations

import math
from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array

NANO = 1_000_000_000
# Numbers as large as this are no seconds since 1970, but milliseconds or smaller parts of one.
_NO_SECONDS = 1e11
# A stamp of single precision must still tell moments that are so many seconds apart.
_COARSE = 1e-3
# Years that nanoseconds hold from their first day to their last, and the longest duration, in days.
_FIRST, _LAST, _LONGEST = 1678, 2261, 106_000


def read(name: str, stamp: Any, loose: bool = False) -> float | int:
    """Return a stamp as a float of seconds or, of an instant, as a whole number of nanoseconds since 1970."""
    stamp = stamp[()] if isinstance(stamp, np.ndarray) and not stamp.ndim else stamp
    for convert in ("to_datetime64", "to_timedelta64"):
        stamp = getattr(stamp, convert)() if hasattr(stamp, convert) else stamp
    # A sentence takes as long as all the rest.
    usual = type(stamp) is float and abs(stamp) < _NO_SECONDS
    refusal = "" if usual else f"{name}: expected a time, got {_shown(stamp)}"
    if isinstance(stamp, str):
        if not loose:
            raise TypeError(f"{refusal}, which is text; pandas.to_datetime(.., utc=True) reads it")
        try:
            stamp = datetime.fromisoformat(stamp.strip().replace("Z", "+00:00").replace("z", "+00:00"))
        except ValueError:
            raise ValueError(refusal) from None
    if isinstance(stamp, (timedelta, np.timedelta64)) and not loose:
        raise TypeError(f"{refusal}, which is a duration; use its total_seconds()")
    if isinstance(stamp, datetime):
        if stamp.tzinfo is None:
            raise ValueError(
                f"{refusal}, which has no time zone and means another instant on every machine; use "
                "datetime(.., tzinfo=timezone.utc)"
            )
        stamp = np.datetime64(0, "us") + np.timedelta64(stamp - datetime(1970, 1, 1, tzinfo=timezone.utc), "us")
    elif isinstance(stamp, timedelta):
        stamp = np.timedelta64(stamp, "us")
    if isinstance(stamp, (np.datetime64, np.timedelta64)):
        (key,), (held,) = _nanoseconds(np.array([stamp]))
        if not held:
            mend = "" if np.isnat(stamp) else f", which nanoseconds do not hold: years {_FIRST} to {_LAST}"
            raise ValueError(refusal + mend)
        return int(key)
    return _number(name, stamp, refusal, loose)


def column(values: Any, loose: bool = False) -> tuple[np.ndarray, dict[int, str]]:
    """Return the stamps of a column as `read` returns each, and what is wrong with those that are none."""
    values = np.asarray(values)
    keys, odd = np.zeros(0), np.arange(len(values))
    if values.dtype.kind == "M" or (values.dtype.kind == "m" and loose):
        keys, held = _nanoseconds(values)
        odd = np.flatnonzero(~held)
    elif values.dtype.kind in "iuf":
        keys = values.astype(float)
        with np.errstate(invalid="ignore"):
            usual = np.isfinite(keys) & (loose | (np.abs(keys) < _NO_SECONDS))
        usual &= loose or values.dtype not in (np.float32, np.float16)
        odd = np.flatnonzero(~usual)
    if not len(odd):
        return keys, {}
    stamps: list[Any] = keys.tolist() or [None] * len(values)
    wrong: dict[int, str] = {}
    for row in odd.tolist():
        try:
            stamps[row] = read("time", values[row], loose)
        except (TypeError, ValueError) as error:
            wrong[row], stamps[row] = str(error), None
    kinds = {type(key) for key in stamps} - {type(None)}
    if kinds == {int}:
        return np.array([key or 0 for key in stamps], dtype=np.int64), wrong
    return np.array(stamps, dtype=object if int in kinds else float), wrong


def frame(table: Any, mend: str = "pass one of pandas, polars or pyarrow") -> Any:
    """Return a table in memory as a data frame of narwhals, or raise."""
    try:
        import narwhals as nw
    except ImportError:
        raise ImportError('tables are read by narwhals; pip install "robust_filterpy[fleet]"') from None
    try:
        return nw.from_native(table, eager_only=True)
    except TypeError:
        kind = type(table).__name__
        raise TypeError(f"table: expected a data frame or an Arrow table in memory, got {kind}; {mend}") from None


def as_numpy(series: Any) -> np.ndarray:
    """Return a column of narwhals as an array, instants with a time zone in UTC."""
    if getattr(series.dtype, "time_zone", None) is not None:
        series = series.dt.convert_time_zone("UTC").dt.replace_time_zone(None)
    return np.asarray(series.to_numpy())


def seconds(keys: np.ndarray) -> Array:
    """Return the keys of a column in seconds, instants since 1970."""
    if keys.dtype == object:
        return np.array([seconds(np.array([np.nan if key is None else key]))[0] for key in keys])
    # Whole seconds first, or the nanoseconds would be rounded away.
    return keys // NANO + (keys % NANO) * 1e-9 if keys.dtype == np.int64 else keys


def _nanoseconds(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return dates or durations of numpy in nanoseconds, 0 for those that these do not hold, and which they do."""
    kind = values.dtype.kind
    if np.datetime_data(values.dtype)[0] in ("ps", "fs", "as"):
        values = values.astype(f"{kind}8[ns]")
    # To a coarser unit nothing overflows.
    if kind == "M":
        year = values.astype("M8[Y]").astype(np.int64) + 1970
        held = ~np.isnat(values) & (year >= _FIRST) & (year <= _LAST)
    else:
        held = ~np.isnat(values) & (np.abs(values.astype("m8[D]").astype(np.int64)) <= _LONGEST)
    return np.where(held, values, np.zeros(1, values.dtype)).astype(f"{kind}8[ns]").astype(np.int64), held


def _number(name: str, stamp: Any, refusal: str, loose: bool) -> float:
    """Return a stamp that is a number, or raise."""
    try:
        number = math.nan if stamp is np.ma.masked else _checks.real(name, stamp)
    except (TypeError, ValueError) as error:
        raise type(error)(refusal) from None
    if not math.isfinite(number):
        raise ValueError(refusal)
    if loose:
        return number
    if abs(number) >= _NO_SECONDS:
        unit = "ms" if abs(number) < 1e14 else "us" if abs(number) < 1e17 else "ns"
        raise ValueError(
            f"{name}: expected seconds, got {number:.6g}, which looks like {unit} since 1970; use "
            f'np.datetime64(int(t), "{unit}"), of a column column.astype("datetime64[{unit}]")'
        )
    if isinstance(stamp, (np.float32, np.float16)) and np.spacing(np.abs(stamp)) > _COARSE:
        raise ValueError(
            f"{name}: expected a float of double precision, got {number:.9g} of {stamp.dtype}, which is known to "
            f"{np.spacing(np.abs(stamp)):.3g} s only"
        )
    return number


def _shown(stamp: Any) -> str:
    """Return a stamp as a sentence has it."""
    return str(stamp) if isinstance(stamp, (np.datetime64, np.timedelta64)) else _checks.shown(stamp)
