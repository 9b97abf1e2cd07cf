"""What a filter says once: that it clips far too often, its innovations keep their sign, or a sensor is stuck."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._warning import SMALL, STOPPED, RobustFilterWarning, pointer, warn, was_said
from robust_filterpy.correction.mixed import Mixed
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.spread import FILLED, HELD
from robust_filterpy.influence.information import clipping_point
from robust_filterpy.kernel.moments import judged_of

__all__ = ["CorrelatedInnovationsWarning", "OutlierShareWarning", "StuckSensorWarning"]

#: Corrections are looked at in periods of so many, from the ninth on, when a start is over: which, and the place that
#: each has among those, by whether psi bounds them. Where noise is learned they are few, so that a short recording is
#: judged too; what psi clips moves slowly.
PERIOD, FIRST = 240, 9
LOOKS = {False: {FIRST + k: k for k in range(49)}, True: {FIRST + 3 * k: k for k in range(64)}}
# So many of 48 signs must be kept: a fair coin does that once in six hundred thousand periods.
_KEPT = 40
# More than this of what psi expects unclipped is too much.
_CLIPPED = 0.5


class OutlierShareWarning(RobustFilterWarning):
    """Say that a filter clipped most of its last innovations, which no sensor with some outliers explains.

    Given once for each class of filter in a process. To switch it off: ``warnings.simplefilter("ignore",
    robust_filterpy.filters.OutlierShareWarning)``.
    """


class CorrelatedInnovationsWarning(RobustFilterWarning):
    """Say that the innovations of a filter under ``noise=`` keep their sign.

    Most often the state moves as neither the model nor Q foresees, and the estimate lags behind: a filter that learns
    its noise may take that for a noisy sensor, and lag more than the Kalman filter does. Else the noise is colored.
    Given once for each kind of filter (class and sizes) in a process. To switch it off:
    ``warnings.simplefilter("ignore", robust_filterpy.filters.CorrelatedInnovationsWarning)``.
    """


def look(kf: Any, last: Any, place: int, count: int) -> None:
    """Note a correction at its place among those that are looked at, and judge them with the last."""
    seen = judged_of(last) if type(last) is np.ndarray else (last.lags if type(last) is Mixed else last.y, last.weights)
    if place == 0 or kf._window.shape != (count, 2, len(seen[0])):
        kf._window = np.zeros((count, 2, len(seen[0])))
    kf._window[place] = seen
    if place == count - 1:
        _judge(kf, noted(kf, kf._window[:, 1], kf._window[:, 0]), "")


def look_at_recording(kf: Any, weights: Array, y: Array, first: int, lagging: Callable[[list[int]], Array]) -> None:
    """Look at a recording's corrections, shape (N, m), as `look` does; lagging: the innovations of some steps."""
    seen, looks = np.flatnonzero(~np.isnan(y).all(axis=1)), np.array(list(kf.policy.looks)) - 1
    for begin in range(0, len(seen) - int(looks[-1]), PERIOD):
        window = seen[begin + looks].tolist()
        _judge(kf, noted(kf, weights[window], lagging(window)), f": step {first + window[-1]}")


def noted(kf: Any, weights: Array, y: Array) -> Array:
    """Return 2 for a clipped innovation and 1 for another, with its sign; 0 for one that is missing, or 0."""
    signs = np.where(np.isnan(weights), 0.0, np.sign(y))
    return signs if kf.noise is not None else np.where(weights < _weight_at_clip(kf.choices), 2.0, 1.0) * signs


def _judge(kf: Any, window: Array, where: str) -> None:
    """Warn of a filter under ``noise=`` by the signs of its innovations, of another by how many were clipped."""
    _judge_share(kf, window, where) if kf.noise is None else _judge_signs(kf, window, where)


def _judge_share(kf: Any, window: Array, where: str) -> None:
    """Warn, once for each class, if too much of what psi expects unclipped is: more than one jump or run clips."""
    name, numbers = type(kf).__name__, np.count_nonzero(window)
    if not numbers or was_said(OutlierShareWarning, name):
        return
    share = np.count_nonzero(np.abs(window) == 2) / numbers
    expected = _expected(kf.influence, kf.grouping, window.shape[1])
    if share > expected + _CLIPPED * (1.0 - expected):
        signs = np.sign(np.sign(window).sum(axis=1))
        keeps = (signs[1:] * signs[:-1] > 0.0).sum() > 0.75 * len(signs)
        cause = (
            "Q is too small (innovations keep their sign)"
            if keeps
            else "R is too small, or most measurements hold an outlier"
        )
        warn(
            f"{name}{where}: clipped {share:.0%} of the last {numbers} innovations looked at, where its psi expects "
            f"{expected:.0%}; most likely {cause}: robust_filterpy.diagnose tells, and "
            f"{pointer(STOPPED if keeps else SMALL)}. Switch this off with "
            f'warnings.simplefilter("ignore", robust_filterpy.filters.OutlierShareWarning)',
            OutlierShareWarning,
            of=name,
        )


