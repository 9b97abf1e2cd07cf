"""The checks that every sample and recording goes through on its way in, and the time axis of pandas objects.

Nothing here imports pandas: whoever passes a Series or a DataFrame has done so.
"""

from __future__ import annotations

import datetime
import math
import re
import sys
from collections.abc import Callable, Iterable
from typing import Any, Final, NamedTuple
from zlib import crc32

import numpy as np

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy._fill_values import fill_values
from robust_filterpy._warning import warn
from robust_filterpy.identification.models.regressor import LARGEST
from robust_filterpy.identification.models.structures import input_columns


def recorded_output(y: Any) -> Array:
    """Return a recorded output, shape (N,), NaN where it is missing or has a fill value, or raise."""
    return fill_values(measured_output(y)).signal


def measured_output(y: Any) -> Array:
    """Return an output as it was measured, shape (N,), or raise: in a batch nobody can tell fill values."""
    output = _checks.numbers("y", y)
    if output.ndim == 2 and 1 in output.shape:
        output = output.ravel()
    if output.ndim != 1 or output.size == 0:
        raise ValueError(f"y: expected a recording of shape (N,), N >= 1, got shape {output.shape}")
    return with_squares(output)


def measured_outputs(y: Any, n_outputs: int) -> Array:
    """Return outputs as they were measured, shape (N, n_outputs), or raise."""
    output = _checks.numbers("y", y)
    output = output[:, None] if output.ndim == 1 and n_outputs == 1 else output
    if output.ndim != 2 or output.shape[1] != n_outputs or len(output) == 0:
        mend = "; use y.T" if output.ndim == 2 and output.shape[0] == n_outputs else ""
        raise ValueError(f"y: expected shape (N, {n_outputs}), N >= 1, got shape {output.shape}{mend}")
    return with_squares(output)


def in_sample(bad: np.ndarray) -> str:
    """Name the first sample of a mask (N, ..)."""
    return f" in sample {bad.reshape(len(bad), -1).any(axis=1).argmax()}"


def with_squares(output: Array, where: Callable[[np.ndarray], str] = in_sample) -> Array:
    """Return outputs as far as their squares are numbers, or raise if one is infinite, and say where."""
    infinite = np.isinf(output)
    if infinite.any():
        raise ValueError(f"y: expected finite numbers or NaN (missing), got infinity{where(infinite)}")
    return np.clip(output, -LARGEST, LARGEST)


def are_several(y: Any, u: Any = None) -> bool:
    """Tell a list of recordings from one recording: its entries have samples of their own, as those of u have."""
    if not isinstance(y, (list, tuple)) or len(y) == 0 or not all(np.ndim(one) > 0 for one in y):
        return False
    if isinstance(u, (list, tuple)) and any(one is not None and np.ndim(one) == 0 for one in u):
        return False
    return any(np.shape(one)[0] > 1 for one in y)


def require_squares(output: Array) -> None:
    """Raise if an output is too small to be squared, or most of it too large, and so was all made alike."""
    _require_size("y", output)
    large = np.abs(output) >= LARGEST
    if 2 * large.sum() > (~np.isnan(output)).sum():
        raise ValueError(
            f"y: expected numbers up to {LARGEST:g} in size, got {large.sum()} larger ones; take another unit"
        )


def operating_point(u: Array) -> Array:
    """Return where each input rests, shape (n_inputs,): 0, unless all of it is far from 0, and then its mean."""
    if not u.size:
        return np.zeros(u.shape[1])
    low, high = np.quantile(u, [0.01, 0.99], axis=0)
    width = high - low
    return np.where(
        (np.ptp(u, axis=0) > 0.0) & ((low > width) | (high < -width)), np.clip(u, low, high).mean(axis=0), 0.0
    )


