"""Whether n actuators have lost their plants, judged by what their samples have in common."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, Final, NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy._warning import STOPPED, RobustFilterWarning, pointer
from robust_filterpy.identification.models import dependence as gain
from robust_filterpy.identification.models.dependence import autocovariances, dependence, level_and_scale, whitening_of
from robust_filterpy.identification.models.structures import Structure

__all__ = ["LOST", "OF_START", "OF_STUCK", "USUAL", "LostTrackerWarning", "News", "Trouble", "Watch", "long_held"]

# A filter that has clipped half of what it saw believes in another model than the data.
_LEAST_WEIGHT: Final = 0.5
# More steps than this share that leave the stable models come from a wrong structure or step.
_MOST_GUARDED: Final = 0.25
# A level next to which the scatter of the residuals is small is an offset.
_OFFSET: Final = 2.0
# So many samples are judged together. So many are held against the inputs at a time, each once: a plant that changes is
# in all of them after twice as many.
WINDOW: Final = 200
SPAN: Final = 120
_MOST_TOGETHER: Final = 50 * SPAN
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
    #: What is to be added to the model's gain, in shares of it, where that mends it; or whether only a start does.
    gain: float = 0.0
    restarts: bool = False

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
    #: Of the gain in the last blocks of gain.BLOCK samples, (n, gain.BLOCKS, 2).
    scores: Array
    #: Residuals, predictions and inputs of the last samples, and their weights and guards, (n, WINDOW, 3 + n_signals).
    rows: Array
    #: R when it was first judged, NaN before, (n,).
    R: Array
    #: What has been said, (n, 3).
    spoken: np.ndarray

    @classmethod
    def none(cls, n: int, n_signals: int) -> Watch:
        """Return it before the first sample."""
        rows, scores = np.full((n, WINDOW, 3 + n_signals), np.nan), np.zeros((n, gain.BLOCKS, 2))
        seen, spoken = np.zeros(n, dtype=int), np.zeros((n, 3), dtype=bool)
        return cls(seen, np.zeros((n, USUAL)), scores, rows, np.full(n, np.nan), spoken)

    def restored(self, stored: Mapping[str, Array]) -> Watch:
        """Return it with what a state has of it; what was said stays said."""
        last = stored["followed"][:, -SPAN:]
        after = Watch.none(len(last), last.shape[2] - 1)
        # How much was believed of them, no state says.
        after.rows[:, WINDOW - last.shape[1] :, :-2] = last
        seen, usual, scores = stored["seen"].astype(int), stored["usual"], stored["scores"]
        return after._replace(seen=seen, usual=usual, scores=scores, spoken=self.spoken)

    def waits(self, which: np.ndarray) -> int:
        """Return after how many samples one of some actuators is to be looked at; without any, memory is a limit."""
        return int((SPAN - self.seen[which] % SPAN).min()) if which.size else _MOST_TOGETHER

    def forgotten(self, i: int, whole: bool = True) -> Watch:
        """Return it with nothing seen of an actuator, for another model; or but for how R was."""
        watch = Watch(*(a.copy() for a in self))
        watch.seen[i], watch.usual[i], watch.scores[i], watch.rows[i] = 0, 0.0, 0.0, np.nan
        if whole:
            watch.R[i], watch.spoken[i, LOST] = np.nan, False
        return watch

    def begun(self, i: int, residuals: Array, signals: Array, rounding: float) -> tuple[Watch, float]:
        """Return it with what is usual of an actuator: what its model leaves of its own recording."""
        windows = [slice(k - SPAN, k) for k in range(len(residuals), SPAN - 1, -SPAN)]
        after = self.forgotten(i, False)
        if not windows or _tells_nothing(residuals, rounding):
            return after, 0.0
        covariances = np.mean([autocovariances(residuals[window]) for window in windows], axis=0)
        regressions = [dependence(residuals[w], signals[w], whitening=whitening_of(covariances)) for w in windows]
        shares = [max(float(one.share), 0.0) for one in regressions]
        after.usual[i] = *covariances, max(shares)
        return after, float(np.mean(shares)) if np.mean([one.significant for one in regressions]) > 0.5 else 0.0

    def looked(
        self, which: np.ndarray, restarts: np.ndarray, new: Array, structure: Structure, theta: Array, scale: Array,
        has_offset: bool,
    ) -> tuple[Watch, News]:  # fmt: skip
        """Return it with samples of some actuators, at most `waits` of those that restart, and what is wrong."""
        watch, length = Watch(*(a.copy() for a in self)), new.shape[1]
        whole, seen = np.concatenate((self.rows[which], new), axis=1), self.seen[which, None]
        watch.rows[which], watch.seen[which] = whole[:, length:], seen[:, 0] + length
        full = np.flatnonzero(seen[:, 0] % SPAN + length >= SPAN)
        which, seen = which[full], seen[full]
        ends = SPAN - seen % SPAN + SPAN * np.arange(-(-length // SPAN))
        windows = whole[full[:, None, None], np.minimum(ends, length)[:, :, None] + np.arange(WINDOW)]
        due = (ends <= length) & ~_tells_nothing(windows[..., -SPAN:, 0], scale[which, None, 4])
        news = watch._lost(which, windows, due & (seen + ends >= WINDOW), scale[which], has_offset)
        for i in which[due[:, 0] & restarts[which]].tolist():
            e, shown = watch.rows[i, -SPAN:, 0], watch.rows[i, -SPAN:, 1:-2]
            trouble, watch.usual[i] = _trouble(e, shown, watch.usual[i], has_offset)
            x = gain.driven(structure, theta[i], shown[:, 0], shown[:, 1:])
            watch.scores[i] = gain.scored(watch.scores[i], e, x)
            g = gain.changed(watch.scores[i])
            if trouble:
                news.append(Trouble(i, f"{trouble}; {_ANEW}", restarts=True))
            elif g:
                judged = int(np.count_nonzero(watch.scores[i, :, 1])) * gain.BLOCK
                news.append(Trouble(i, _GAIN.format(1.0 + g, judged), gain=g))
                watch.scores[i] = 0.0
        return watch, news

    def once(
        self, of: int, which: np.ndarray, text: str, category: type[UserWarning] = LostTrackerWarning
    ) -> tuple[Watch, News]:
        """Return it and what is to be said of some actuators, unless it has been said."""
        news = [Trouble(i, text, category) for i in np.flatnonzero(which & ~self.spoken[:, of]).tolist()]
        spoken = self.spoken.copy()
        spoken[:, of] |= which
        return self._replace(spoken=spoken), news

    def _lost(self, which: np.ndarray, windows: Array, due: np.ndarray, scale: Array, has_offset: bool) -> News:
        """Say of each of some actuators once what is wrong with a window (w, k, WINDOW, ..) of it, and note so."""
        seen, R = ~np.isnan(windows[..., -2]), np.maximum(scale[:, 0], scale[:, 4] ** 2 / 12.0)
        due = due & (seen.sum(axis=2) >= WINDOW // 2) & ~self.spoken[which, LOST, None]
        first = self.R[which] = np.where(np.isnan(self.R[which]) & due.any(axis=1), R, self.R[which])
        level, scatter = level_and_scale(windows[..., 0], seen)
        weight = np.where(seen, windows[..., -2], 0.0).sum(axis=2) / np.maximum(seen.sum(axis=2), 1)
        unstable = (np.nan_to_num(windows[..., -1]) != 0).mean(axis=2)
        off = (not has_offset) & (np.abs(level) > _OFFSET * scatter)
        with np.errstate(invalid="ignore"):
            wanders = ~((R / first > 1.0 / _WANDERING) & (R / first < _WANDERING))
        faults = (off, weight < _LEAST_WEIGHT, unstable > _MOST_GUARDED, np.broadcast_to(wanders[:, None], off.shape))
        wrong = due & np.stack(faults)
        news: News = []
        for j in np.flatnonzero(wrong.any(axis=(0, 2))).tolist():
            k = int(wrong[:, j].any(axis=0).argmax())
            numbers = (one[j, k] for one in (level, scatter, weight, 100 * unstable))
            text = _WRONG[wrong[:, j, k].argmax()].format(*numbers, R=R[j], first=first[j])
            news.append(Trouble(int(which[j]), text))
            self.spoken[which[j], LOST] = True
        return news


_ANEW: Final = "it starts anew, and theta may jump when a model of the next samples is found"
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
    if regression.significant and share > gain.SHARE + anyway:
        return _ANOTHER.format(SPAN, 100 * share), usual
    moved = _moved(residuals[~np.isnan(residuals)], covariances) if has_offset else ""
    if moved or (share > 0.5 * gain.SHARE + anyway and usual[0]):
        return moved, usual
    # What is usual follows slowly, and not what is half suspicious already, nor by itself to where it would hide that.
    now = np.array([*now, share])
    before = np.array([*covariances, anyway])
    after = before + _PACE * (now - before)
    after[3] = after[3] if anyway > gain.SHARE else min(after[3], max(anyway, 0.5 * gain.SHARE))
    return "", after


def is_right(residuals: Array, signals: Array) -> bool:
    """Tell whether residuals follow the prediction and the inputs by no more than chance."""
    whitening = whitening_of(autocovariances(residuals))
    return float(dependence(residuals, signals, whitening=whitening).chance) > _BY_CHANCE


def _tells_nothing(residuals: Array, rounding: Any) -> Any:
    """Tell where residuals, along the last axis, are missing or, but for outliers, no more than rounding."""
    quiet = (np.abs(residuals) <= np.asarray(rounding)[..., None]).sum(axis=-1)
    return quiet >= _NEARLY_ALL * (~np.isnan(residuals)).sum(axis=-1)


@lru_cache(maxsize=8)
def _stretches(size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return where each stretch of enough samples begins and ends, and how many it has."""
    first, last = np.triu_indices(size, _IN_A_ROW)
    return first, last, last - first


def _moved(residuals: Array, covariances: Array) -> str:
    """Say which residuals in a row are off zero by more than chance, nothing if none are."""
    scale = float(level_and_scale(residuals, np.full(residuals.size, residuals.size >= SPAN // 2))[1])
    if not scale > 0.0:
        return ""
    sums = np.append(0.0, np.cumsum(np.clip(residuals / scale, -gain.CLIP, gain.CLIP)))
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
    "the residuals lie {0:.3g} off zero with a scatter of {1:.2g}: use offset=True",
    f"of {WINDOW} samples in a row the mean weight was {{2:.2f}}: the filter takes ordinary samples for "
    "outliers, since R={R:.3g} is too small or theta has not followed the plant; leave R out, let theta move (Q, "
    "forgetting), or start anew",
    f"{{3:.0f}} % of {WINDOW} steps would have made the model unstable: the structure does not fit, or P and Q "
    "allow steps that are too large",
    "R went from {first:.3g} to {R:.3g}: theta does not follow the plant, or the sensor has changed",
)
