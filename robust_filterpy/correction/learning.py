"""What is learned of a sensor's noise: how large it is, how often, how far and for how long it is exceeded.

A sample of noise belongs to one of K classes; in class k its variance is ``r s_k R``. R is what the filter was given;
the scales s_0 = 1 < s_1 < ... are fixed, by default a decade apart; the factor r and the probabilities of the classes
are learned. The class is a Markov chain, since outliers come in runs: its transitions are learned as mean counts with
a forgetting memory and a weak prior, and r from the expected squares of the samples of class 0, the ordinary ones. When
these are no longer the majority, the class in which the median falls becomes the ordinary one: the way out of a wrong
R.

Sensors that see the same disagree about their noise alone (`parity`): that tells noise with a color from the motion
of the state, which a filter that follows one such sensor takes it for. Such noise is then weighed as the white noise
that would leave the state as uncertain.

Whether sensors fail together is learned from how likely each sample is if all of them are in one class, and if each is
in one of its own.

The changes from reading to reading that a filter has not foreseen differ from each other, where noise is white, with a
variance of 6 r and more. So r is never above eight times what they show, unless other sensors show more: a filter that
has lost the state, or whose model is too simple, has large innovations and even changes, and does not learn that its
sensor is bad; a sensor that is off by the same amount all the time has, too.

A sensor that repeats its last reading though it seldom does and its noise is white
(`robust_filterpy.correction.repeats`), far from the prediction, is stuck, and tells nothing of the state (`repeated`).
Where repeats are usual, no reading that repeats the one before tells of r, which would fall to nothing.

How often a reading has begun a jump that was believed, and how far the last one went, is learned too (`jumped`): a far
reading that is as far is believed at once where that is more likely than an outlier (`began`). Readings that were
refused until the state followed them were no outliers, whatever explains that it did: a jump, or a larger Q.

All that is learned of a sensor is one row of numbers, ``[r, n, shares (K), last (K), counts (K, K), together, less,
jumps (4), parity (4), change (4), reading (2)]``: r stands on n ordinary samples; the shares of the classes of late;
the probabilities of the last sample's class; how often class i was followed by class j; the probability that it fails
with the others; how much likelier a tenth of r is; four numbers of jumps; the last parity, its lag-one covariance, its
variance, how many there were; what the last correction left of the reading, the last change and the scale of their
differences, in standard deviations that R gives, and how many readings there were; the last reading in the same unit,
and one over the share of readings that repeat, with a minus sign if the last reading repeated the one before.
`robust_filterpy.correction.learnt` corrects a state between `predicted` and `learn`.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array
from robust_filterpy.correction import repeats, spread
from robust_filterpy.correction.options import Grouping, checked_grouping

__all__ = [
    "SCALES", "LearntNoise", "NoiseClasses", "describe", "learn", "ordinary_size", "predicted", "start", "usual",
]  # fmt: skip

#: Factors of the variance: a standard deviation of 1, 3.2, 10 and 32 times the ordinary one.
SCALES = (1.0, 10.0, 100.0, 1e3)
# The prior: ten samples of a chain with 15 % outliers whose class stays with probability 3/4, else is drawn anew.
# On 20 kinds of noise a half or the double of each changes most errors by 1 %.
_PRIOR_OUTLIERS, _PRIOR_STAY = 0.15, 0.75
# Samples that R as given is worth, and from which on parity and changes tell something.
_FIRST = 20.0
#: What one sample is worth as evidence at most, a hundred to one, and what decides, a thousand to one.
LOG_EVIDENCE, LOG_DECIDES = math.log(100.0), math.log(1e3)
# Noise of a tenth of the variance is taken over where it has been likelier by that.
_LESS_SCALE = 0.1
# Chance that sensors fail together.
_PRIOR_TOGETHER = 0.01
# Noise that never changes is an offset, of which no reading rids a filter.
_MOST_COLOUR = 0.99
# The most that r may be over the variance of the differences of changes, of which white noise makes 6 r.
_MOST = 8.0 / 6.0
# Standard deviations beyond which a reading is as far as any other.
_WILDEST = 1e6
#: Numbers of a row: r, and on how many samples it stands.
R_FACTOR, SAMPLES = 0, 1
# Those that tell of failing together, of parity, of changes and readings.
_TOGETHER, _LESS, _JUMPS, _PARITY, _TAIL = -16, -15, slice(-14, -10), slice(-10, -6), 16 + spread.NUMBERS
_PARITY_VARIANCE, _PARITY_COUNT, _LEFT, _SCALE, _COUNT, _REPEATS = -8, -7, -6, -4, -3, -1
_READINGS = slice(-repeats.WIDTH, None)
#: Numbers of a row that tell of typical innovations.
GIVEN = slice(-_TAIL, _TOGETHER)
# Of jumps: the chance that a reading begins one, the last one, what a candidate began with, and how many outliers there
# were since.
_CHANCE, _SIZE, _BEGAN, _OUTLIERS = range(4)
# Of a sensor with more outliers than that a run of them may be no jump.
_RARE = 0.2
# A sensor is redundant if the others leave at least this part of its variance unexplained by the state.
_REDUNDANT = 1e-6
# Its noise is a fifth of its parity or more, and the correlation of that a fifth or more, where its color counts fully.
_OWN = 5.0


@dataclass(frozen=True)
class NoiseClasses:
    """Say which classes of measurement noise there are, and how long what is learned about them is remembered.

    Parameters
    ----------
    scales : sequence of float, default (1, 10, 100, 1000)
        Factors of the covariance R, ascending from 1.
    grouping : {"component", "joint"} or tuple of tuple of int
        "component" learns whether sensors fail together or each on its own, "joint" says together, with one r; a tuple
        says which fail together, each with an r of its own, and that the others do not.
    memory : float, default 300
        Samples for which transitions between the classes are remembered, > 1.
    r_memory : float, default 50
        Ordinary samples for which the size of the noise is remembered, > 1.
    probabilities : sequence of float, optional
        Probabilities of the classes where they are given: nothing is learned then, and r is 1.

    Raises
    ------
    ValueError, TypeError
        If one is out of range.
    """

    scales: Sequence[float] = SCALES
    grouping: Grouping = "component"
    memory: float = 300.0
    r_memory: float = 50.0
    probabilities: Sequence[float] | None = None

    def __post_init__(self) -> None:
        """Check the parameters."""
        scales = _checks.numbers("measurement_scales", self.scales)
        if scales.ndim != 1 or not scales.size or scales[0] != 1.0 or not (np.diff(scales) > 0.0).all():
            raise ValueError(f"measurement_scales: expected factors that ascend from 1, got {self.scales!r}")
        if not np.isfinite(scales).all():
            raise ValueError(f"measurement_scales: expected finite numbers, got {self.scales!r}")
        object.__setattr__(self, "scales", tuple(scales.tolist()))
        object.__setattr__(self, "grouping", checked_grouping(self.grouping))
        for name in ("memory", "r_memory"):
            if not _checks.positive(name, getattr(self, name)) > 1.0:
                raise ValueError(f"{name}: expected a number of samples > 1, got {getattr(self, name)!r}")
            object.__setattr__(self, name, float(getattr(self, name)))
        if self.probabilities is not None:
            shares = _checks.probabilities("probabilities", self.probabilities, scales.size)
            object.__setattr__(self, "probabilities", tuple(shares.tolist()))

    @property
    def learns(self) -> bool:
        """Whether r and the probabilities of the classes are learnt."""
        return self.probabilities is None

    def start(self, dim_z: int) -> Array:
        """Return the memory before the first sample, a row for each sensor, or one for all."""
        return np.tile(start(len(self.scales), self.probabilities), (1 if self.grouping == "joint" else dim_z, 1))

    def checked(self, learnt: ArrayLike, dim_z: int) -> Array:
        """Return a copy of what another filter has learnt, if it is for the same classes."""
        values, begin = _checks.numbers("learnt", learnt), self.start(dim_z)
        fits = values.ndim == 2 and values.shape[1] == begin.shape[1]
        if not fits or len(values) < len(begin) or (self.grouping == "joint" and len(values) > 1):
            raise ValueError(
                f"learnt: expected shape {begin.shape}, got {values.shape}; it is for filters with the same grouping, "
                f"sensors and measurement_scales"
            )
        K = len(self.scales)
        numbers, totals = values[:, :-_TAIL], values[:, _counts(K)].reshape(-1, K, K).sum(axis=2)
        right = (numbers >= 0.0).all() and (numbers[:, R_FACTOR] > 0.0).all() and totals.all()
        if not (np.isfinite(values).all() and right):
            raise ValueError("learnt: expected finite numbers >= 0 with r > 0, as another filter's `learnt` has them")
        if not ((values[:, _TOGETHER] >= 0.0) & (values[:, _TOGETHER] < 1.0)).all():
            raise ValueError("learnt: expected a probability below 1 that sensors fail together, as another filter has")
        if not (values[:, [_PARITY_VARIANCE, _PARITY_COUNT, _SCALE, _COUNT]] >= 0.0).all():
            raise ValueError(
                "learnt: expected variances and numbers of parities and changes >= 0, as another filter has"
            )
        if not np.allclose(values[:, last_class(K)].sum(axis=1), 1.0):
            raise ValueError("learnt: expected probabilities of the last sample's class that sum to 1")
        return values.copy()


def start(classes: int, probabilities: Sequence[float] | None = None) -> Array:
    """Return the memory of a sensor before the first sample."""
    return _start(classes, None if probabilities is None else tuple(probabilities)).copy()


@lru_cache(maxsize=64)
def _start(K: int, probabilities: tuple[float, ...] | None) -> Array:
    """Return what `start` hands out copies of."""
    share, stay = np.full(K, _PRIOR_OUTLIERS / max(K - 1, 1)), _PRIOR_STAY
    share[0] = 1.0 - _PRIOR_OUTLIERS if K > 1 else 1.0
    if probabilities is not None:
        share, stay = np.array(probabilities), 0.0
    moves = stay * np.eye(K) + (1.0 - stay) * share
    tail = np.zeros(_TAIL)
    tail[_TOGETHER] = _PRIOR_TOGETHER
    return np.concatenate([[1.0, _FIRST], share, share, (spread.FEW * share[:, None] * moves).ravel(), tail])


def predicted(memory: Array, classes: int) -> Array:
    """Return the probabilities of the classes of the next sample: the chain's prediction."""
    last, counts = _chain(memory, classes)
    return np.asarray(last @ (counts / counts.sum(axis=1, keepdims=True)))


