"""Stamps: numbers of seconds, or instants that are kept to the nanosecond; never both in one fusion."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy import _checks, _stamps
from robust_filterpy._stamps import NANO

__all__ = ["Clock", "written"]


class Clock:
    """Turn stamps into keys that can be compared, keys into seconds between them, and keys into stamps again."""
    # A number is its own key; an instant's key is an integer, the nanoseconds since 1970: a float of seconds since then
    # would be known to a quarter of a microsecond. The first stamp decides which.

    def __init__(self, kind: str = "") -> None:
        """Keep what is known."""
        self.kind = kind

    def key(self, stamp: Any, name: str = "t") -> float | int:
        """Return the key of a stamp."""
        found = _stamps.read(name, stamp)
        if self.kind and self._of(found) != self.kind:
            raise TypeError(f"{name}: expected {_WORDS[self.kind]}, as the stamps before, got {_checks.shown(stamp)}")
        return found

    @staticmethod
    def _of(key: Any) -> str:
        """Return which kind a key is."""
        return "instants" if isinstance(key, (int, np.integer)) else "numbers"

    def decide(self, key: float | int) -> None:
        """Learn from a key whose stamp was taken which kind they are."""
        self.kind = self.kind or self._of(key)

    def keys(self, stamps: Any) -> tuple[np.ndarray, dict[int, str]]:
        """Return the keys of a column of stamps, float64 or int64, and what is wrong with some; raise if all are."""
        found, wrong = _stamps.column(stamps)
        if len(wrong) and len(wrong) == len(found):
            raise ValueError(f"{wrong[0]} in row 0, and none in any other")
        if found.dtype == object:
            raise TypeError("time: expected numbers or instants, got both")
        kind = self._of(found[0]) if len(found) else self.kind
        if self.kind and kind != self.kind:
            raise TypeError(f"time: expected {_WORDS[self.kind]}, as the stamps before, got {_WORDS[kind]}")
        return found, wrong

    @staticmethod
    def between(earlier: float | int, later: float | int) -> float:
        """Return the seconds from one key to another."""
        apart = later - earlier
        return apart / NANO if isinstance(apart, (int, np.integer)) else float(apart)

    @staticmethod
    def seconds(keys: np.ndarray) -> np.ndarray:
        """Return the seconds from each key to the next; keys ascend."""
        # Ascending int64 keys may be further apart than one of them can be from 1970.
        return np.diff(keys.view(np.uint64)) / NANO if keys.dtype == np.int64 else np.diff(keys)

    @staticmethod
    def moved(key: float | int, seconds: float) -> float | int:
        """Return the key so many seconds later."""
        if isinstance(key, (int, np.integer)):
            return int(key) + round(seconds * NANO)
        return key + seconds

    @staticmethod
    def stamp(key: float | int) -> Any:
        """Return the stamp of a key: a float, or a numpy.datetime64 in UTC."""
        return np.datetime64(int(key), "ns") if isinstance(key, (int, np.integer)) else float(key)


def written(stamp: Any) -> str:
    """Return a stamp as a sentence has it, without the zeros at the end of an instant's nanoseconds."""
    text = str(stamp)
    return text.rstrip("0").rstrip(".") if isinstance(stamp, np.datetime64) and "." in text else text


_WORDS = {"numbers": "a number of seconds", "instants": "an instant"}
