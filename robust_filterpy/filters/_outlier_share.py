"""A warning for a filter that clips far more than its psi is made for: its model is wrong, not its sensor."""

from __future__ import annotations

from typing import Any

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._documentation import SMALL, STOPPED, pointer
from robust_filterpy._warning import RobustFilterWarning, warn, was_said

__all__ = ["EVERY", "OutlierShareWarning", "Share"]

#: Only every so many updates are looked at, so that it costs nothing.
EVERY = 3
# Innovations, and updates, that a window needs at least; half of it tells when nearly all of them are clipped.
_NUMBERS, _UPDATES = 64, 16
_NEARLY_ALL = 0.8
# More than this of what psi expects unclipped is too much; half a window is only sure of more.
_HALF, _SURER = 0.5, 0.7


class OutlierShareWarning(RobustFilterWarning):
    """Say that a filter clipped most of its last innovations, which no sensor with some outliers explains.

    Given once for each class of filter in a process. To switch it off:
    ``warnings.simplefilter("ignore", robust_filterpy.filters.OutlierShareWarning)``.
    """


class Share:
    """Count the clipped innovations of a window of updates."""

    def __init__(self) -> None:
        """Start an empty window."""
        self.numbers = self.updates = self.clipped = self.kept = 0
        self.sign = 0.0

    def fills(self, m: int) -> bool:
        """Return whether one more correction, by m sensors at most, can fill the window."""
        return self.updates + 1 >= _UPDATES and (self.numbers + m >= _NUMBERS or self._tells_early(m))

    def _tells_early(self, m: int = 0) -> bool:
        """Return whether nearly all of half a window are clipped, were m more to be."""
        return self.numbers + m >= _NUMBERS // 2 and self.clipped + m > _NEARLY_ALL * (self.numbers + m)

    def look(self, kf: Any, last: Any) -> None:
        """Count one correction, and judge the window when it is full."""
        e = np.ravel(last.e).tolist()
        observed = [d for d in np.ravel(last.psi_deriv).tolist() if d == d]
        sign = sum(1.0 if number > 0.0 else -1.0 for number in e)
        self.numbers += len(observed)
        self.updates += 1
        self.clipped += sum(d <= 0.0 for d in observed)
        self.kept += sign * self.sign > 0.0
        self.sign = sign
        if self.updates >= _UPDATES and (self.numbers >= _NUMBERS or self._tells_early()):
            share, numbers, keeps = self.clipped / self.numbers, self.numbers, self.kept > 0.75 * self.updates
            least = _HALF if numbers >= _NUMBERS else _SURER
            self.__init__()  # type: ignore[misc]
            if kf.scaling == "innovation":
                self._judge(kf, share, least, numbers, keeps, len(e))

    def look_at_recording(self, kf: Any, weights: Array, y: Array) -> None:
        """Judge windows of a recording's corrections, each of as many as `look` takes."""
        seen = ~np.isnan(weights).all(axis=1)
        weights, signs = weights[seen][::EVERY], np.sign(y[seen][::EVERY])
        here = ~np.isnan(weights)
        clipped, signs = weights < _weight_at_clip(kf.influence), np.sign(np.where(here, signs, 0.0).sum(axis=1))
        length = max(_UPDATES, -(-_NUMBERS // weights.shape[1]))
        for first in range(0, len(weights) - length + 1, length):
            window = slice(first, first + length)
            numbers, sign = int(here[window].sum()), signs[window]
            keeps = (sign[1:] * sign[:-1] > 0.0).sum() > 0.75 * length
            if numbers >= _NUMBERS // 2:
                least = _HALF if numbers >= _NUMBERS else _SURER
                self._judge(kf, float(clipped[window].sum()) / numbers, least, numbers, bool(keeps), weights.shape[1])

    def _judge(self, kf: Any, share: float, least: float, numbers: int, keeps: bool, m: int) -> None:
        """Warn if too much of what psi expects unclipped is clipped, more than one jump or run of outliers clips."""
        if share > least and not was_said(OutlierShareWarning, type(kf).__name__):
            expected = _expected(kf.influence, kf.grouping, m)
            if share > expected + least * (1.0 - expected):
                self._warn(type(kf).__name__, share, expected, numbers, keeps)

    def _warn(self, name: str, share: float, expected: float, numbers: int, keeps: bool) -> None:
        """Warn once for each class."""
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


def _weight_at_clip(influence: Any) -> float:
    """Return psi(e)/e of the largest e up to which psi' > 0; what is clipped has less."""
    grid = np.linspace(0.0, 50.0, 50_001)
    inside = np.asarray(influence.psi_deriv(grid)) > 0.0
    last = len(grid) - 1 if inside.all() else max(int(np.argmin(inside)) - 1, 0)
    return float(np.asarray(influence.weights(grid[[last]]))[0])


def _expected(influence: Any, grouping: str, m: int) -> float:
    """Return the share of clipped innovations with as many outliers as psi is made for."""
    from scipy import stats

    grid = np.linspace(0.0, 10.0, 2001)
    density = stats.chi(m if grouping == "joint" else 1).pdf(grid)
    ordinary = float(density[np.asarray(influence.psi_deriv(grid)) <= 0.0].sum() / density.sum())
    contamination = float(getattr(influence, "contamination", 0.0) or 0.0)
    return ordinary + contamination * (1.0 - ordinary)
