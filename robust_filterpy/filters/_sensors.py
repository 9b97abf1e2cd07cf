"""What a filter knows of its sensors, by their place in z or by their row of an H that was passed."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction import spread

__all__ = ["Customs", "nothing_known"]

# So many sensors that take turns through `update(z, R, H)` are told apart; the one that was met longest ago gives way.
_MOST = 32


class Customs(NamedTuple):
    """Memories of sensors; nothing in here is ever written to.

    A row of an H that was passed tells the sensor. One that is met for the first time begins with what is known of its
    place in z, so that an H that varies from step to step goes by places.
    """

    places: Array
    """Of the sensors in z, shape (m, 6)."""
    rows: dict[bytes, Array]
    """Of those that were met in an H that was passed, by its row, each of shape (6,)."""

    def of(self, m: int, passed: Array | None = None, own: Any = None) -> Array:
        """Return the memories of m sensors, shape (m, 6).

        Parameters
        ----------
        m : int
            How many.
        passed : ndarray, shape (m, n), optional
            An H that was passed to `update`; its rows tell the sensors.
        own : array_like, optional
            The filter's H, whose rows belong to places.
        """
        found = spread.begin(m)
        for i, key in enumerate(_keys(m, passed, own)):
            if isinstance(key, bytes) and key in self.rows:
                found[i] = self.rows[key]
            else:
                place = i if isinstance(key, bytes) else key
                if place < len(self.places):
                    found[i] = self.places[place]
        return found

    def updated(self, memory: Array, passed: Array | None = None, own: Any = None) -> Customs:
        """Return these with the memories of some sensors replaced, named as in `of`."""
        m = len(memory)
        keys = _keys(m, passed, own)
        if m == len(self.places) and keys == list(range(m)):
            return Customs(memory, self.rows)
        places, rows = self.places.copy(), dict(self.rows)
        for i, (key, one) in enumerate(zip(keys, memory, strict=True)):
            place = i if isinstance(key, bytes) else key
            if place >= len(places):
                places = np.vstack((places, spread.begin(place + 1 - len(places))))
            places[place] = one
            if isinstance(key, bytes):
                rows.pop(key, None)
                rows[key] = one.copy()
        for key in list(rows)[: max(len(rows) - _MOST, 0)]:
            del rows[key]
        return Customs(places, rows)


def _keys(m: int, passed: Array | None, own: Any) -> list[Any]:
    """Return for each sensor its place, or the bytes of its row."""
    if passed is None:
        return list(range(m))
    known = {}
    if np.ndim(own) == 2 and np.shape(own)[1] == passed.shape[1]:
        known = {row.tobytes(): i for i, row in reversed(list(enumerate(np.asarray(own, dtype=float))))}
    keys = [known.get(row.tobytes(), row.tobytes()) for row in passed]
    # Sensors that see exactly the same are told apart by their places.
    return keys if len(set(keys)) == m else list(range(m))


def nothing_known(m: int) -> Customs:
    """Return the memories of m sensors before the first measurement."""
    return Customs(spread.begin(m), {})
