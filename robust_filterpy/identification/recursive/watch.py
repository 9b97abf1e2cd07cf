"""Whether n actuators have lost their plants, judged by what their samples have in common."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._warning import STOPPED, RobustFilterWarning, pointer
from robust_filterpy.identification.models import dependence as gain
from robust_filterpy.identification.models.dependence import (
    CLIP,
    SHARE,
    autocovariances,
    dependence,
    level_and_scale,
    whitening_of,
)
from robust_filterpy.identification.models.structures import Structure
from robust_filterpy.influence.regression import mad_scale

__all__ = ["LOST", "OF_START", "OF_STUCK", "USUAL", "LostTrackerWarning", "News", "Trouble", "Watch", "long_held"]

# Samples that are judged together.
_WINDOW: Final = 200
# A filter that has clipped half of what it saw believes in another model than the data.
_LEAST_WEIGHT: Final = 0.5
# More steps than this share that leave the stable models come from a wrong structure or step.
_MOST_GUARDED: Final = 0.25
# A level next to which the scatter of the residuals is small is an offset.
_OFFSET: Final = 2.0
# Residuals are held against the past inputs in windows of so many samples, this many apart: a plant that changes is
# in the whole of one after their sum.
SPAN: Final = 120
_PERIOD: Final = 40
# A level has moved if so many residuals in a row, or more, are so many standard deviations of their mean off zero: with
# 30 % outliers, all on one side, quiet runs reach 5.6.
_IN_A_ROW: Final = 20
_MOVED: Final = 7.0
# Where so many residuals are no more than rounding, the plant rests or has no noise, and they tell nothing.
_NEARLY_ALL: Final = 0.9
#: Numbers that are usual of an actuator.
USUAL: Final = 4
# So seldom the residuals of a right model look as if they followed the inputs.
_BY_CHANCE: Final = 1e-2
# Of the autocovariances of ordinary residuals, how much each look renews.
_PACE: Final = 0.15
# R may follow noise that changes, not over this factor.
_WANDERING: Final = 1e4

# A sensor that is stuck for fewer samples is left out without a word: an outlier may give the same number twice.
_HELD: Final = 3


class LostTrackerWarning(RobustFilterWarning):
    """A tracker that has stopped following its plant."""


class Trouble(NamedTuple):
    """What is to be said of an actuator."""

    actuator: int
    text: str
    category: type[UserWarning] = LostTrackerWarning
    #: What is to be added to the model's gain, in shares of it, where that mends it.
    gain: float = 0.0

    @property
    def said(self) -> str:
        """The sentence, and where to read on."""
        return f"{self.text}; {pointer(STOPPED)}" if self.category is LostTrackerWarning else self.text


News = list[Trouble]


#: What is said of an actuator once.
LOST, OF_START, OF_STUCK = range(3)


class Watch(NamedTuple):
    """What shows that a model is no longer the plant's, and what has been said of it, of n actuators."""

    #: How many samples, (n,).
    seen: np.ndarray
    #: Of ordinary residuals the autocovariances, and how much of them follows the inputs anyway, (n, 4).
    usual: Array
    #: The last residuals, and the predictions and inputs of the same samples, (n, SPAN, 1 + n_signals).
    rows: Array
    #: Of the gain in the last blocks of _PERIOD samples, (n, gain.BLOCKS, 2).
    scores: Array
    #: Residual, weight and guard of the last samples, until there are enough to judge them, (n, L, 3).
    recent: Array
    #: R when it was first judged, NaN before, (n,).
    R: Array
    #: What has been said, (n, 3).
    spoken: np.ndarray

    @classmethod
    def none(cls, n: int, n_signals: int) -> Watch:
        """Return it before the first sample."""
        rows, scores, spoken = np.zeros((n, SPAN, 1 + n_signals)), np.zeros((n, gain.BLOCKS, 2)), np.zeros((n, 3), bool)
        seen, usual = np.zeros(n, dtype=int), np.zeros((n, USUAL))
        return cls(seen, usual, rows, scores, np.zeros((n, 0, 3)), np.full(n, np.nan), spoken)

    def restored(self, stored: Mapping[str, Array]) -> Watch:
        """Return it with what a state has of it; what was said stays said."""
        last = stored["followed"][:, -SPAN:]
        empty = Watch.none(len(last), last.shape[2] - 1)
        empty.rows[:, SPAN - last.shape[1] :] = last
        seen, usual, scores = stored["seen"].astype(int), stored["usual"], stored["scores"]
        return empty._replace(seen=seen, usual=usual, scores=scores, spoken=self.spoken)

    def waits(self, which: np.ndarray) -> int:
        """Return after how many samples one of some actuators is to be looked at."""
        return int((_PERIOD - self.seen[which] % _PERIOD).min()) if which.size else sys.maxsize

    @property
    def fills(self) -> int:
        """After how many samples the next window is full."""
        return _WINDOW - self.recent.shape[1] % _WINDOW

    def forgotten(self, i: int, whole: bool = True) -> Watch:
        """Return it with nothing seen of an actuator, for another model; or but for the window that fills."""
        watch = Watch(*(a.copy() for a in self))
        for a in watch[:4]:
            a[i] = 0
        if whole:
            watch.recent[i], watch.R[i], watch.spoken[i, LOST] = np.nan, np.nan, False
        return watch

    def begun(self, i: int, residuals: Array, signals: Array, rounding: float) -> tuple[Watch, float]:
        """Return it with what is usual of an actuator: what its model leaves of its own recording."""
        windows = [slice(k - SPAN, k) for k in range(len(residuals), SPAN - 1, -SPAN)]
        after = self.forgotten(i, False)
        if not windows or np.isnan(residuals).all() or _tells_nothing(residuals, rounding):
            return after, 0.0
        covariances = np.mean([autocovariances(residuals[window]) for window in windows], axis=0)
        regressions = [dependence(residuals[w], signals[w], whitening=whitening_of(covariances)) for w in windows]
        shares = [max(float(one.share), 0.0) for one in regressions]
        after.usual[i] = *covariances, max(shares)
        return after, float(np.mean(shares)) if np.mean([one.significant for one in regressions]) > 0.5 else 0.0

    def looked(
        self, which: np.ndarray, new: Array, structure: Structure, theta: Array, has_offset: bool, rounding: Array
    ) -> tuple[Watch, News]:
        """Return it with samples of some actuators, at most `waits`, and of which the model is another plant's."""
        seen, usual, rows, scores = (a.copy() for a in self[:4])
        rows[which] = np.concatenate((rows[which], new), axis=1)[:, -SPAN:]
        seen[which] += new.shape[1]
        news: News = []
        for k, i in enumerate(which.tolist()):
            e, shown = rows[i, :, 0], rows[i, :, 1:]
            if seen[i] % _PERIOD or seen[i] < SPAN or _tells_nothing(e, float(rounding[k])):
                continue
            trouble, usual[i] = _trouble(e, shown, usual[i], has_offset)
            x = gain.driven(structure, theta[k], shown[:, 0], shown[:, 1:])
            scores[i] = *scores[i, 1:], gain.score(e, x, _PERIOD)
            g = gain.changed(scores[i])
            if trouble:
                news.append(Trouble(i, trouble))
            elif g:
                judged = int(np.count_nonzero(scores[i, :, 1])) * _PERIOD
                news.append(Trouble(i, _GAIN.format(1.0 + g, judged), gain=g))
                scores[i] = 0.0
        return Watch(seen, usual, rows, scores, *self[4:]), news

    def once(
        self, of: int, which: np.ndarray, text: str, category: type[UserWarning] = LostTrackerWarning
    ) -> tuple[Watch, News]:
        """Return it and what is to be said of some actuators, unless it has been said."""
        news = [Trouble(i, text, category) for i in np.flatnonzero(which & ~self.spoken[:, of]).tolist()]
        spoken = self.spoken.copy()
        spoken[:, of] |= which
        return self._replace(spoken=spoken), news

    def filled(self, new: Array, R: Array, has_offset: bool, rounding: Array) -> tuple[Watch, News]:
        """Return it with samples (n, N, 3), R (n,) after these, and what is wrong, once for each actuator."""
        if self.spoken[:, LOST].all():
            return self, []
        recent = np.concatenate((self.recent, new), axis=1)
        n, count = len(recent), recent.shape[1] // _WINDOW
        if not count:
            return self._replace(recent=recent), []
        windows, recent = recent[:, : count * _WINDOW].reshape(n, count, _WINDOW, 3), recent[:, count * _WINDOW :]
        seen, R = ~np.isnan(windows[..., 1]), np.maximum(R, rounding**2 / 12.0)
        judged = seen.sum(axis=2) >= _WINDOW // 2
        # Residuals of a plant that rests, or has no noise, are rounding.
        quiet = seen & (np.abs(np.nan_to_num(windows[..., 0])) <= rounding[:, None, None])
        judged &= quiet.sum(axis=2) < _NEARLY_ALL * seen.sum(axis=2)
        first = np.where(np.isnan(self.R) & judged.any(axis=1), R, self.R)
        news = _judged(windows, seen, judged & ~self.spoken[:, LOST, None], R, first, has_offset)
        spoken = self.spoken.copy()
        spoken[[one.actuator for one in news], LOST] = True
        return self._replace(recent=recent, R=first, spoken=spoken), news