def recorded_input(structure: Any, u: Any, length: int | None) -> Array:
    """Return a recorded input, shape (N, n_inputs), of the given length, or raise."""
    n_inputs = structure.n_inputs
    if u is None:
        if n_inputs or length is None:
            raise ValueError(f"u: expected a recording of {n_inputs} input(s) for {structure}, got None")
        return np.zeros((length, 0))
    # Columns of a table lie one after the other, and the kernel takes rows.
    signal = np.ascontiguousarray(input_columns("u", u, n_inputs))
    if len(signal) == 0:
        raise ValueError("u: expected a recording of at least one sample, got none")
    if length is not None and len(signal) != length:
        raise ValueError(f"u: expected {length} samples like y, got {len(signal)}")
    require_finite(signal)
    for column in signal.T:
        _require_size("u", column)
    return signal


def held(u: Array, before: Any) -> Array:
    """Return columns with the value before in the place of each that is missing; before: what stands for the first."""
    last = np.maximum.accumulate(np.where(np.isnan(u), -1, np.arange(len(u))[:, None]), axis=0)
    return np.where(last < 0, before, np.take_along_axis(u, np.maximum(last, 0), axis=0))


def held_input(structure: Any, u: Any, rest: Array) -> Array:
    """Return an input whose missing samples have the value before them, with a warning if there are any."""
    if structure.takes_phi or not structure.n_inputs or u is None:
        return recorded_input(structure, u, None)
    signal = input_columns("u", u, structure.n_inputs)
    gaps = np.isnan(signal).any(axis=1)
    if gaps.any():
        warn(
            f"u: missing in {int(gaps.sum())} of {len(signal)} samples, held at the value before; fill u with what "
            "acted, for a valve that stayed where it was u.ffill(), else u.interpolate()"
        )
        signal = held(signal, rest if rest.size else 0.0)
    return recorded_input(structure, signal, None)


def _require_size(name: str, signal: Array) -> None:
    """Raise if all of a signal is too small to be squared, though not 0."""
    size = float(np.nanmax(np.abs(signal), initial=0.0))
    if 0.0 < size < 1.0 / LARGEST:
        raise ValueError(
            f"{name}: expected numbers of {1.0 / LARGEST:g} and more in size, got up to {size:.3g}; take another unit"
        )


def require_finite(values: Array, where: Callable[[np.ndarray], str] = in_sample) -> None:
    """Raise unless every input is a number that can be squared, and say where."""
    bad = ~(np.abs(values) <= LARGEST)
    if bad.any():
        place, got = where(bad), values[bad][0]
        mend = "; fill in what acted, u.ffill() for a valve that stayed where it was, else u.interpolate()"
        raise ValueError(
            f"u: expected finite numbers up to {LARGEST:g} in size (an input cannot be missing; the order is y, u), "
            f"got {got}{place}{mend if 'in sample' in place and np.isnan(got) else ''}"
        )


def fingerprint(y: Array) -> int:
    """Return a number by which a recording is recognized."""
    return crc32(np.ascontiguousarray(y).tobytes())


def trend_of(trends: Iterable[tuple[int, Array]], y: Array) -> Array:
    """Return what was taken off a recording, 0 if it is not recognized."""
    taken = {(number, trend.shape): trend for number, trend in trends if trend.size}
    return taken.get((fingerprint(y), y.shape), np.zeros(y.shape)) if taken else np.zeros(y.shape)


class Signals(NamedTuple):
    """How many inputs and outputs recordings have, for what is asked of a structure there.

    Attributes
    ----------
    n_inputs, n_outputs : int
        How many.
    takes_phi : bool
        No regressor comes from the caller.
    """

    n_inputs: int
    n_outputs: int
    takes_phi: bool = False

    def __str__(self) -> str:
        """Return what they are."""
        return f"a model of {self.n_inputs} input(s) and {self.n_outputs} output(s)"


# A step is regular within this share of the usual one; the clocks of loggers are no better.
_JITTER: Final = 0.05
# Two sampling periods that differ by no more are the same.
_SAME: Final = 0.01


def are_equal(steps: Array) -> bool:
    """Tell whether steps of time are as equal as a logger's."""
    usual = np.median(steps) if steps.size else 1.0
    return bool(usual > 0.0 and (np.abs(steps - usual) <= _JITTER * usual).all())


