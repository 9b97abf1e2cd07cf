"""Cheap tests of every reading, a few numbers for each hypothesis: they raise an alarm, on which `_faults` looks back.

What a sensor that is off by b since some reading does to all later innovations is linear in b. The response s of the
estimate to b = 1 goes with the filter's own gain, and so do the score A and the information I about b::

    s <- F s,  d = J - H s,  s <- s + K d,  A <- A + d' S^-1 y,  I <- I + d' S^-1 d

J is 1 for a sensor that is biased, and the time since the onset for one that drifts. With b normal of variance q the
logarithm of the odds is A^2 / (2 (I + 1/q)) - log(1 + q I) / 2, and that of the prior besides. Onsets are a few for
each component: each begins anew after 8, 16, .. 256 readings, so that one is about as long ago as any fault.

For noise that has grown, and for outliers of each class that are more than usual, there is a sum of logarithms of odds
under noise as it usually is, never below 0 (Page 1954), and for a sensor that seldom repeats itself the chance of the
run of readings that say exactly the same. What is usual is what was learned, averaged over 300 readings, but not while
something is suspected.

Where a sensor's noise carries over from one reading to the next, with a correlation phi, its sums wander as if each
reading counted (1 + phi) / (1 - phi) times. phi is learned from how often e keeps its sign while nothing is suspected;
the score and the information are multiplied by the inverse (`worth`), what is asked of squares by that of phi^2.

No test speaks in the first 60 readings of a sensor: its noise is learned from them. After a look that found nothing the
odds must have grown by more than they had come to, until that is forgotten.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg.lapack import dposv

from robust_filterpy._checks import Array
from robust_filterpy.correction.learnt import REACH
from robust_filterpy.kernel import extension

#: What can be the matter with a sensor: nothing, something that is not decided yet, ..; of the motion, its model.
FAULTS = ("healthy", "departs", "biased", "drifting", "stuck", "noisier", "spikes")
HEALTHY, DEPARTS, BIASED, DRIFTING, STUCK, NOISIER, SPIKES = range(len(FAULTS))
MODEL = -1

# Columns of a component's memory.
SLOW, _COUNT, _SIGN, _KEEPS, _REPEATS, _USUAL, _LAST, _NOISE, _CLASSES = range(9)
# Logarithm of the odds of a fault at which there is an alarm, below which nothing is suspected, and of its prior at a
# reading.
_ALARM, _QUIET, _PRIOR = -1.0, -6.0, math.log(1e-5)
# Onsets: how many, and readings after which the first of them begins anew; each next one after twice as many.
_ONSETS, _SHORTEST = 6, 8
# How the age of a bias grows, which is 1, and of a drift.
_GROWS = np.array([[0.0], [1.0]])
# Standard deviation of b in the sensor's own; of a drift: of what it has come to.
_SIZE = 4.0
# How many onsets each of them stands for, as logarithms.
_WIDTHS = np.log(0.5 * _SHORTEST * 2.0 ** np.arange(_ONSETS))
# Factors of the variance of noise that has grown, the share of outliers that are more, and the most that one reading
# may say.
_FACTORS, _MORE, _MOST = (1.0, 4.0, 25.0), 0.25, 3.0
# A factor of Q that is likely, at which there is an alarm for the model. The least weight of a reading, and what the
# odds must have grown by after a look that found nothing.
_SLACK, _LEAST, _AGAIN = 5.0, 1e-6, 3.0
# How sure it is that the model is wrong before that stands, and the share of its limit that a stamp forgets until then.
_SURE, _SOON = 0.95, 0.05
# Components whose logarithm of the odds is so far below the best are not looked at.
_FAR_BELOW = 12.0
# Readings from which noise is learned before a test speaks, and over which what was learned is averaged.
_FIRST, _AVERAGED = 60.0, 300.0
# Readings after which what was learned is asked for again.
_SELDOM = 4.0
# A correlation of n readings is no color up to this over sqrt(n): 1.5 standard deviations of pi/2 times the mean sign.
_BY_CHANCE = 2.4
# Readings over which recovery is judged, and where innovations are clipped for that.
_RECENT, _ENOUGH, _CLIP = 20.0, 30.0, 3.0


class Watch(NamedTuple):
    """What was learned of the health of each component and sensor; nothing in here is ever written to."""

    #: (M, 8 + C + C + 1): the columns above, the shares of the classes of noise, and the sums: of two sizes of grown
    #: noise, and of outliers of each class but the first.
    statistics: Array
    #: Of the estimate to 1 in each component, biased or drifting, from each onset; (n, M * 2 * onsets).
    response: Array
    #: Score and information about its size, (2, M * 2 * onsets).
    evidence: Array
    #: 1, and seconds since each onset, (M, 2, onsets).
    age: Array
    #: Of the classes of noise, (C,).
    scales: Array
    #: Logarithm of the odds of a fault, (M,).
    score: Array
    #: Of clipped e as noise was before the fault: mean, mean square, share beyond 3, how many; (M, 4).
    recent: Array
    #: Variance factors of the noise when the fault was seen, (M,).
    before: Array
    #: Place in `FAULTS`, (S,).
    fault: Array
    #: Probability of it, (S,).
    odds: Array
    #: How large it is, in the sensor's standard deviations, or per second, or as a factor or a share; (S,).
    size: Array
    #: Key of its onset, None where there is none.
    since: tuple[Any, ...]
    #: Readings of the sensor until the next look, (S,).
    due: Array
    #: Logarithm of the odds at which there is an alarm, the last one for the model, (S + 1,).
    limit: Array
    #: Factor of Q that is thought likely.
    slack: float
    #: Probability that the model of the motion was wrong at the last look.
    model: float
    #: Key of the onset.
    model_since: Any
    #: Key of the moment when what a sensor had said was last taken out of x.
    mended: Any
    #: Key of the stamp that has asked for a look back which is under way.
    asked: Any

    @property
    def ill(self) -> bool:
        """Whether anything is the matter with any sensor."""
        return self.since.count(None) < len(self.since)

    @property
    def calm(self) -> bool:
        """Whether no sensor is ill and no test speaks."""
        *sensors, model = self.limit.tolist()
        enough = self.slack <= _SLACK or math.log(self.slack) <= model
        return enough and not self.ill and max(self.score.tolist()) <= min(sensors)

    @property
    def out(self) -> np.ndarray:
        """Which sensors are left out of x: whose lie is no noise."""
        return (self.fault >= BIASED) & (self.fault <= STUCK)


def fresh(states: int, components: int, sensors: int, scales: Array) -> Watch:
    """Return that nothing is the matter."""
    statistics, age = np.zeros((components, _CLASSES + 2 * len(scales) + 1)), np.zeros((components, 2, _ONSETS))
    statistics[:, _LAST], statistics[:, SLOW], statistics[:, _CLASSES], age[:, 0] = np.nan, 1.0, 1.0, 1.0
    return Watch(
        statistics, np.zeros((states, age.size)), np.zeros((2, age.size)), age, scales,
        np.full(components, _PRIOR),
        np.zeros((components, 4)), np.ones(components), np.zeros(sensors), np.ones(sensors), np.zeros(sensors),
        (None,) * sensors, np.zeros(sensors), np.full(sensors + 1, _ALARM), 1.0, 0.0, None, None, None,
    )  # fmt: skip


class Looked(NamedTuple):
    """What was read at a moment, and what the filter made of it."""

    #: Components that were read.
    here: np.ndarray
    #: (M,), NaN where missing.
    z: Array
    #: Innovations, (M,).
    y: Array
    #: (M, n)
    H: Array
    #: Before it, (n, n).
    P: Array
    #: Nominal variance of noise, (M,).
    R: Array
    #: How much each was believed, NaN where it was not used, (M,).
    weights: Array
    policy: Any
    #: Before it, at the stamp before (`_stepping.State`).
    state: Any


def coasted(watch: Watch, F: Array, seconds: float) -> Watch:
    """Return the health some seconds later, with nothing read."""
    return watch._replace(response=F @ watch.response, age=watch.age + seconds * _GROWS)


def looked_at(watch: Watch, F: Array, seconds: float, now: Looked, owner: np.ndarray) -> Watch:
    """Return the health some seconds later, after the readings of that moment."""
    # Components of one sensor follow each other; a part of an array is faster than a choice from it.
    places = now.here.tolist()
    here = slice(places[0], places[-1] + 1) if places[-1] - places[0] < len(places) else now.here
    H, R, rows, scales = now.H[here], now.R[here], watch.statistics[here], watch.scales.tolist()
    PH, ordinary, rows = now.P @ H.T, (rows[:, SLOW] * R).tolist(), rows.tolist()
    S, score, due, learnt = H @ PH, watch.score.tolist(), watch.due.tolist(), None
    ill, recent, slack = watch.ill, watch.recent, watch.slack
    if any([row[_COUNT] % _SELDOM == 0.0 for row in rows]):
        memory, slack = now.state.memory, now.policy.slack(now.state.carried)
        learnt = np.column_stack([now.policy.factors(memory), now.policy.shares(memory)[1]])[here].tolist()
    updated, counts, y = [], [], now.y[here].tolist()
    said = zip(places, owner[here].tolist(), rows, ordinary, now.z[here].tolist(), S.diagonal().tolist(), strict=True)
    for k, (c, s, row, r, z, spread) in enumerate(said):
        # No reading is farther than the widest class of noise reaches, or one alone would say all there is.
        far = REACH * math.sqrt(max(spread + r * scales[-1], 0.0))
        y[k] = innovation = min(max(y[k], -far), far)
        quiet = score[c] < _QUIET
        due[s] -= 1.0
        if ill and watch.fault[s] > 0.0:
            quiet, recent = False, recent.copy() if recent is watch.recent else recent
            was = min(max(innovation / math.sqrt(spread + float(watch.before[c] * R[k])), -_CLIP), _CLIP)
            recent[c, 3] += 1.0
            recent[c, :3] += ([was, was * was, abs(was) >= _CLIP] - recent[c, :3]) / min(recent[c, 3], _RECENT)
        color = _color(row) if row[_COUNT] >= _FIRST else 1.0
        counts.append(_worth(color))
        usual = learnt[k] if learnt and quiet and row[_COUNT] % _SELDOM == 0.0 else []
        updated.append(_after(row, z, innovation, spread, r, scales, usual, quiet, _worth(color * color)))
    statistics = watch.statistics.copy()
    statistics[here] = updated
    limit = watch.limit + (_ALARM - watch.limit) / _AVERAGED
    if slack > _SLACK:
        # A model that is known to be wrong is not looked at again before Q is thought right, one in doubt is soon.
        pace = _SOON if watch.model < _SURE else 0.0
        limit[-1] = watch.limit[-1] + pace * (_ALARM - watch.limit[-1])
    for i, w in enumerate(now.weights[here].tolist()):
        S[i, i] += ordinary[i] / (w if w > _LEAST else _LEAST)
    lasting = _lasting(watch, F, seconds, statistics, now.here, np.array(y), H, PH, S, counts, now.R)
    return watch._replace(
        statistics=statistics, recent=recent, due=np.array(due), limit=limit, slack=slack, **lasting
    )


def _after(
    row: list[float], z: float, y: float, spread: float, r: float, scales: list[float], usual: list[float],
    quiet: bool, counts: float,
) -> list[float]:  # fmt: skip
    """Return a component's memory after a reading, which counts so much; usual: what is learned, if looked at."""
    C, e2 = len(scales), -0.5 * y * y
    shares, sums = row[_CLASSES : _CLASSES + C], row[_CLASSES + C :]
    # Nothing is below 0, where what is nearer than a standard deviation leaves it.
    if counts and (-2.0 * e2 > spread + r or any(sums)):
        mixed, of = [], []
        for factor in _FACTORS:
            v = [spread + factor * r * s for s in scales]
            of.append([math.exp(e2 / one) / math.sqrt(one) + 1e-300 for one in v])
            mixed.append(sum([p * one for p, one in zip(shares, of[-1], strict=True)]))
        others = mixed[1:] + [(1.0 - _MORE) * mixed[0] + _MORE * one for one in of[0][1:]]
        steps = [counts * min(math.log(one / mixed[0]), _MOST) for one in others]
        sums = [max(was + step, 0.0) for was, step in zip(sums, steps, strict=True)]
    same, count, sign = float(z == row[_LAST]), row[_COUNT] + 1.0, math.copysign(1.0, y)
    repeats = row[_REPEATS] + 1.0 if same else 0.0
    # How often it repeats itself when nothing is the matter; a long run counts little.
    often = row[_USUAL] + (0.01 * (same - row[_USUAL]) if repeats <= 2.0 else 0.0)
    run = -repeats * math.log(min(max(often, 0.02), 0.98)) if repeats >= 4.0 else 0.0
    slow, keeps = row[SLOW], row[_KEEPS]
    if usual:
        pace = _SELDOM / _AVERAGED if count > _FIRST else 1.0
        slow, *shares = (a + pace * (b - a) for a, b in zip([slow, *shares], usual, strict=True))
    if quiet:
        keeps += (sign * row[_SIGN] - keeps) / min(count, _AVERAGED)
    return [slow, count, sign, keeps, repeats, often, z, max(*sums, run), *shares, *sums]


