"""What a filter knows of its sensors, by their place in z or by their row of an H that was passed."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array

__all__ = ["Customs", "sensor_keys"]

# So many sensors that take turns through `update(z, R, H)` are told apart; the one that was met longest ago gives way.
_MOST = 32


class Customs(NamedTuple):
    """Memories of sensors, w numbers each; nothing in here is ever written to.

    A row of an H that was passed tells the sensor. One that is met for the first time begins with what is known of its
    place in z, so that an H that varies from step to step goes by places.
    """

    places: Array
    """Of the sensors in z, shape (m, w)."""
    rows: dict[bytes, Array]
    """Of those that were met in an H that was passed, by its row, each of shape (w,)."""

    def of(self, begin: Array, keys: list[Any]) -> Array:
        """Return the memories of some sensors, begin where nothing is known; keys as `sensor_keys` makes them."""
        found = begin.copy()
        for i, key in enumerate(keys):
            place = i if isinstance(key, bytes) else key
            if key in self.rows:
                found[i] = self.rows[key]
            elif place < len(self.places):
                found[i] = self.places[place]
        return found

    def updated(self, memory: Array, begin: Array, keys: list[Any]) -> Customs:
        """Return these with the memories of some sensors replaced, named as in `of`."""
        places, rows = self.places.copy(), dict(self.rows)
        for i, (key, one) in enumerate(zip(keys, memory, strict=True)):
            place = i if isinstance(key, bytes) else key
            if place >= len(places):
                places = np.vstack((places, np.tile(begin[:1], (place + 1 - len(places), 1))))
            places[place] = one
            if isinstance(key, bytes):
                rows.pop(key, None)
                rows[key] = one.copy()
        for key in list(rows)[: max(len(rows) - _MOST, 0)]:
            del rows[key]
        return Customs(places, rows)


def sensor_keys(passed: Array, own: Any) -> list[Any]:
    """Return what tells each sensor of an H that was passed: its place in the filter's own, or the bytes of its row."""
    m = len(passed)
    known = {}
    if np.ndim(own) == 2 and np.shape(own)[1] == passed.shape[1]:
        known = {row.tobytes(): i for i, row in reversed(list(enumerate(np.asarray(own, dtype=float))))}
    keys = [known.get(row.tobytes(), row.tobytes()) for row in passed]
    # Sensors that see exactly the same are told apart by their places.
    return keys if len(set(keys)) == m else list(range(m))
