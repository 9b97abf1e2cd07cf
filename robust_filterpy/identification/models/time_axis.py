"""The time axis of a recording that comes as pandas objects, and results on the same axis.

Nothing here imports pandas: whoever passes a Series or a DataFrame has done so.
"""

from __future__ import annotations

import datetime
import math
import re
import sys
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy import _checks

__all__ = ["TimeAxis", "recording", "table"]

# A step is regular within this share of the usual one; the clocks of loggers are no better.
_JITTER: Final = 0.05
# Two sampling periods that differ by no more are the same.
_SAME: Final = 0.01


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

    def series(self, values: Any, name: str) -> Any:
        """Return values as a pandas Series on this axis, or as they are if there is no index."""
        return values if self.index is None else sys.modules["pandas"].Series(values, index=self.index, name=name)

    def labelled(self, values: Any, name: str) -> Any:
        """Return values of one signal or of several, as columns by number, on this axis."""
        several = np.ndim(values) == 2 and self.index is not None
        return table(dict(enumerate(values.T)), self.index) if several else self.series(values, name)

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


def table(columns: dict[Any, Any], index: Any = None, name: str | None = None) -> Any:
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