_ANOTHER: Final = (
    "the plant is no longer the model's: over the last {} samples {:.0f} % of the residuals' variance follow the "
    "inputs (a gain, sign or pole has changed, or the sensor is stuck)"
)
_GAIN: Final = (
    "the plant is no longer the model's: its gain is {:.2g} times the model's in the mean of the last {} samples; "
    "theta goes on with that gain, and follows what the next samples say of it"
)
_OFF: Final = (
    "the level of y is no longer the model's: {} residuals in a row lie about {:.3g} off zero with a scatter of {:.2g} "
    "(the sensor drifts or is another one, or something acts that u does not tell)"
)


def _trouble(residuals: Array, signals: Array, usual: Array, has_offset: bool) -> tuple[str, Array]:
    """Return why the model is another plant's, nothing if what it leaves is usual or chance, and what is usual then."""
    if np.isnan(residuals).sum() > SPAN // 2:
        # A gap is neither unusual nor what is usual from now on.
        return "", usual
    covariances, anyway = usual[:3], usual[3]
    now = autocovariances(residuals)
    covariances = covariances if covariances[0] > 0.0 else now
    regression = dependence(residuals, signals, whitening=whitening_of(covariances))
    share = max(float(regression.share), 0.0)
    if regression.significant and share > SHARE + anyway:
        return _ANOTHER.format(SPAN, 100 * share), usual
    moved = _moved(residuals[~np.isnan(residuals)], covariances) if has_offset else ""
    if moved or (share > 0.5 * SHARE + anyway and usual[0]):
        return moved, usual
    # What is usual follows slowly, and not what is half suspicious already, nor by itself to where it would hide that.
    now = np.array([*now, share])
    before = np.array([*covariances, anyway])
    after = before + _PACE * (now - before)
    after[3] = after[3] if anyway > SHARE else min(after[3], max(anyway, 0.5 * SHARE))
    return "", after