def usual(memory: Array, classes: int) -> Array:
    """Return the probabilities of the classes of the next sample, whatever the last one was; of one or many."""
    counts = memory[..., _counts(classes)].reshape(*memory.shape[:-1], classes, classes)
    return np.asarray(counts.sum(axis=-2) / counts.sum(axis=(-2, -1))[..., None])


def learn(memory: Array, posterior: Array, r: float, excess: float, part: float, noise: NoiseClasses) -> Array:
    """Return the memory after one sample."""
    # Expectation-maximization online, with statistics that are forgotten exponentially: E[class i before, class j now]
    # = q_i A_ij p_j / sum_l q_l A_lj, with q the last sample's probabilities and A the counts over their sum. An
    # innovation of which noise is a part k tells k^2 as much of r as noise itself would (the Fisher information), and
    # counts as that.
    K, after, begin = len(posterior), memory.copy(), start(len(posterior))
    ordinary = float(posterior[0])
    # A reading that repeats the one before, as its sensor does, tells of the noise only that it is less than a step,
    # and it is no independent sample of white noise.
    if not np.signbit(memory[_REPEATS]):
        # One sample is never forgotten, else r would reel where it can hardly be seen.
        after[SAMPLES] = 1.0 + (1.0 - 1.0 / noise.r_memory) * (memory[SAMPLES] - 1.0) + ordinary * part * part
        after[R_FACTOR] += ordinary * (r * (1.0 + part * excess) - memory[R_FACTOR]) / after[SAMPLES]
        after[R_FACTOR] = min(max(after[R_FACTOR], 1e-8), 1e8)
        after[_LESS] = max(memory[_LESS] + ordinary * _for_less(part, excess), 0.0)
    if after[_LESS] > LOG_DECIDES:
        after[R_FACTOR], after[SAMPLES] = max(_LESS_SCALE * after[R_FACTOR], 1e-8), _FIRST
        after[_LESS] = 0.0
    after[_shares(K)] += 1.0 / noise.r_memory * (posterior - memory[_shares(K)])
    last, counts = _chain(memory, K)
    after[_JUMPS][_OUTLIERS] += 1.0 - ordinary
    after[_JUMPS][_CHANCE] *= 1.0 - 1.0 / min(max(memory[_COUNT], 1.0), noise.memory)
    joint = (last / counts.sum(axis=1))[:, None] * counts
    expected = joint.sum(axis=0)
    joint *= np.divide(posterior, expected, out=np.zeros(K), where=expected > 0.0)
    prior = _chain(begin, K)[1]
    after[last_class(K)] = posterior
    after[_counts(K)] = (prior + (1.0 - 1.0 / noise.memory) * (counts - prior) + joint).ravel()
    # Ordinary is what most samples are. (At .4 an R that is 30 times too small can stay so for 1000 samples.)
    shares = after[_shares(K)]
    if K > 1 and shares[0] < 0.5:
        median = int(np.argmax(np.append(np.cumsum(shares[:-1]), 1.0) >= 0.5))
        begin[R_FACTOR], begin[-_TAIL:] = after[R_FACTOR] * noise.scales[median], after[-_TAIL:]
        return begin
    return after


