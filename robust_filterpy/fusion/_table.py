"""From a table with a row for each reading, in any order, to what was read at each stamp."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy import _checks, _stamps
from robust_filterpy._checks import Array
from robust_filterpy._stamps import NANO, as_numpy
from robust_filterpy._warning import warn
from robust_filterpy.fusion._stepping import Setup
from robust_filterpy.fusion.sensors import FusionWarning


class Clock:
    """Turn stamps into keys that can be compared, keys into seconds between them, and keys into stamps again."""

    # A number is its own key; an instant's key is an integer, the nanoseconds since 1970: a float of seconds since then
    # would be known to a quarter of a microsecond. The first stamp decides which.

    def __init__(self, kind: str = "") -> None:
        """Keep what was learned."""
        self.kind = kind

    def key(self, stamp: Any, name: str = "t") -> float | int:
        """Return the key of a stamp."""
        key = _stamps.read(name, stamp)
        if self.kind and self._of(key) != self.kind:
            raise TypeError(f"{name}: expected {_WORDS[self.kind]}, as the stamps before, got {_checks.shown(stamp)}")
        return key

    @staticmethod
    def _of(key: Any) -> str:
        """Return which kind a key is."""
        return "instants" if isinstance(key, (int, np.integer)) else "numbers"

    def decide(self, key: float | int) -> None:
        """Learn from a key whose stamp was taken which kind they are."""
        self.kind = self.kind or self._of(key)

    def keys(self, stamps: Any) -> tuple[np.ndarray, dict[int, str]]:
        """Return the keys of a column of stamps, float64 or int64, and what is wrong with some; raise if all are."""
        keys, wrong = _stamps.column(stamps)
        if len(wrong) and len(wrong) == len(keys):
            raise ValueError(f"{wrong[0]} in row 0, and none in any other")
        if keys.dtype == object:
            raise TypeError("time: expected numbers or instants, got both")
        kind = self._of(keys[0]) if len(keys) else self.kind
        if self.kind and kind != self.kind:
            raise TypeError(f"time: expected {_WORDS[self.kind]}, as the stamps before, got {_WORDS[kind]}")
        return keys, wrong

    @staticmethod
    def between(earlier: float | int | None, later: float | int) -> float:
        """Return the seconds from one key to another, 0 from none."""
        apart = 0.0 if earlier is None else later - earlier
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
    """Return a stamp as a sentence has it, without rounding and the zeros at the end of an instant's nanoseconds."""
    text = str(stamp if isinstance(stamp, np.datetime64) else round(stamp, 9))
    return text.rstrip("0").rstrip(".") if isinstance(stamp, np.datetime64) and "." in text else text


_WORDS = {"numbers": "a number of seconds", "instants": "an instant"}


class Readings(NamedTuple):
    """Readings in the order of their stamps."""

    #: Of the stamps, (K,).
    keys: np.ndarray
    #: (K, M), NaN where nothing was read.
    zs: Array
    #: Control input in force until each stamp, (K, dim_u).
    inputs: Array
    duplicates: int


def read(
    setup: Setup, clock: Clock, table: Any, time: str, sensor: str, value: Any, controls: tuple[Any, Any] | None
) -> Readings:
    """Return the readings of a table, or raise."""
    layout = setup.layout
    stamps, who, *columns = table_columns(table, time, sensor, value)
    chosen = [value] if isinstance(value, str) else list(value)
    keys, wrong = clock.keys(stamps)
    values = np.column_stack([_checks.numbers(name, column) for name, column in zip(chosen, columns, strict=True)])
    if np.isinf(values).any():
        row = int(np.flatnonzero(np.isinf(values).any(axis=1))[0])
        raise ValueError(f"value: expected finite numbers or NaN (missing), got {values[row]} in row {row}")
    taken = np.delete(np.arange(len(keys)), list(wrong))
    if wrong:
        row, why = next(iter(wrong.items()))
        warn(f"{len(wrong)} of {len(keys)} rows were left out, the first is row {row}: {why}", FusionWarning)
        keys, who, values = keys[taken], who[taken], values[taken]
    index = _indices(layout.names, who)
    shift = np.array([s.delay for s in layout.sensors.values()])[index]
    keys = keys - (np.round(shift * 1e9).astype(np.int64) if keys.dtype == np.int64 else shift)
    at, us = _inputs(setup.motion.dim_u, clock, controls, keys.dtype)
    every, where = np.unique(np.concatenate([keys, at]), return_inverse=True)
    held, where = _held(us, where[len(keys) :], len(every), setup.motion.dim_u), where[: len(keys)]
    first, sizes = np.array([(place.start, place.stop - place.start) for place in layout.places.values()]).T
    wide = index[sizes[index] > len(chosen)]
    if len(wide):
        name, m = layout.names[wide[0]], sizes[wide[0]]
        raise ValueError(f"value: expected {m} columns, as sensor {name!r} has components, got {chosen}")
    rows, component = np.nonzero(np.arange(len(chosen)) < sizes[index][:, None])
    zs, said = np.full((len(every), layout.size), np.nan), values[rows, component]
    cells = where[rows], first[index[rows]] + component
    zs[cells] = said
    apart = rows[(zs[cells] != said) & ~(np.isnan(zs[cells]) & np.isnan(said))]
    if len(apart):
        raise ValueError(
            f"sensor {layout.names[index[apart[0]]]!r}: expected one reading for each stamp, got two that differ at "
            f"{clock.stamp(every[where[apart[0]]].item())} (row {taken[apart[0]]}); leave one out"
        )
    spoke = np.zeros((len(every), len(sizes)), dtype=bool)
    spoke[where, index] = True
    return Readings(every, zs, held, len(keys) - np.count_nonzero(spoke))