class TimeAxis(NamedTuple):
    """When the samples of a recording were taken, as far as they say so.

    Attributes
    ----------
    index : pandas.Index or None
        Of the pandas objects in the recording; None if there are none.
    dt : float or None
        Sampling period in s; None if the index does not tell it.
    """

    index: Any = None
    dt: float | None = None

    def labelled(self, values: Any, name: str) -> Any:
        """Return values of one signal as a pandas Series, of several as columns by number; as they are if no index."""
        if self.index is None or np.ndim(values) == 2:
            return values if self.index is None else table(dict(enumerate(values.T)), self.index)
        return sys.modules["pandas"].Series(values, index=self.index, name=name)

    @property
    def last(self) -> Any:
        """Time of the last sample; None if the index is no time."""
        pd = sys.modules.get("pandas")
        if pd is None or not isinstance(self.index, (pd.DatetimeIndex, pd.TimedeltaIndex, pd.PeriodIndex)):
            return None
        return None if len(self.index) == 0 or pd.isna(self.index[-1]) else self.index[-1]

    def missing_after(self, before: tuple[Any, int], dt: float | None) -> int:
        """Return how many samples are missing between what came before this recording and its first sample."""
        last, since = before
        first = self.index[0]
        try:
            apart = first - last
            # Of two periods the difference is a number of steps of their own, which has no length in s.
            apart = apart if hasattr(apart, "total_seconds") else first.to_timestamp() - last.to_timestamp()
            steps = apart.total_seconds() / dt - since if dt else math.nan
            goes_on = bool(first > last) and not steps < 0.5
        except (TypeError, ValueError):
            # A time zone on one side alone, durations and dates.
            raise ValueError(f"y: expected times that follow {last!r}, the last before them, got {first!r}") from None
        if not goes_on:
            after = f" and {since} more" if since else ""
            raise ValueError(
                f"y: expected times that follow {last}{after}, the last before them, got {first}; leave out what the "
                "tracker has seen, or, to follow another recording, forget the time by tracker.restore(tracker.state())"
            )
        return 0 if math.isnan(steps) else round(steps) - 1

    def require_period(self, dt: float | None) -> None:
        """Refuse a recording with another sampling period."""
        if dt is not None and self.dt is not None and abs(self.dt - dt) > _SAME * dt:
            # What lies between slow samples cannot be had by resampling.
            mend = f'resample with df.resample("{dt:.6g}s").mean()' if self.dt < dt else "identify one at this period"
            raise ValueError(
                f"y: expected a sample every {dt:.6g} s, as the model has it, got one every {self.dt:.6g} s; {mend}"
            )


def recording(structure: Any, /, **signals: Any) -> tuple[Any, ...]:
    """Return the common time axis of signals, and each of them without its index."""
    labelled = {name: signal for name, signal in signals.items() if _is_pandas(signal)}
    if not labelled:
        return TimeAxis(), *signals.values()
    first, *others = labelled
    index = labelled[first].index
    for name in others:
        _require_same(first, index, name, labelled[name].index)
    dt = None if structure is not None and structure.takes_phi else _uniform(first, index)
    plain = (_checks.numbers(name, signal) if name in labelled else signal for name, signal in signals.items())
    return TimeAxis(index, dt), *plain


def table(columns: Any, index: Any = None, name: str | None = None) -> Any:
    """Return a pandas DataFrame."""
    try:
        import pandas as pd
    except ImportError:
        raise ImportError("to_frame: expected pandas, which is not installed; pip install pandas") from None
    frame = pd.DataFrame(columns, index=index)
    return frame if name is None or frame.index.name is not None else frame.rename_axis(index=name)


def _is_pandas(signal: Any) -> bool:
    """Tell a Series or a DataFrame."""
    pd = sys.modules.get("pandas")
    return pd is not None and isinstance(signal, (pd.Series, pd.DataFrame))


def _require_same(first: str, index: Any, name: str, other: Any) -> None:
    """Raise unless two indexes are equal."""
    if index.equals(other):
        return
    mend = f"take both from one DataFrame, or {first}.align({name}, join='inner', axis=0)"
    if len(index) != len(other):
        raise ValueError(f"{name}: expected the index of {first}, {len(index)} samples, got {len(other)}; {mend}")
    same = np.array([a == b for a, b in zip(index, other, strict=True)], dtype=bool)
    if same.all():
        # Equal labels of another type.
        return
    k = int(same.argmin())
    raise ValueError(f"{name}: expected the index of {first}, {index[k]} in sample {k}, got {other[k]}; {mend}")