def _for_less(part: float, excess: float) -> float:
    """Return how much likelier an innovation is, in logarithms, if noise has a tenth of the variance."""
    less = (1.0 - _LESS_SCALE) * part
    return -0.5 * (math.log1p(-less) + (1.0 + excess) * less / (1.0 - less))


def _shares(K: int) -> slice:
    """Return where a row has the shares of the classes of late."""
    return slice(2, 2 + K)


def last_class(K: int) -> slice:
    """Return where a row has the probabilities of the last sample's class."""
    return slice(2 + K, 2 + 2 * K)


def _counts(K: int) -> slice:
    """Return where a row has how often each class followed each."""
    return slice(2 + 2 * K, -_TAIL)


def _chain(memory: Array, K: int) -> tuple[Array, Array]:
    """Return the probabilities of the last sample's class and the counts, shapes (K,) and (K, K)."""
    return memory[last_class(K)], memory[_counts(K)].reshape(K, K)


def is_established(memory: Array) -> bool:
    """Return whether a sensor has been read so often that its changes tell something."""
    return bool(memory[_COUNT] > _FIRST)


def is_seasoned(memory: Array, noise: NoiseClasses) -> np.ndarray:
    """Return which sensors have been read as often as r remembers, shape (g,)."""
    return np.asarray(memory[:, _counts(len(noise.scales))].sum(axis=1) > spread.FEW + noise.r_memory)