def table_columns(table: Any, time: str, sensor: str, value: str | Sequence[str]) -> list[np.ndarray]:
    """Return columns of a data frame or a dict by name, or raise."""
    if isinstance(table, Mapping):
        there, column = list(table), lambda name: np.asarray(table[name])
    else:
        frame = _stamps.frame(table, "or pass a dict of columns")
        there, column = frame.columns, lambda name: as_numpy(frame[name])
    names = [time, sensor, *(value if np.ndim(value) == 1 else [value])]
    if len(names) < 3 or not all(isinstance(name, (str, int)) for name in names):
        raise TypeError(
            f"time, sensor, value: expected names of columns, one of the first two and one or a list of the last, got "
            f"{_checks.shown(time)}, {_checks.shown(sensor)}, {_checks.shown(value)}"
        )
    missing = [name for name in names if name not in there]
    if missing:
        raise ValueError(
            f"table: expected the columns {missing}, got {list(there)}; time=, sensor= and value= name them, and where "
            f"each sensor has a column of its own, table.melt(id_vars=[..]) of pandas makes rows of them"
        )
    columns = [column(name) for name in names]
    if len({one.shape for one in columns}) > 1 or columns[0].ndim != 1:
        shapes = [one.shape for one in columns]
        raise ValueError(f"table: expected columns of one length, got {shapes}; value=[..] names one a component")
    return columns


def _indices(names: tuple[str, ...], who: np.ndarray) -> np.ndarray:
    """Return each row's sensor as its place among the declared, or raise."""
    unique, inverse = np.unique(np.array([str(name) for name in who.tolist()]), return_inverse=True)
    unknown = [name for name in unique.tolist() if name not in names]
    if unknown:
        raise ValueError(f"sensor: expected names among {list(names)}, got {unknown[:5]}; leave their rows out")
    return np.array([names.index(name) for name in unique.tolist()], dtype=int)[inverse]


def _inputs(p: int, clock: Clock, controls: Any, dtype: Any) -> tuple[np.ndarray, Array]:
    """Return keys and values of control inputs, or raise."""
    if controls is None:
        return np.zeros(0, dtype=dtype), np.zeros((0, p))
    if not isinstance(controls, tuple) or len(controls) != 2:
        raise TypeError(f"controls: expected (stamps, inputs), got {_checks.shown(controls)}")
    (keys, wrong), us = clock.keys(controls[0]), _checks.numbers("controls", controls[1])
    for row, why in wrong.items():
        raise ValueError(f"controls: {why} in row {row}")
    us = us[:, None] if us.ndim == 1 else us
    if us.shape != (len(keys), p) or not np.isfinite(us).all():
        raise ValueError(f"controls: expected finite inputs of shape ({len(keys)}, {p}), got shape {us.shape}")
    if keys.dtype != dtype:
        raise TypeError("controls: expected stamps of the kind that the table has")
    order = np.argsort(keys, kind="stable")
    if (np.diff(keys[order]) == 0).any():
        raise ValueError("controls: expected one input for each stamp, got two")
    return keys[order], us[order]


def _held(us: Array, places: np.ndarray, steps: int, p: int) -> Array:
    """Return the input in force from each stamp on, 0 before the first."""
    which = np.searchsorted(places, np.arange(steps), side="right")
    return np.concatenate([np.zeros((1, p)), us])[which]