def _lasting(
    watch: Watch, F: Array, seconds: float, statistics: Array, here: np.ndarray, y: Array, H: Array, PH: Array,
    S: Array, counts: list[float], R: Array,
) -> dict[str, Any]:  # fmt: skip
    """Return what there is to say of biases and drifts after the readings of one moment, each of which counts less."""
    # The onset that begins anew after these readings; at the first reading that counts all do.
    begins = [_begins(int(count)) for count in statistics[here, _COUNT].tolist()]
    variances, roots = _SIZE**2 * statistics[:, SLOW] * R, np.sqrt(counts)
    age, response, evidence = watch.age.copy(), watch.response.copy(), watch.evidence.copy()
    best, kernel = np.full(len(age), -np.inf), extension()
    given = F, H, PH, S, y, roots, here, np.array(begins), variances, _WIDTHS
    if kernel is None or not kernel.weigh_lasting((response, evidence, age, best), given, seconds):
        best = _weighed((response, evidence, age), given, seconds)
    score = np.maximum(best, statistics[:, _NOISE]) + _PRIOR
    return {"response": response, "evidence": evidence, "age": age, "score": score}


def _begins(count: int) -> float:
    """Return which onset begins anew after so many readings, -1 if none does, -2 if all do."""
    j = (count & -count).bit_length() - _SHORTEST.bit_length() + 1
    return -2.0 if count == _FIRST else float(j) if 0 <= j < _ONSETS else -1.0