def jump_chances(
    learnt: Array, y: Array, seen: Array, ordinary: Array, R: Array, scales: Sequence[float], wide: Array
) -> Array:
    """Return how likely innovations begin a jump like their sensors' last one, rather than an outlier, shape (m,)."""
    # seen, ordinary and R are the variances of predictions, of ordinary noise and what R says.
    chances = np.zeros(len(y))
    for i, row in enumerate(learnt):
        like = _like_before(row[_JUMPS], float(y[i]), float(seen[i] + ordinary[i]), float(R[i]))
        beyond, expected = np.array(scales) - 1.0, predicted(row, len(scales))
        beyond[-1], expected[-1] = beyond[-1] * wide[i] ** 2, expected[-1] / wide[i]
        outlier = float(expected @ _normal(float(y[i]), seen[i] + (1.0 + beyond) * ordinary[i]))
        chances[i] = like / (like + outlier) if like > 0.0 else 0.0
    return chances


def _like_before(own: Array, y: float, variance: float, R: float) -> float:
    """Return odds times density of a jump like the last one, that without its factor (2 pi)^(-1/2)."""
    return float(own[_CHANCE] / (1.0 - own[_CHANCE]) * _normal(y, variance + own[_SIZE] ** 2 * R))


def _normal(y: float, variance: Any) -> Any:
    """Return normal densities without their factor (2 pi)^(-1/2)."""
    with np.errstate(over="ignore"):
        return np.exp(-0.5 * y / variance * y) / np.sqrt(variance)