def _uniform(name: str, index: Any) -> float | None:
    """Return the sampling period in s of an index, None if it has none, or raise if its steps differ."""
    pd = sys.modules["pandas"]
    has_times = isinstance(index, (pd.DatetimeIndex, pd.TimedeltaIndex))
    has_periods = isinstance(index, pd.PeriodIndex)
    # Months are not equally long; who gave a frequency has chosen them.
    calendar = getattr(index, "freq", None) is not None and has_times
    is_number = pd.api.types.is_numeric_dtype(index.dtype) and index.dtype.kind in "iuf"
    if pd.api.types.is_bool_dtype(index.dtype):
        raise ValueError(f"{name}: expected times or numbers in the index, got bools; {name}.reset_index(drop=True)")
    if len(index) < 2:
        return None
    if not (has_times or has_periods or is_number):
        _refuse_unread_times(name, index)
        return None
    if index.hasnans:
        k = int(np.argmax(index.isna()))
        raise ValueError(f"{name}: expected an index without gaps, got none in sample {k}; drop the row, then resample")
    place = index.to_numpy(dtype=float) if is_number else index.astype("int64").to_numpy()
    # pandas before 2 counts nanoseconds, whatever the index. To divide by a whole number gives 0.1 s, not 0.09999...
    per_second = float(np.timedelta64(1, "s") / np.timedelta64(1, getattr(index, "unit", "ns"))) if has_times else 1.0
    steps = np.diff(place)
    usual = float(np.median(steps))
    regular = np.abs(steps - usual) <= _JITTER * abs(usual)
    if usual <= 0.0 or not (regular.all() or calendar):
        _refuse(name, index, steps / per_second, usual / per_second, regular, has_times)
    if not has_times or not regular.all():
        return None
    return (float(place[-1]) - float(place[0])) / ((len(place) - 1) * per_second)


def _refuse_unread_times(name: str, index: Any) -> None:
    """Raise if labels are times that pandas has not read as such, from a file for instance."""
    for label in (index[0], index[-1]):
        if not isinstance(label, (str, datetime.date)):
            return
        try:
            sys.modules["pandas"].Timestamp(label)
        except (ValueError, TypeError, OverflowError):
            return
    # A file that spans a change of daylight saving stays text even with parse_dates. What pandas takes for the month
    # first is the day in most of the world.
    text = str(index[0])
    day_first = "dayfirst=True, " if re.match(r"\d{1,2}\.\d{1,2}\.\d{4}", text) else ""
    either = "; with dayfirst=True where the day stands first" if re.match(r"\d{1,2}[/-]\d{1,2}[/-]\d{4}", text) else ""
    raise ValueError(
        f"{name}: expected times in the index, got {type(index[0]).__name__} that reads as a time, {text!r} "
        f"in sample 0; df.index = pd.to_datetime(df.index, {day_first}utc=True){either}"
    )


def _refuse(name: str, index: Any, steps: Any, usual: float, regular: Any, has_times: bool) -> None:
    """Say which step of an index is irregular, and what to do."""
    k = int(np.argmax(steps <= 0)) if usual <= 0.0 else int(regular.argmin())
    mend = "y and u from df.sort_index()"
    if usual > 0.0:
        mend = "put a row with y = NaN where a sample is absent, or df.reset_index(drop=True) if the index is no time"
    if usual > 0.0 and has_times:
        mend = f'resample with df.resample("{usual:.6g}s").mean(), then fill u; y may stay NaN'
    second = " s" if has_times else ""
    raise ValueError(
        f"{name}: expected a uniform index, with steps of {abs(usual):.6g}{second}, got a step of "
        f"{steps[k]:.6g}{second} from {index[k]} to {index[k + 1]}, samples {k} and {k + 1}; {mend}"
    )
