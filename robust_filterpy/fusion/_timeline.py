"""What was read when, in the order of stamps, and what follows from it: late readings make the rest be judged anew.

Each stamp has one entry, with what all sensors read then. What follows from an entry is kept with it until
something earlier arrives; then it is dirty, and judged anew when somebody asks. So the order of arrival plays no part,
to the last bit. Entries older than the window take nothing more; some of them are kept as history.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from itertools import pairwise
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.fusion._stepping import Moment, Setup
from robust_filterpy.fusion._table import Clock
from robust_filterpy.fusion.reacquisition import doubted
from robust_filterpy.fusion.verdicts import watched

__all__ = ["MOST", "MOST_WATCHED", "Entry", "Timeline"]

#: Entries that are kept, however long the window is: one late reading makes all after it be judged anew, and to look
#: back at sensors costs the more, the more there are.
MOST, MOST_WATCHED = 50_000, 5000


class Entry:
    """What was read at one stamp."""

    __slots__ = ("control", "key", "moment", "spoke", "z")

    def __init__(self, key: float | int, size: int) -> None:
        """Start with nothing read."""
        self.key, self.z, self.control = key, np.full(size, np.nan), None
        #: Names of the sensors that have said something, if only NaN.
        self.spoke: set[str] = set()
        self.moment: Moment | None = None


class Timeline:
    """Keep entries in the order of their stamps, and judge them when asked."""

    def __init__(self, setup: Setup, base: Moment, window: float, history: int) -> None:
        """Start empty."""
        self.setup, self.base, self.window, self.history = setup, base, window, history
        self.most = MOST_WATCHED if setup.watches or setup.reacquire is not None else MOST
        self.entries: list[Entry] = []
        self.keys: list[Any] = []
        #: Key of the moment that `base` is of; None before the first stamp, when no time has passed yet.
        self.base_key: float | int | None = None
        #: Entries before this one have their moments.
        self.clean = 0
        self.judging = False
        #: When each sensor has spoken last, of entries that are no longer kept.
        self.earlier: dict[str, float | int] = {}
        #: How many readings of each sensor could not be used, of entries that are no longer kept.
        self.unusable: dict[str, int] = {}
        #: First reading of each sensor that could not be used: its stamp's key, and why.
        self.reasons: dict[str, tuple[float | int, str]] = {}

    @property
    def horizon(self) -> float | int | None:
        """Key before which nothing is taken any more; None while everything is."""
        if not self.keys:
            return self.base_key
        closed = Clock.moved(self.keys[-1], -self.window)
        return closed if self.base_key is None else max(closed, self.base_key)

    @property
    def begun(self) -> float | int | None:
        """Key of the first moment that is kept; None if there is none."""
        return self.base_key if self.base_key is not None or not self.keys else self.keys[0]

    def at(self, key: float | int) -> Entry:
        """Return the entry of a stamp, a new one if there is none; from it on everything is dirty."""
        self.require_rest()
        i = bisect_left(self.keys, key)
        self.clean = min(self.clean, i)
        if i == len(self.keys) or self.keys[i] != key:
            self.entries.insert(i, Entry(key, self.setup.layout.size))
            self.keys.insert(i, key)
        return self.entries[i]

    def require_rest(self) -> None:
        """Raise while an entry is judged: a function of a sensor or of the motion has called its own fusion."""
        if self.judging:
            raise RuntimeError("fusion: expected no call of it from a function of its own sensors or motion")
        # Ctrl-C may come between the two insertions of `at`.
        if len(self.keys) != len(self.entries):
            self.keys = [entry.key for entry in self.entries]

    def find(self, key: float | int) -> Entry | None:
        """Return the entry of a stamp, if there is one."""
        self.require_rest()
        i = bisect_left(self.keys, key)
        return self.entries[i] if i < len(self.keys) and self.keys[i] == key else None

    def until(self, key: float | int | None = None) -> tuple[Moment, float | int | None, int]:
        """Return what there is after all entries up to a stamp, the last of their keys, and their number."""
        self.require_rest()
        last = len(self.keys) if key is None else bisect_right(self.keys, key)
        self.judging = True
        try:
            while self.clean < last:
                self._judge(self.clean)
                self.clean += 1
        finally:
            self.judging = False
        if not last:
            return self.base, self.base_key, 0
        return self.entries[last - 1].moment, self.keys[last - 1], last  # type: ignore[return-value]

    def _judge(self, i: int) -> None:
        """Judge an entry by those before it."""
        entry = self.entries[i]
        before, key = self.stands(i)
        seconds = 0.0 if key is None else Clock.between(key, entry.key)
        moment = doubted(self.setup, before, seconds, entry.key, entry.z, entry.control)
        entry.moment = moment if moment.watch is None else watched(self, i, moment)
        for name, why in moment.failed:
            self.reasons.setdefault(name, (entry.key, why))

    def stands(self, i: int) -> tuple[Moment, float | int | None]:
        """Return what there is before an entry, and of when it is."""
        if not i:
            return self.base, self.base_key
        # An entry before this one has been judged.
        return self.entries[i - 1].moment, self.keys[i - 1]  # type: ignore[return-value]

    def forget(self) -> bool:
        """Let go of entries that are neither in the window nor wanted as history, or too many; return if too many."""
        if self.horizon is None:
            return False
        closed = bisect_left(self.keys, self.horizon)
        crowded = len(self.keys) - self.most > closed
        # A few hundred at a time: to shorten a list costs as much as it has left.
        least = max(64, self.history // 4)
        beyond = len(self.keys) - self.most if crowded else closed - self.history
        if beyond < least:
            return False
        closed = max(closed, beyond)
        # All that is final is judged while its past is there.
        self.until(self.keys[closed - 1])
        base, key, _ = self.until(self.keys[beyond - 1])
        earlier = {**self.earlier, **{name: entry.key for entry in self.entries[:beyond] for name in entry.spoke}}
        unusable = self.failures(self.entries[:beyond])
        # No call from here on, so that Ctrl-C cannot fall between what belongs together.
        self.base, self.base_key, self.earlier, self.unusable = base, key, earlier, unusable
        del self.entries[:beyond], self.keys[:beyond]
        self.clean -= beyond
        return crowded

    def failures(self, entries: list[Entry]) -> dict[str, int]:
        """Return how many readings of each sensor could not be used, in these entries and those no longer kept."""
        counts = dict(self.unusable)
        for entry in entries:
            for name, _ in entry.moment.failed if entry.moment is not None else ():
                counts[name] = counts.get(name, 0) + 1
        return counts

    def last_words(self, entries: int) -> dict[str, float | int]:
        """Return when each sensor has spoken last, in the first entries; who never has is left out."""
        latest: dict[str, float | int] = {}
        for entry in reversed(self.entries[:entries]):
            for name in entry.spoke - latest.keys():
                latest[name] = entry.key
            if len(latest) == len(self.setup.layout.names):
                return latest
        return {**self.earlier, **latest}

    def intervals(self, entries: int) -> dict[str, float]:
        """Return the median seconds between two readings of each sensor, in the first entries; of two at least."""
        keys: dict[str, list[Any]] = {}
        for entry in self.entries[:entries]:
            for name in entry.spoke:
                keys.setdefault(name, []).append(entry.key)
        return {
            name: float(np.median([Clock.between(a, b) for a, b in pairwise(at)]))
            for name, at in keys.items()
            if len(at) > 2
        }

    def readings(self) -> Array:
        """Return what was read at every entry that is kept, (entries, M)."""
        return np.array([entry.z for entry in self.entries]).reshape(len(self.entries), self.setup.layout.size)