def goes_on(learnt: Array, y: Array, R: Array, classes: int) -> np.ndarray:
    """Return which readings are about as far off as the last one, which was taken for an outlier, shape (m,)."""
    # About: within half of the innovation.
    left = learnt[:, _LEFT] * np.sqrt(R.diagonal())
    return (learnt[:, last_class(classes).start] < 0.5) & (2.0 * np.abs(y - left) < np.abs(y))


def jumped(learnt: Array, believed: np.ndarray, noise: NoiseClasses, followed: Any = False) -> Array:
    """Return the memory once candidates of the parts that sensors see are believed, or the state has followed them."""
    # What was refused on the way was no outlier.
    learnt, K = learnt.copy(), len(noise.scales)
    prior = _chain(start(K), K)[1]
    for i in np.flatnonzero(believed | followed):
        own, counts, readings = learnt[i, _JUMPS], _chain(learnt[i], K)[1], float(learnt[i, _COUNT])
        began = float(own[_BEGAN])
        own[_BEGAN] = 0.0 if believed[i] else began
        if began == 0.0 or not readings > _FIRST or counts[:, 1:].sum() > _RARE * counts.sum():
            continue
        if believed[i]:
            # The mean of what the chance may be, of which nothing was learned: (jumps + 1) / readings.
            each = 1.0 / min(readings, noise.memory)
            own[_CHANCE], own[_SIZE] = max(own[_CHANCE], each) + each, began
        # The run was in the classes that are likely for what it began with.
        sizes = np.array(noise.scales) * learnt[i, R_FACTOR]
        likely = counts.sum(axis=0) * np.exp(-0.5 * began**2 * (1.0 / sizes - 1.0 / sizes[-1])) / np.sqrt(sizes)
        excess = np.maximum(counts - prior, 0.0)[:, 1:]
        back = own[_OUTLIERS] * likely[1:] / likely[1:].sum()
        less = excess * np.minimum(back / np.maximum(excess.sum(axis=0), 1e-300), 1.0)
        counts[:, 1:] -= less
        counts[0, 0] += less.sum()
        own[_OUTLIERS] = 0.0
    return learnt


def began(learnt: Array, parts: Array, y: Array, variances: Array, alone: np.ndarray, R: Array) -> tuple[Array, Array]:
    """Return the memory once candidates have begun, and odds times density of a jump like the sensor's last one."""
    # Without its factor (2 pi)^(-1/2); 0 for a reading that repeats the one before, or that another sensor contradicts.
    learnt, odds = learnt.copy(), np.zeros(len(y))
    for i in np.flatnonzero(y):
        learnt[parts == parts[i], _JUMPS.start + _BEGAN] = 0.0
        own = learnt[i, _JUMPS]
        if not R[i] > 0.0:
            continue
        own[_BEGAN], own[_OUTLIERS] = _bounded(y[i] / R[i] ** 0.5), 0.0
        if alone[i] and not np.signbit(learnt[i, _REPEATS]):
            odds[i] = _like_before(own, float(y[i]), float(variances[i]), float(R[i]))
    return learnt, odds


def together(learnt: Array) -> float:
    """Return the probability that sensors fail together."""
    return float(np.mean(learnt[:, _TOGETHER]))


def weigh_together(learnt: Array, log_together: float, log_apart: float, noise: NoiseClasses) -> Array:
    """Return the memory once a sample has been weighed under both: one class for all sensors, or one for each."""
    after, before = learnt.copy(), together(learnt)
    before += (_PRIOR_TOGETHER - before) / noise.memory
    evidence = min(max(log_together - log_apart, -LOG_EVIDENCE), LOG_EVIDENCE)
    odds = before / (1.0 - before) * math.exp(evidence)
    after[:, _TOGETHER] = odds / (1.0 + odds)
    return after


