"""A word, once, where a filter that learns its noise leaves a sensor out because it is stuck."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._warning import RobustFilterWarning, warn
from robust_filterpy.correction.spread import FILLED, HELD

__all__ = ["StuckSensorWarning"]


class StuckSensorWarning(RobustFilterWarning):
    """Say that a sensor repeats its last reading to the last bit, far from where a filter expects it.

    A sensor that is stuck does, and a logger that writes one number where it has none (-9999, 0, 65535). While it does,
    its readings count as missing: weight 0, under ``noise=`` outlier probability 1. Given once for each filter. Under
    ``grouping="joint"``, where ``noise=`` keeps no sensor apart, none is seen: name them, ``grouping=((0, 1, 2),)``. A
    `ParameterTracker` and a `TrackerBank` say it of y, from the third such reading in a row, and leave residual and
    weight NaN. To switch it off: ``warnings.simplefilter("ignore", robust_filterpy.filters.StuckSensorWarning)``.
    """


def look_for_stuck(kf: Any, weights: Array, first: int | None = None) -> None:
    """Warn, once for each filter, if a sensor is stuck."""
    stuck = np.argwhere(np.atleast_2d(weights) == 0.0)
    if len(stuck):
        step, sensor = stuck[0].tolist()
        name = type(kf).__name__
        say_stuck(name if first is None else f"{name}: step {first + step}", sensor, kf)


def look_for_repeats(kf: Any, memory: Array, before: Array | None = None) -> None:
    """Warn, once for each filter, if far readings that repeat the one before are taken for missing by custom."""
    more = memory[:, FILLED] > (0.0 if before is None else before[:, FILLED])
    repeats = np.flatnonzero(more & ((memory[:, HELD] > 0.0) | (before is not None)))
    if len(repeats):
        say_stuck(type(kf).__name__, int(repeats[0]), kf)


def say_stuck(where: str, sensor: int, of: Any = None) -> None:
    """Warn of a sensor, of a filter's once."""
    warn(
        f"{where}: sensor {sensor} is stuck: it repeats its last reading to the last bit, more than three standard "
        f"deviations from its prediction; it counts as missing (weight 0) for as long as it does",
        StuckSensorWarning,
        of=of,
    )


def say_stuck_among(where: str, of: str, stuck: Array) -> None:
    """Warn of those of many, series or keys, that have a sensor that is stuck; shape (count, m), bool."""
    if stuck.any():
        first, sensor = np.argwhere(stuck)[0].tolist()
        more = int(stuck.any(axis=1).sum()) - 1
        say_stuck(f"{where}: {of} {first}{f' and {more} more' if more else ''} of {len(stuck)}", sensor)
