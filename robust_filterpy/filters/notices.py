"""What a filter says once: that it clips far too often, its innovations keep their sign, or a sensor is stuck."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._warning import SMALL, STOPPED, RobustFilterWarning, pointer, warn, was_said
from robust_filterpy.correction.options import Choices
from robust_filterpy.correction.spread import FILLED, HELD
from robust_filterpy.filters.policies import lags
from robust_filterpy.influence.information import clipping_point

__all__ = ["CorrelatedInnovationsWarning", "OutlierShareWarning", "StuckSensorWarning"]

#: Only every so many updates are looked at, so that it costs nothing.
EVERY = 3
# Innovations, and updates, that a window needs at least; half of it tells when nearly all of them are clipped.
_NUMBERS, _UPDATES = 64, 16
_NEARLY_ALL = 0.8
# More than this of what psi expects unclipped is too much; half a window is only sure of more.
_HALF, _SURER = 0.5, 0.7


class OutlierShareWarning(RobustFilterWarning):
    """Say that a filter clipped most of its last innovations, which no sensor with some outliers explains.

    Given once for each class of filter in a process. To switch it off: ``warnings.simplefilter("ignore",
    robust_filterpy.filters.OutlierShareWarning)``.
    """


class Share:
    """Keep which innovations of a window of updates were clipped, and their signs."""

    def __init__(self) -> None:
        """Start an empty window."""
        # As `_clipped` writes them; small, since a Saver copies them at each step.
        self.window = np.zeros((_NUMBERS, 0), np.int8)
        # How many updates and numbers there are, and of how many it is judged next.
        self.updates, self.numbers, self.due = 0, 0, _NUMBERS // 2

    def fills(self, m: int) -> bool:
        """Return whether the window may be judged after one more correction, by m sensors at most."""
        return self.updates + 1 >= _UPDATES and self.numbers + m >= self.due

    def look(self, kf: Any, weights: Array, y: Array) -> None:
        """Count one correction, and judge the window when it is full, or half full and nearly all of it clipped."""
        numbers = int(np.count_nonzero(weights == weights))
        if not numbers:
            return
        if self.window.shape[1] != len(weights):
            self.__init__()  # type: ignore[misc]
            self.window = np.zeros((_NUMBERS, len(weights)), np.int8)
        self.window[self.updates] = _clipped(kf, weights, y)
        self.updates, self.numbers = self.updates + 1, self.numbers + numbers
        if self.updates < _UPDATES or self.numbers < self.due:
            return
        window, least = self.window[: self.updates], _NEARLY_ALL
        self.due = _NUMBERS
        if self.numbers >= _NUMBERS:
            least = _HALF
            self.__init__()  # type: ignore[misc]
        _judge_share(kf, window, least)


def look_at_weights(kf: Any, weights: Array, y: Array) -> None:
    """Judge windows of a recording's corrections, shape (N, m), each of as many as `Share` takes."""
    seen = ~np.isnan(weights).all(axis=1)
    judged = _clipped(kf, weights[seen][::EVERY], y[seen][::EVERY])
    length = max(_UPDATES, -(-_NUMBERS // judged.shape[1]))
    for first in range(0, len(judged) - length + 1, length):
        window = judged[first : first + length]
        numbers = np.count_nonzero(window)
        if numbers >= _NUMBERS // 2:
            _judge_share(kf, window, _HALF if numbers >= _NUMBERS else _SURER)


def _clipped(kf: Any, weights: Array, y: Array) -> Any:
    """Return 2 for a clipped innovation and 1 for another, with its sign; 0 for a missing one."""
    size = np.where(weights < _weight_at_clip(kf.choices), 2, 1) * (weights == weights)
    return np.where(y < 0.0, -size, size).astype(np.int8)


def _judge_share(kf: Any, window: Any, least: float) -> None:
    """Warn, once for each class, if too much of what psi expects unclipped is: more than one jump or run clips."""
    name, m, numbers = type(kf).__name__, window.shape[1], np.count_nonzero(window)
    share = np.count_nonzero(np.abs(window) == 2) / numbers
    if not share > least or was_said(OutlierShareWarning, name):
        return
    expected = _expected(kf.influence, kf.grouping, m)
    if share > expected + least * (1.0 - expected):
        signs = np.sign(np.sign(window).sum(axis=1))
        keeps = (signs[1:] * signs[:-1] > 0.0).sum() > 0.75 * len(signs)
        cause = (
            "Q is too small (innovations keep their sign)"
            if keeps
            else "R is too small, or most measurements hold an outlier"
        )
        warn(
            f"{name}: clipped {share:.0%} of the last {numbers} innovations looked at, where its psi expects "
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


#: Updates of a period, those of them that are looked at (when a start is over, before a short recording is), and how
#: many signs must be kept: a fair coin does that once in six hundred thousand periods.
PERIOD, _FIRST, LAST, _KEPT = 240, 9, 57, 40


class CorrelatedInnovationsWarning(RobustFilterWarning):
    """Say that the innovations of a filter under ``noise=`` keep their sign.

    Most often the state moves as neither the model nor Q foresees, and the estimate lags behind: a filter that learns
    its noise may take that for a noisy sensor, and lag more than the Kalman filter does. Else the noise is colored.
    Given once for each kind of filter (class and sizes) in a process. To switch it off:
    ``warnings.simplefilter("ignore", robust_filterpy.filters.CorrelatedInnovationsWarning)``.
    """


class Signs:
    """Count for each sensor how often its innovation has the sign of the one before."""

    def __init__(self, m: int) -> None:
        """Start without any."""
        self.last, self.same, self.pairs = [0.0] * m, [0] * m, [0] * m

    def count(self, y: list[float]) -> None:
        """Count an innovation; NaN and 0 have no sign."""
        for i, (now, before) in enumerate(zip(y, self.last, strict=True)):
            if now > 0.0 or now < 0.0:
                self.pairs[i] += before != 0.0
                self.same[i] += now * before > 0.0
                self.last[i] = 1.0 if now > 0.0 else -1.0

    def is_decided(self) -> bool:
        """Return whether too many have changed, of each sensor, for the rest of a period to tell anything."""
        return all(pairs - same > LAST - _FIRST - _KEPT for same, pairs in zip(self.same, self.pairs, strict=True))

    def keeper(self) -> int | None:
        """Return a sensor whose innovations nearly all keep their sign, None if there is none."""
        return next((i for i, count in enumerate(self.same) if count >= _KEPT), None)


def look_at_signs(kf: Any, signs: Signs | None, last: Any, updates: int) -> Signs | None:
    """Count the signs of a correction's innovations now and then, and warn if they hardly ever change."""
    place = updates % PERIOD
    if not _FIRST <= place <= LAST or (signs is not None and place != _FIRST and signs.is_decided()):
        return signs
    y = _lags_of(last).tolist()
    if signs is None or place == _FIRST or len(signs.last) != len(y):
        signs = Signs(len(y))
    signs.count(y)
    if place == LAST:
        _judge(kf, signs, "")
    return signs


def look_at_recording(kf: Any, y: Array, first: int, variances: Callable[[list[int]], Array]) -> None:
    """Look at a recording as `look_at_signs` does."""
    seen = np.flatnonzero(~np.isnan(y).all(axis=1))
    for begin in range(0, len(seen), PERIOD):
        signs = Signs(y.shape[1])
        window = seen[begin + _FIRST - 1 : begin + LAST].tolist()
        if len(window) > LAST - _FIRST:
            for one in lags(y[window], variances(window)).tolist():
                signs.count(one)
            _judge(kf, signs, f": step {first + window[-1]}")


def _lags_of(last: Any) -> Array:
    """Return the innovations of a correction, NaN where missing, 0 where one is no lag."""
    if hasattr(last, "lags"):
        return last.lags  # type: ignore[no-any-return]
    return lags(np.where(np.isnan(last.weights), np.nan, last.y), last.S.diagonal())


def _judge(kf: Any, signs: Signs, where: str) -> None:
    """Warn, once for each kind of filter, if the signs of a sensor's innovations hardly ever change."""
    kind, sensor = (type(kf).__name__, int(kf.dim_x), int(kf.dim_z)), signs.keeper()
    if sensor is None:
        return
    warn(
        f"{kind[0]}{where}: {signs.same[sensor]} of {signs.pairs[sensor]} innovations of sensor {sensor} have the sign "
        f"of the one before (half is usual): the estimate lags behind, since the state moves as neither the model nor "
        f"Q foresees (a level on a slope, say), or the noise is colored; give the model that motion, or a larger Q; "
        f"robust_filterpy.diagnose tells, and {pointer(STOPPED)}. Switch this off with "
        f'warnings.simplefilter("ignore", robust_filterpy.filters.CorrelatedInnovationsWarning)',
        CorrelatedInnovationsWarning,
        of=kind,
    )


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