def _weighed(moving: tuple[Array, ...], given: tuple[Any, ...], seconds: float) -> Array:
    """Weigh biases and drifts since each onset, in place; return the best of each component."""
    (response, evidence, age), (F, H, PH, S, y, roots, here, begins, variances, _) = moving, given
    shape = age.shape
    age[:, 1] += seconds
    response[:] = F @ response
    d = -(H @ response)
    own = d.reshape(len(y), *shape)
    own[roots > 0.0, here[roots > 0.0]] += age[here[roots > 0.0]]
    said, failed = dposv(S, d)[1:]
    if failed:
        # To rounding these readings are one: they say nothing of what lasts.
        d = said = np.zeros_like(d)
    response += PH @ said
    said = roots[:, None] * dposv(S, roots[:, None] * d)[1]
    evidence += np.array([y @ said, (d * said).sum(axis=0)])
    for c, begin in zip(here.tolist(), begins.tolist(), strict=True):
        if begin != -1.0:
            which = slice(None) if begin < -1.0 else int(begin)
            age[c, 1, which] = 0.0
            for part in (response, evidence):
                part.reshape(-1, *shape)[:, c, :, which] = 0.0
    A, information = evidence.reshape(2, *shape)
    precision = (age * age + 1e-300) / variances[:, None, None]
    whole = information + precision
    lasting = 0.5 * (A * A / whole + np.log(precision / whole)) + _WIDTHS
    return np.asarray(lasting.max(axis=(1, 2)))