def _weight_at_clip(choices: Choices) -> float:
    """Return psi(e)/e of the largest e up to which psi' > 0; what is clipped has less."""
    if "weight at clip" not in choices.derived:
        inside = max(min(clipping_point(choices.influence), 50.0) - 1e-3, 0.0)
        choices.derived["weight at clip"] = float(np.asarray(choices.influence.weights(np.array([inside])))[0])
    return float(choices.derived["weight at clip"])


def _expected(influence: Any, grouping: str, m: int) -> float:
    """Return the share of clipped innovations with as many outliers as psi is made for."""
    from scipy import stats

    grid = np.linspace(0.0, 10.0, 2001)
    density = stats.chi(m if grouping == "joint" else 1).pdf(grid)
    ordinary = float(density[np.asarray(influence.psi_deriv(grid)) <= 0.0].sum() / density.sum())
    contamination = float(getattr(influence, "contamination", 0.0) or 0.0)
    return ordinary + contamination * (1.0 - ordinary)


def _judge_signs(kf: Any, window: Array, where: str) -> None:
    """Warn, once for each kind of filter, if the signs of a sensor's innovations hardly ever change."""
    kind = (type(kf).__name__, int(kf.dim_x), int(kf.dim_z))
    for sensor, column in enumerate(window.T):
        signs = column[column != 0]
        same = np.count_nonzero(signs[1:] == signs[:-1])
        if same < _KEPT:
            continue
        # One with models doubts Q already.
        doubt = ', or process="scales", which learns it' if getattr(kf, "_kept", None) is None else ""
        warn(
            f"{kind[0]}{where}: {same} of {len(signs) - 1} innovations of sensor {sensor} have the sign of the one "
            f"before (half is usual): the estimate lags behind, since the state moves as neither the model nor Q "
            f"foresees (a level on a slope, say), or the noise is colored; give the model that motion, or a larger Q"
            f"{doubt}; robust_filterpy.diagnose tells, and {pointer(STOPPED)}. Switch this off with "
            f'warnings.simplefilter("ignore", robust_filterpy.filters.CorrelatedInnovationsWarning)',
            CorrelatedInnovationsWarning,
            of=kind,
        )
        return


class StuckSensorWarning(RobustFilterWarning):
    """Say that a sensor repeats its last reading to the last bit, far from where a filter expects it.

    A sensor that is stuck does, and a logger that writes one number where it has none (-9999, 0, 65535). While it
    does, its readings count as missing: weight 0, under ``noise=`` outlier probability 1. Given once for each filter.
    Under ``grouping="joint"``, where ``noise=`` keeps no sensor apart, none is seen: name them, ``grouping=((0, 1,
    2),)``. A `ParameterTracker` and a `TrackerBank` say it of y, from the third such reading in a row, and leave
    residual and weight NaN. To switch it off: ``warnings.simplefilter("ignore",
    robust_filterpy.filters.StuckSensorWarning)``.
    """


def look_for_stuck(kf: Any, weights: Array, first: int | None = None) -> None:
    """Warn, once for each filter, if a sensor is stuck."""
    stuck = np.argwhere(np.atleast_2d(weights) == 0.0)
    if len(stuck):
        step, sensor = stuck[0].tolist()
        name = type(kf).__name__
        say_stuck(name if first is None else f"{name}: step {first + step}", sensor, kf)


def look_for_repeats(kf: Any, memory: Array, before: Array | None = None) -> None:
    """Warn, once for each filter, if far readings that repeat the one before are taken for missing under "learnt"."""
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


def say_stuck_among(where: str, of: str, stuck: Array, name: Callable[[int], Any] = int) -> None:
    """Warn of those of many, series or keys, that have a sensor that is stuck; shape (count, m), bool."""
    if stuck.any():
        first, sensor = np.argwhere(stuck)[0].tolist()
        more = int(stuck.any(axis=1).sum()) - 1
        say_stuck(f"{where}: {of} {name(first)!r}{f' and {more} more' if more else ''} of {len(stuck)}", sensor)