def is_right(residuals: Array, signals: Array) -> bool:
    """Tell whether residuals follow the prediction and the inputs by no more than chance."""
    whitening = whitening_of(autocovariances(residuals))
    return float(dependence(residuals, signals, whitening=whitening).chance) > _BY_CHANCE


def _tells_nothing(residuals: Array, rounding: float) -> bool:
    """Tell whether residuals are missing or, but for outliers, no more than rounding."""
    sizes = np.abs(residuals[~np.isnan(residuals)])
    return not sizes.size or bool(np.quantile(sizes, _NEARLY_ALL) <= rounding)


@lru_cache(maxsize=8)
def _stretches(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where each stretch of enough samples begins and ends, and how many it has."""
    first, last = np.triu_indices(size, _IN_A_ROW)
    return first, last, last - first


def _moved(residuals: Array, covariances: Array) -> str:
    """Say which residuals in a row are off zero by more than chance, nothing if none are."""
    scale = mad_scale(residuals - np.median(residuals)) if residuals.size >= SPAN // 2 else 0.0
    if not scale > 0.0:
        return ""
    sums = np.append(0.0, np.cumsum(np.clip(residuals / scale, -CLIP, CLIP)))
    first, last, n = _stretches(sums.size)
    # Of noise that is still alike two samples later nobody knows how long it stays so.
    r0, r1, r2 = np.maximum(covariances, 0.0)
    variance = (r0 + 2.0 * r1 + 2.0 * r2) * n + 0.1 * r2 * n**2
    chance = np.abs(sums[last] - sums[first]) / np.sqrt(np.maximum(variance, np.finfo(float).tiny))
    k = int(chance.argmax())
    return _OFF.format(n[k], np.median(residuals[first[k] : last[k]]), scale) if chance[k] > _MOVED else ""


STUCK: Final = (
    "y repeats its last value to the last bit, more than three standard deviations from its prediction: the sensor is "
    "stuck, at its limit or in a dead band; it counts as missing for as long as it does"
)


def long_held(left_out: np.ndarray, before: Array) -> np.ndarray:
    """Return which sensors were stuck for more than a few samples in a row."""
    earlier = before[:, None] >= np.arange(_HELD - 1, 0, -1)
    row = np.concatenate((earlier, left_out), axis=1)
    n = row.shape[1] - _HELD + 1
    return np.logical_and.reduce([row[:, k : k + n] for k in range(_HELD)]).any(axis=1)


# What is wrong with a window, in the order in which it is looked for.
_WRONG: Final = (
    "the residuals lie {level:.3g} off zero with a scatter of {scatter:.2g}: use offset=True",
    f"of {_WINDOW} samples in a row the mean weight was {{weight:.2f}}: the filter takes ordinary samples for "
    "outliers, since R={R:.3g} is too small or theta has not followed the plant; leave R out, let theta move (Q, "
    "forgetting), or start anew",
    f"{{guarded:.0f}} % of {_WINDOW} steps would have made the model unstable: the structure does not fit, or P and Q "
    "allow steps that are too large",
    "R went from {first:.3g} to {R:.3g}: theta does not follow the plant, or the sensor has changed",
)


def _judged(windows: Array, seen: np.ndarray, judged: np.ndarray, R: Array, first: Array, has_offset: bool) -> News:
    """Say what is wrong with the first window (n, k, ..) of each actuator that has something, of those to be judged."""
    residuals, weights, guard = np.moveaxis(windows, -1, 0)
    level, scatter = level_and_scale(residuals, seen)
    weight = np.where(seen, weights, 0.0).sum(axis=2) / np.maximum(seen.sum(axis=2), 1)
    unstable = (np.nan_to_num(guard) != 0).mean(axis=2)
    off = (not has_offset) & (np.abs(level) > _OFFSET * scatter)
    with np.errstate(invalid="ignore"):
        wanders = ~((R / first > 1.0 / _WANDERING) & (R / first < _WANDERING))
    faults = (off, weight < _LEAST_WEIGHT, unstable > _MOST_GUARDED, np.broadcast_to(wanders[:, None], off.shape))
    wrong = judged & np.stack(faults)
    news: News = []
    for i in np.flatnonzero(wrong.any(axis=(0, 2))).tolist():
        k = int(wrong[:, i].any(axis=0).argmax())
        text = _WRONG[wrong[:, i, k].argmax()].format(
            level=level[i, k], scatter=scatter[i, k], weight=weight[i, k], guarded=100 * unstable[i, k], R=R[i],
            first=first[i],
        )  # fmt: skip
        news.append(Trouble(i, text))
    return news
