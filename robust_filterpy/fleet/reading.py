"""From the forms that engines hand over to numbers, and to steps: late samples and duplicates, gaps on a regular grid.

What is no number, and no time, costs its row alone: the others go on, and its reason stands in its row.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Sequence
from datetime import datetime, timezone
from os import PathLike
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from robust_filterpy import _checks, _stamps
from robust_filterpy._checks import Array
from robust_filterpy._warning import warn

#: What is wrong with some of the rows.
Reasons: TypeAlias = dict[int, str]
Columns: TypeAlias = Sequence[tuple[str, np.ndarray]]

#: Whose a row is that says nobody's name.
NOBODY = object()
_MISSING = ("NoneType", "NAType", "NaTType", "MaskedConstant")


class Rows(NamedTuple):
    """Samples in the order of a batch."""

    #: Whose each is; None if all are of one.
    keys: list[Any] | None
    #: Shape (N,), in seconds, NaN where there is none.
    times: Array | None
    #: Measurements, shape (N, m), NaN where missing.
    z: Array
    #: Inputs, shape (N, p), NaN where there is none.
    u: Array | None
    #: What is wrong with a row, though the others go on.
    said: Reasons
    #: From the rows that were taken, and the columns that belong to them, to the form of the batch.
    like: Callable[[np.ndarray, dict[str, Any]], Any]
    #: Whether times were instants rather than seconds.
    instants: bool


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
    n: int, keys: list[Any] | None, stamps: np.ndarray | None, measured: Columns, inputs: Columns, said: Reasons,
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
            mend = f"name them, as in FilterModel(kf, time='t', {what}=['z'])"
            raise ValueError(f"{what}: expected {allowed[-1]} column(s) for the model, got {list(selected)}; {mend}")
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


def _keys(key: str, column: Any, said: Reasons) -> list[Any]:
    """Return whose each row is; rows of nobody are named."""
    values = column.to_numpy()
    keys: list[Any] = values.tolist()
    for row, name in enumerate(keys if values.dtype.kind not in "iub" else ()):
        missing = type(name).__name__ in _MISSING or name != name
        if missing or not isinstance(name, Hashable):
            got = "none" if missing else _checks.shown(name)
            said[row], keys[row] = f"{key}: expected a name or number in each row, got {got}", NOBODY
    return keys


def _are_instants(stamps: np.ndarray) -> bool:
    """Tell whether some times are dates, or text that is read as such."""
    if stamps.dtype.kind not in "OUT":
        return stamps.dtype.kind == "M"
    return any(isinstance(stamp, (str, datetime, np.datetime64)) for stamp in stamps)


def _column(name: str, values: np.ndarray, said: Reasons, what: str, gaps: bool) -> Array:
    """Return a column as finite numbers, NaN for every other one; those that are not missing are named."""
    numbers, bad = np.full(len(values), np.nan), np.zeros(len(values), dtype=bool)
    if values.dtype.kind in "fiub":
        numbers[:] = values
    else:
        for row, value in enumerate(values.tolist() if values.dtype.kind != "O" else values):
            try:
                numbers[row] = _number(value)
            except (TypeError, ValueError, OverflowError):
                bad[row] = True
    bad |= np.isinf(numbers) if gaps else ~np.isfinite(numbers)
    for row in np.flatnonzero(bad).tolist():
        say(said, row, f"{name}: expected {what}, got {_checks.shown(values[row])}")
    numbers[bad] = np.nan
    return numbers


def _number(value: Any) -> float:
    """Return a number, NaN for what is missing, or raise."""
    if type(value).__name__ in _MISSING:
        return np.nan
    return float(value) if isinstance(value, (bool, np.bool_)) else _checks.real("", value)


def say(said: Reasons, row: int, sentence: str) -> None:
    """Add what is wrong with a row."""
    said[row] = f"{said[row]}; {sentence}" if row in said else sentence


def seconds(values: np.ndarray, said: Reasons) -> Array:
    """Return times as seconds, shape (N,); dates count from 1970. NaN where there is none, which is named."""
    keys, wrong = _stamps.column(values, loose=True)
    for row, sentence in wrong.items():
        say(said, row, sentence)
    return np.where(np.isin(np.arange(len(keys)), list(wrong)), np.nan, _stamps.seconds(keys))


#: What may be done with a sample that is not later than the one before it.
POLICIES: Final = ("refuse", "drop")
#: How far from the grid a sample may lie, in sampling periods; beyond it is half way between two steps.
JITTER: Final = 0.45
# A clock that drifts is followed: from here on the grid goes after it, by this share of what it is off.
_STILL, _FOLLOWED = 0.02, 0.05
# A longer silence is no gap but another recording.
_LONGEST: Final = 100_000
# Samples one after the other by another clock after which it is the key's: of a clock so far away that nothing comes
# from there late, and of any.
_FOLLOWED_FAR, _FOLLOWED_NEAR = 5, 50
_NOWHERE = (np.nan, np.nan)
# Numbers as large as this are milliseconds since 1970, or smaller parts of a second.
_MILLISECONDS: Final = 1e11


class Clocks(NamedTuple):
    """Where the last samples of some keys stand, each of shape (K,); NaN before the first one."""

    #: Their times.
    last: Array
    #: A time on the grid.
    origin: Array
    #: How many steps after it the last sample stands.
    step: Array
    #: The last of the samples refused since then, if they follow one another, and how many they are, shape (K, 2).
    elsewhere: Array


class Placed(NamedTuple):
    """Where samples stand among the steps of their keys."""

    #: Which step of its key each row is, shape (N,), -1 if it is none.
    step: np.ndarray
    #: How many steps each key takes, shape (K,).
    steps: np.ndarray
    #: Where their last samples stand.
    clocks: Clocks
    #: Rows that are not later than the one before them, and what they are.
    late: dict[int, str]
    #: Rows that lie off the grid or after too long a silence, or from which on another clock is followed.
    noted: dict[int, str]


def placed(times: Array | None, starts: np.ndarray, clocks: Clocks, dt: float | None, instants: bool = False) -> Placed:
    """Return where the samples of each key stand after those before them."""
    counts = np.diff(starts)
    step = np.arange(starts[-1]) - np.repeat(starts[:-1], counts)
    if times is None or not len(times):
        return Placed(step, counts, clocks, {}, {})
    last, origin, at, elsewhere = (one.copy() for one in clocks)
    first, filled = starts[:-1], counts > 0
    if dt is not None:
        origin[filled] = np.where(np.isnan(origin), times[np.minimum(first, len(times) - 1)], origin)[filled]
    quick, finals = _each_a_step(times, starts, Clocks(last, origin, at, elsewhere), dt)
    steps, ends = counts.copy(), starts[1:] - 1
    last[quick] = times[ends[quick]]
    at[quick], elsewhere[quick] = finals[quick], np.nan
    late: Reasons = {}
    noted: Reasons = {}
    milliseconds = False
    for i in np.flatnonzero(~quick).tolist():
        line = _Line(Clocks(*(one[i] for one in clocks)), dt, instants, late, noted)
        for row in range(starts[i], starts[i + 1]):
            step[row] = line.place(float(times[row]), row)
            if step[row] < 0:
                step[row] = line.follow(float(times[row]), row)
            else:
                line.elsewhere = _NOWHERE
        last[i], origin[i], at[i], elsewhere[i] = line.last, line.origin, line.step, line.elsewhere
        steps[i] = line.steps
        milliseconds |= line.milliseconds
    if milliseconds:
        warn(
            f"time: gaps of a thousand steps of dt={dt:g} s; times as large as these are milliseconds since 1970 as a "
            f"rule, divide them by 1000"
        )
    return Placed(step, steps, Clocks(last, origin, at, elsewhere), late, noted)


def _each_a_step(times: Array, starts: np.ndarray, clocks: Clocks, dt: float | None) -> tuple[np.ndarray, Array]:
    """Return for which keys every sample is the next step, and which the last one is; all keys at once."""
    counts, first = np.diff(starts), starts[:-1]
    filled = counts > 0
    place = times if dt is None else (times - np.repeat(clocks.origin, counts)) / dt
    near = times if dt is None else np.rint(place)
    before = np.concatenate(([np.nan], near[:-1]))
    stood = clocks.last if dt is None else np.where(np.isnan(clocks.step), -1.0, clocks.step)
    before[first[filled]] = stood[filled]
    # Without a grid nothing comes before the first time; on one its first place is 0.
    good = ~(near <= before) & ~np.isnan(near) if dt is None else near - before == 1.0
    good &= np.abs(place - near) <= _STILL
    quick = np.ones(len(counts), dtype=bool)
    quick[filled] = np.logical_and.reduceat(good, first[filled])
    finals = clocks.step.copy()
    finals[filled] = np.nan if dt is None else near[starts[1:][filled] - 1]
    return quick, finals


def _as_instant(seconds: float) -> str:
    """Return seconds since 1970 as an instant in UTC, to the microsecond; what no calendar holds as seconds."""
    try:
        return datetime.fromtimestamp(seconds, timezone.utc).isoformat().replace("+00:00", "Z")
    except (OverflowError, ValueError, OSError):
        return f"{seconds:.15g}"


class _Line:
    """The samples of one key, one after the other."""

    def __init__(self, stood: Clocks, dt: float | None, instants: bool, late: Reasons, noted: Reasons) -> None:
        """Begin where the last sample stands."""
        self.shown = _as_instant if instants else "{:.15g}".format
        self.last, self.origin, self.step = (float(one) for one in stood[:3])
        self.elsewhere, self.dt, self.steps = tuple(stood.elsewhere.tolist()), dt, 0
        self.milliseconds, self.late, self.noted = False, late, noted

    def place(self, time: float, row: int) -> int:
        """Return which step a sample is, -1 if it is none, which is noted."""
        if time != time:
            return -1
        if time <= self.last:
            what = "a duplicate" if time == self.last else "late"
            last, got = self.shown(self.last), self.shown(time)
            self.late[row] = f"time: expected a sample later than the one at {last}, got {got}, {what}"
            return -1
        if self.dt is None:
            self.last, self.steps = time, self.steps + 1
            return self.steps - 1
        if self.last != self.last:
            self.origin, self.step = time, -1.0
        return self._on_grid(time, row, self.dt)

    def follow(self, time: float, row: int) -> int:
        """Return which step a sample is that was refused, -1 if it is none; a clock that was set is followed."""
        apart = np.inf if self.dt is None else _LONGEST * self.dt
        if not (time < self.last or time - self.last > apart):
            return -1
        before, count = self.elsewhere
        self.elsewhere = time, count + 1.0 if 0.0 < time - before <= apart else 1.0
        if self.elsewhere[1] < (_FOLLOWED_NEAR if abs(time - self.last) <= apart else _FOLLOWED_FAR):
            return -1
        self.late.pop(row, None)
        expected = f"time: expected one after {self.shown(self.last)}, got {self.shown(time)}"
        self.noted[row] = f"{expected}; the clock was set, and is followed from here on"
        self.last, self.elsewhere, self.steps = time, _NOWHERE, self.steps + 1
        if self.dt is not None:
            self.origin, self.step = time, 0.0
        return self.steps - 1

    def _on_grid(self, time: float, row: int, dt: float) -> int:
        """Return which step of the grid a sample is."""
        place = (time - self.origin) / dt
        if not abs(place) < 1e15:
            self.noted[row] = f"time: expected a time that {dt:g} s is a step of, got {self.shown(time)}"
            return -1
        near = float(np.rint(place))
        apart, ahead = place - near, near - self.step
        if abs(apart) > JITTER:
            self.noted[row] = (
                f"time: expected samples within {JITTER:.0%} of dt={dt:g} s of the grid through "
                f"{self.shown(self.origin)}, got {self.shown(time)}, {abs(apart):.2f} of it away"
            )
            return -1
        if ahead < 1.0:
            got = self.shown(time)
            self.late[row] = f"time: expected one sample a step of dt={dt:g} s, got {got}, too early for the next"
            return -1
        self.milliseconds |= ahead >= 900.0 and abs(time) > _MILLISECONDS
        if ahead > _LONGEST:
            self.noted[row] = (
                f"time: expected gaps of at most {_LONGEST} steps of dt={dt:g} s, got {ahead:.6g}; start anew with "
                f"state None"
            )
            return -1
        if abs(apart) > _STILL:
            self.origin += _FOLLOWED * apart * dt
        self.last, self.step, self.steps = time, near, self.steps + int(ahead)
        return self.steps - 1


def strays(times: Array, starts: np.ndarray, dt: float) -> np.ndarray:
    """Return which samples, in the order of their times, lie so far before all others of their key that none are."""
    after = np.flatnonzero(np.diff(times) > _LONGEST * dt) + 1
    begins = starts[np.searchsorted(starts, after, side="right") - 1]
    ends = starts[np.searchsorted(starts, after, side="right")]
    lone = (after > begins) & (after - begins < _FOLLOWED_FAR) & (2 * (after - begins) < ends - begins)
    return np.unique([row for a, b in zip(begins[lone], after[lone], strict=True) for row in range(a, b)]).astype(int)


def grouped(keys: list[Any] | None, n: int) -> tuple[list[Any], np.ndarray, np.ndarray]:
    """Return the keys, the rows in the order of the keys, and where each key's rows begin."""
    if keys is None:
        return [None], np.arange(n), np.array([0, n])
    places = {key: i for i, key in enumerate(dict.fromkeys(keys))}
    codes = np.fromiter(map(places.__getitem__, keys), int, n)
    order = np.argsort(codes, kind="stable")
    return list(places), order, np.searchsorted(codes[order], np.arange(len(places) + 1))