def alarmed(watch: Watch, owner: np.ndarray) -> np.ndarray:
    """Return which sensors a test speaks against, and, last, whether Q is too small by a factor, (S + 1,)."""
    alarm = np.zeros(len(watch.limit), dtype=bool)
    alarm[owner[watch.score > watch.limit[owner]]] = True
    alarm[-1] = watch.slack > _SLACK and math.log(watch.slack) > watch.limit[-1]
    return alarm


def cleared(watch: Watch, sensors: np.ndarray, owner: np.ndarray) -> Watch:
    """Return that what the tests have against some sensors, or the model, has been looked at, (S + 1,)."""
    worst = np.array([*(watch.score[owner == s].max() for s in range(len(sensors) - 1)), math.log(watch.slack)])
    more = np.maximum(worst + _AGAIN + 0.5 * np.maximum(worst - _ALARM, 0.0), watch.limit)
    return watch._replace(limit=np.where(sensors, more, watch.limit))


def suspected(watch: Watch, followed: np.ndarray, owner: np.ndarray) -> np.ndarray:
    """Return which components may be at fault: whose odds are not far below the best, and of those sensors, (M,)."""
    return np.asarray((watch.score > max(_QUIET, watch.score.max() - _FAR_BELOW)) | followed[owner])


def begun_anew(watch: Watch, sensors: np.ndarray, owner: np.ndarray) -> Watch:
    """Return that nothing has been seen of lasting faults, since the state is another, nor of some sensors' noise."""
    statistics, age = watch.statistics.copy(), watch.age * [[1.0], [0.0]]
    sums = slice(_CLASSES + (statistics.shape[1] - _CLASSES) // 2, None)
    statistics[sensors[owner], _NOISE], statistics[sensors[owner], sums] = 0.0, 0.0
    response, evidence = 0.0 * watch.response, 0.0 * watch.evidence
    return watch._replace(statistics=statistics, response=response, evidence=evidence, age=age, asked=None)


def worths(watch: Watch) -> Array:
    """Return how much a reading of each component counts, by its correlation with the one before, in (0, 1], (M,)."""
    return np.array([_worth(_color(row)) for row in watch.statistics.tolist()])


def _color(row: list[float]) -> float:
    """Return the correlation of a component's readings with those before, in [0, .95]; what may be chance is 0."""
    # Signs of two normal numbers of correlation phi agree with probability 1/2 + arcsin(phi)/pi.
    phi = math.sin(0.5 * math.pi * row[_KEEPS])
    count = min(max(row[_COUNT], 1.0), 2.0 * _AVERAGED)
    return min(phi, 0.95) if phi > _BY_CHANCE / math.sqrt(count) else 0.0


def _worth(phi: float) -> float:
    """Return how much a reading counts if its correlation with the one before is phi."""
    return (1.0 - phi) / (1.0 + phi)


def recovered(watch: Watch, owner: np.ndarray) -> np.ndarray:
    """Return which sensors are again as they were before their fault, (S,)."""
    ill = watch.fault > 0.0
    if not ill.any():
        return ill
    (mean, square, far, count), repeats = watch.recent.T, watch.statistics[:, _REPEATS]
    well = (count >= _ENOUGH) & (np.abs(mean) < 0.5) & (square < 1.5) & (far < 0.08) & (repeats < 2.0)
    return np.array([bool(ill[s] and well[owner == s].all()) for s in range(len(watch.fault))])