def ordinary_size(
    learnt: Array,
    readings: Array,
    z: Array,
    y: Array,
    seen: Array,
    H: Array,
    R: Array,
    memory: float = 300.0,
) -> tuple[Array, Array]:
    """Return r of each sensor, between what its parity and its changes allow, and the memory with this sample's."""
    # A sensor that a filter follows has no innovations left: r falls until the state is that sensor, its noise
    # included. Only other sensors can tell. Where parity has a color, r is at least parity's variance over what R says
    # it is, as far as there are independent samples of it, but never raised above 1, so that an offset between two
    # sensors leaves the R that was given.
    # Noise with a lag-one correlation c does not average out: a filter that keeps a part q of what it knew from reading
    # to reading is left with (1 + c q) / (1 - c q) times the variance that white noise leaves. It is given that r.
    r, learnt, coloured = learnt[:, R_FACTOR].copy(), learnt.copy(), []
    readings = _in_deviations(readings, R)
    for own in np.flatnonzero(R.diagonal() > 0.0):
        most = _note(learnt[own, _READINGS], float(readings[own]), _bounded(y[own] / R[own, own] ** 0.5))
        # What others contradict by more than its noise is no motion of the state, however even its changes.
        apart = float(learnt[own, _PARITY_VARIANCE])
        most = max(most, apart * apart)
        r[own], learnt[own, R_FACTOR] = min(r[own], most), min(learnt[own, R_FACTOR], most)
    # Whom the others can stand in for is not one that is followed.
    for i, e, part in parity(z, H, R, np.maximum(r, 1.0)):
        correlation, least = _note_parity(learnt[i, _PARITY], e, memory)
        # A color is that of the sensor of whose noise a parity is made.
        colour = min(max(_OWN * correlation, 0.0), 1.0) * min(_OWN * part, 1.0)
        if colour > 0.0:
            r[i] = max(r[i], r[i] ** (1.0 - colour) * least**colour)
            coloured.append((i, colour, correlation))
    if coloured:
        left = _kept(seen, r * R.diagonal())
        for i, colour, correlation in coloured:
            r[i] *= ((1.0 + correlation * left[i]) / (1.0 - correlation * left[i])) ** colour
    return r, learnt


def _note_parity(row: Array, e: float, memory: float) -> tuple[float, float]:
    """Note a parity, in place; return its lag-one correlation, 0 of too few, and the least r for that."""
    last, lag, variance, count = row.tolist()
    count += 1.0
    share = max(1.0 / memory, 1.0 / count)
    if count > 6.0:
        # An outlier is no news about the color.
        e = min(max(e, -3.0 * variance**0.5), 3.0 * variance**0.5)
    e = min(max(e, -1e100), 1e100)
    lag, variance = lag + share * (e * last - lag), variance + share * (e * e - variance)
    row[:] = e, lag, variance, count
    if not (count >= _FIRST and variance > 0.0):
        return 0.0, 1.0
    correlation = min(lag / variance, _MOST_COLOUR)
    # Samples that depend on each other are worth fewer, against the nominal R, which is worth some too.
    worth = min(count, memory) * (1.0 - correlation**2) / (1.0 + correlation**2)
    return correlation, min(max(variance, 1e-8), 1.0) ** (worth / (worth + _FIRST))


def _kept(seen: Array, noise: Array) -> Array:
    """Return what a reading of all sensors leaves of the variance that each sees of the state, as a part of it."""
    left = seen
    for j, variance in enumerate(noise):
        if left[j, j] + variance > 0.0:
            left = left - np.outer(left[j], left[j]) / (left[j, j] + variance)
    own = seen.diagonal()
    return np.clip(np.where(own > 0.0, left.diagonal() / np.where(own > 0.0, own, 1.0), 1.0), 0.0, 1.0)


def _note(row: Array, z: float, y: float) -> float:
    """Note a reading and its innovation, in place; return the most that r may be."""
    repeats.note_reading(row, z)
    repeats.note_change(row, y)
    _, _, scale, count = row[:4].tolist()
    return max(1.0, scale**2 * _MOST) if count > _FIRST + 1.0 else math.inf


def repeated(learnt: Array, z: Array, R: Array) -> Array:
    """Return which sensors repeat their last reading to the last bit, though they seldom do, with white noise."""
    return repeats.again(learnt[:, _READINGS], _in_deviations(z, R), learnt[:, R_FACTOR])


def _in_deviations(z: Array, R: Array) -> Array:
    """Return readings in the standard deviations that R gives, finite however small R is."""
    own = R.diagonal()
    with np.errstate(over="ignore"):
        readings = z / np.sqrt(np.where(own > 0.0, own, 1.0))
    return np.clip(readings, -sys.float_info.max, sys.float_info.max)


