"""Stamps: numbers of seconds, or instants that are kept to the nanosecond; never both in one fusion."""

from __future__ import annotations

import math
from datetime import datetime, timezone
from typing import Any

import numpy as np

from robust_filterpy import _checks

__all__ = ["Clock", "written"]

_NANO = 1_000_000_000
# Numbers as large as this are no seconds since 1970, but milliseconds or smaller parts of one.
_NO_SECONDS = 1e11
# A stamp of single precision must still tell moments that are so many seconds apart.
_COARSE = 1e-3


class Clock:
    """Turn stamps into keys that can be compared, keys into seconds between them, and keys into stamps again.

    A number is its own key; an instant's key is an integer, the nanoseconds since 1970: a float of seconds since then
    would be known to a quarter of a microsecond. The first stamp decides which.

    Parameters
    ----------
    kind : {"", "numbers", "instants"}
        What the stamps are; empty as long as there was none.
    """

    def __init__(self, kind: str = "") -> None:
        """Keep what is known."""
        self.kind = kind

    def key(self, stamp: Any, name: str = "t") -> float | int:
        """Return the key of a stamp.

        Parameters
        ----------
        stamp : float, numpy.datetime64, pandas.Timestamp or datetime with a time zone
            When.
        name : str
            What a message calls it.

        Returns
        -------
        float or int

        Raises
        ------
        ValueError, TypeError
            If it is no time, has no time zone, or is of another kind than those before.
        """
        kind, found = _read(stamp, name)
        if self.kind and kind != self.kind:
            raise TypeError(f"{name}: expected {_WORDS[self.kind]}, as the stamps before, got {_checks.shown(stamp)}")
        return found

    def decide(self, stamp: Any) -> None:
        """Learn from a stamp that was taken which kind they are."""
        self.kind = self.kind or _read(stamp, "t")[0]

    def keys(self, stamps: Any) -> np.ndarray:
        """Return the keys of a column of stamps, float64 or int64, or raise."""
        values = np.asarray(stamps)
        if values.dtype.kind == "M":
            if np.isnat(values).any():
                raise ValueError("time: expected a time in every row, got NaT")
            found = values.astype("M8[ns]").astype(np.int64)
        elif values.dtype.kind in "iuf":
            found = values.astype(float)
            if not np.isfinite(found).all():
                raise ValueError("time: expected a finite time in every row, got NaN or infinity")
            if len(values):
                _require_seconds("time", values[np.argmax(np.abs(found))])
        else:
            pairs = [_read(value, "time") for value in values.tolist()]
            kinds = {kind for kind, _ in pairs}
            if len(kinds) > 1:
                raise TypeError("time: expected numbers or instants, got both")
            found = np.array([key for _, key in pairs], dtype=float if kinds == {"numbers"} else np.int64)
        kind = "instants" if found.dtype == np.int64 else "numbers"
        if self.kind and len(found) and kind != self.kind:
            raise TypeError(f"time: expected {_WORDS[self.kind]}, as the stamps before, got {_WORDS[kind]}")
        return found

    @staticmethod
    def between(earlier: float | int, later: float | int) -> float:
        """Return the seconds from one key to another."""
        apart = later - earlier
        return apart / _NANO if isinstance(apart, (int, np.integer)) else float(apart)

    @staticmethod
    def seconds(keys: np.ndarray) -> np.ndarray:
        """Return the seconds from each key to the next."""
        apart = np.diff(keys)
        return apart / _NANO if apart.dtype == np.int64 else apart

    @staticmethod
    def moved(key: float | int, seconds: float) -> float | int:
        """Return the key so many seconds later."""
        if isinstance(key, (int, np.integer)):
            return int(key) + round(seconds * _NANO)
        return key + seconds

    @staticmethod
    def stamp(key: float | int) -> Any:
        """Return the stamp of a key: a float, or a numpy.datetime64 in UTC."""
        return np.datetime64(int(key), "ns") if isinstance(key, (int, np.integer)) else float(key)


def written(stamp: Any) -> str:
    """Return a stamp as a sentence has it, without the zeros at the end of an instant's nanoseconds.

    Parameters
    ----------
    stamp : float or numpy.datetime64
        When.

    Returns
    -------
    str
    """
    text = str(stamp)
    return text.rstrip("0").rstrip(".") if isinstance(stamp, np.datetime64) and "." in text else text


_WORDS = {"numbers": "a number of seconds", "instants": "an instant"}


def _read(stamp: Any, name: str) -> tuple[str, float | int]:
    """Return the kind and the key of a stamp, or raise."""
    if hasattr(stamp, "to_datetime64"):
        # pandas; one without a zone is what numpy's is: in UTC.
        stamp = stamp.to_datetime64()
    if isinstance(stamp, np.datetime64):
        if np.isnat(stamp):
            raise ValueError(f"{name}: expected a time, got NaT")
        found = int(stamp.astype("M8[ns]").astype(np.int64))
        if np.datetime64(found, "ns") != stamp:
            raise ValueError(f"{name}: expected an instant that nanoseconds can count, 1678 to 2262, got {stamp}")
        return "instants", found
    if isinstance(stamp, datetime):
        if stamp.tzinfo is None:
            raise ValueError(
                f"{name}: expected a datetime with a time zone, got {stamp!r}, which means another instant on every "
                "machine; use datetime(.., tzinfo=timezone.utc)"
            )
        since = stamp - datetime(1970, 1, 1, tzinfo=timezone.utc)
        return "instants", (since.days * 86400 + since.seconds) * _NANO + since.microseconds * 1000
    if isinstance(stamp, np.timedelta64) or type(stamp).__name__ in ("timedelta", "Timedelta"):
        raise TypeError(f"{name}: expected seconds or an instant, got a duration, {stamp!r}; use its total_seconds()")
    if isinstance(stamp, str):
        raise TypeError(
            f"{name}: expected seconds or an instant, got the text {stamp!r}; pandas.to_datetime(.., utc=True) reads it"
        )
    number = _checks.real(name, stamp)
    if not math.isfinite(number):
        raise ValueError(f"{name}: expected a finite time, got {number}")
    _require_seconds(name, stamp)
    return "numbers", number


def _require_seconds(name: str, stamp: Any) -> None:
    """Raise if a number is no time in seconds that can be told from others."""
    if abs(stamp) >= _NO_SECONDS:
        unit = "ms" if abs(stamp) < 1e14 else "us" if abs(stamp) < 1e17 else "ns"
        raise ValueError(
            f"{name}: expected seconds, got {stamp:.6g}, which looks like {unit} since 1970; use "
            f'np.datetime64(int(t), "{unit}"), of a column column.astype("datetime64[{unit}]")'
        )
    if isinstance(stamp, (np.float32, np.float16)) and np.spacing(np.abs(stamp)) > _COARSE:
        raise ValueError(
            f"{name}: expected a float of double precision, got {stamp:.9g} of {stamp.dtype}, which is known to "
            f"{np.spacing(np.abs(stamp)):.3g} s only"
        )
