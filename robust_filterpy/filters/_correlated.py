"""A word where the innovations of a filter that learns its noise keep their sign: its model is too simple."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._documentation import STOPPED, pointer
from robust_filterpy._warning import RobustFilterWarning, warn
from robust_filterpy.filters.policies import ordinary_noise

__all__ = ["CorrelatedInnovationsWarning", "Signs", "judges", "look_at_recording", "look_at_signs"]

#: Updates of a period, those of them that are looked at (when a start is over, before a short recording is), and how
#: many signs must be kept: a fair coin does that once in six hundred thousand periods.
_PERIOD, _FIRST, _LAST, _KEPT = 240, 9, 57, 40
#: An innovation of fewer standard deviations is what a start leaves where there is no noise: it has no sign.
_NO_LAG = 0.1


class CorrelatedInnovationsWarning(RobustFilterWarning):
    """Say that the innovations of a filter under ``noise=`` keep their sign.

    Most often the state moves as neither the model nor Q foresees, and the estimate lags behind: a filter that learns
    its noise may take that for a noisy sensor, and lag more than the Kalman filter does. Else the noise has a colour.
    Given once for each kind of filter (class and sizes) in a process. To switch it off:
    ``warnings.simplefilter("ignore", robust_filterpy.filters.CorrelatedInnovationsWarning)``.
    """


class Signs:
    """Count for each sensor how often its innovation has the sign of the one before."""

    def __init__(self, m: int) -> None:
        """Start without any."""
        self.last, self.kept, self.pairs = [0.0] * m, [0] * m, [0] * m

    def count(self, y: list[float]) -> None:
        """Count an innovation; NaN and 0 have no sign."""
        for i, (now, before) in enumerate(zip(y, self.last, strict=True)):
            if now > 0.0 or now < 0.0:
                self.pairs[i] += before != 0.0
                self.kept[i] += now * before > 0.0
                self.last[i] = 1.0 if now > 0.0 else -1.0

    def keeper(self) -> int | None:
        """Return a sensor whose innovations nearly all keep their sign, None if there is none."""
        return next((i for i, kept in enumerate(self.kept) if kept >= _KEPT), None)


def judges(updates: int) -> bool:
    """Return whether the update of this number may give a warning."""
    return updates % _PERIOD == _LAST


def look_at_signs(kf: Any, signs: Signs | None, last: Any, updates: int) -> Signs | None:
    """Count the signs of a correction's innovations now and then, and warn if they hardly ever change."""
    place = updates % _PERIOD
    if not _FIRST <= place <= _LAST:
        return signs
    y = _innovation_of(last)
    if signs is None or place == _FIRST or len(signs.last) != len(y):
        signs = Signs(len(y))
    signs.count(y)
    if place == _LAST:
        _judge(kf, signs, "")
    return signs


def look_at_recording(kf: Any, y: Array, first: int, variances: Callable[[list[int]], Array]) -> None:
    """Look at a recording as `look_at_signs` does."""
    seen = np.flatnonzero(~np.isnan(y).all(axis=1))
    for begin in range(0, len(seen), _PERIOD):
        signs = Signs(y.shape[1])
        window = seen[begin + _FIRST - 1 : begin + _LAST].tolist()
        if len(window) > _LAST - _FIRST:
            for one in _signed(y[window], variances(window)):
                signs.count(one)
            _judge(kf, signs, f": step {first + window[-1]}")


def _innovation_of(last: Any) -> list[float]:
    """Return the innovation of a correction, NaN where missing, 0 where it is no lag."""
    if not hasattr(last, "prior_x"):
        return _signed(np.where(np.isnan(last.weights), np.nan, last.y), last.S.diagonal())
    H, R = last.H, ordinary_noise(last.R, last.before)
    noise = R if last.curvature is None else R + last.curvature
    return _signed(last.z - H.dot(last.prior_x), (H.dot(last.prior_P) * H).sum(axis=1) + noise.diagonal())


def _signed(y: Array, variances: Array) -> Any:
    """Return innovations as lists, 0 where one is no lag."""
    return np.where(np.abs(y) < _NO_LAG * np.sqrt(variances), 0.0, y).tolist()


def _judge(kf: Any, signs: Signs, where: str) -> None:
    """Warn, once for each kind of filter, if the signs of a sensor's innovations hardly ever change."""
    kind, sensor = (type(kf).__name__, int(kf.dim_x), int(kf.dim_z)), signs.keeper()
    if sensor is None:
        return
    warn(
        f"{kind[0]}{where}: {signs.kept[sensor]} of {signs.pairs[sensor]} innovations of sensor {sensor} have the sign "
        f"of the one before (half is usual): the estimate lags behind, since the state moves as neither the model nor "
        f"Q foresees (a level on a slope, say), or the noise is colored; give the model that motion, or a larger Q; "
        f"robust_filterpy.diagnose tells, and {pointer(STOPPED)}. Switch this off with "
        f'warnings.simplefilter("ignore", robust_filterpy.filters.CorrelatedInnovationsWarning)',
        CorrelatedInnovationsWarning,
        of=kind,
    )