def _bounded(number: float) -> float:
    return min(max(number, -_WILDEST), _WILDEST)


def left_over(learnt: Array, rest: Array, R: Array) -> Array:
    """Return the memory, with what a correction left of each reading, z - H x."""
    learnt = learnt.copy()
    for i in np.flatnonzero(R.diagonal() > 0.0):
        learnt[i, _LEFT] = _bounded(rest[i] / R[i, i] ** 0.5)
    return learnt


def parity(z: Array, H: Array, R: Array, r: Array) -> list[tuple[int, float, float]]:
    """Return for each sensor that others can stand in for by how much it differs from what they say."""
    # In units of the standard deviation that R gives to it, and the share of it that is the sensor's own noise, as
    # (sensor, e, share). It does not depend on the state: with V = diag(r R) and G = V^-1 - V^-1 H (H' V^-1 H)^+ H'
    # V^-1, e_i = (G z)_i / sqrt((G R G)_ii).
    variances = r * R.diagonal()
    if len(z) < 2 or not (variances > 0.0).all():
        return []
    unit = np.sqrt(variances)
    rest = np.eye(len(z))
    # What is left of the space of measurements when the state's part is taken out, direction by direction.
    for column in (H / unit[:, None]).T:
        left = rest @ column
        length = float(np.linalg.norm(left))
        if length > 1e-8 * float(np.linalg.norm(column)) and length > 0.0:
            rest -= np.outer(left, left) / length**2
    G = rest / unit[:, None] / unit
    with np.errstate(over="ignore", invalid="ignore"):
        e = G @ z / np.sqrt(((G @ R) * G).sum(axis=1))
    return [(i, float(e[i]), float(rest[i, i])) for i in range(len(z)) if rest[i, i] > _REDUNDANT and np.isfinite(e[i])]


class LearntNoise(NamedTuple):
    """What has been learnt about the noise; g = 1 if all sensors fail together, else the number of sensors."""

    #: Variance of ordinary noise over what the filter was given, shape (g,).
    r: Array
    #: Standard error of r, shape (g,).
    r_std: Array
    #: Share of outliers in the memory, shape (g,).
    contamination: Array
    #: Standard error of contamination, shape (g,).
    contamination_std: Array
    #: Root-mean-square size of outliers over that of ordinary noise, shape (g,); the prior's where there were none.
    scale_ratio: Array
    #: Mean length of a run of outliers, in samples, shape (g,).
    run_length: Array


def describe(learnt: Array, scales: Array, sensors: int = 1) -> LearntNoise:
    """Return what has been learnt in the user's terms."""
    # The standard errors hold for samples in a memory that forgets exponentially; that of the contamination counts runs
    # of outliers rather than outliers.
    K = len(scales)
    counts = learnt[:, _counts(K)].reshape(-1, K, K)
    classes, total = counts.sum(axis=1), counts.sum(axis=(1, 2))
    share = 1.0 - classes[:, 0] / total
    # How large outliers are those say that there were: the widest classes of the prior would outweigh them.
    prior = _chain(start(K), K)[1].sum(axis=0)
    outliers = np.maximum(classes - prior, 0.0)[:, 1:] + 0.01 * prior[1:]
    squares = outliers @ scales[1:] / outliers.sum(axis=1) if K > 1 else np.ones(len(learnt))
    bad = counts[:, 1:, 1:].sum(axis=(1, 2)) / counts[:, 1:].sum(axis=(1, 2)) if K > 1 else np.zeros(len(learnt))
    # Correlation of one sample's indicator with the next one's.
    stay = np.clip(bad - counts[:, 0, 1:].sum(axis=1) / counts[:, 0].sum(axis=1), 0.0, 0.99)
    return LearntNoise(
        r=learnt[:, R_FACTOR].copy(),
        r_std=learnt[:, R_FACTOR] / np.sqrt(sensors * learnt[:, SAMPLES]),
        contamination=share,
        contamination_std=np.sqrt(share * (1.0 - share) / (total + 1.0) * (1.0 + stay) / (1.0 - stay)),
        scale_ratio=np.sqrt(squares),
        run_length=1.0 / (1.0 - np.minimum(bad, 1.0 - 1e-9)),
    )
