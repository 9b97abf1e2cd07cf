"""Cheap tests of every reading: they raise an alarm, on which `_faults` looks at the recent past.

e is an innovation over its standard deviation with ordinary noise as it usually is: what was learnt, averaged over 300
readings, but not while something is suspected. It is clipped to 3 for the first two::

    level   up, down = max(0, . +- e - k)                      a mean that has moved (Page 1954)
    width   max(0, . + e^2 3/8 - log 2)                        twice as wide against as wide as learnt
    far     max(0, . + log of the odds of |e| > 3)             a share of spikes larger by .2 than the one learnt
    repeats readings in a row that say exactly the same, where the sensor does not usually do that

Where a sensor's noise carries over from one reading to the next, with a correlation phi, its sums wander as if each
reading counted (1 + phi) / (1 - phi) times. phi is learnt from how often e keeps its sign while nothing is suspected;
every step of the first two sums is multiplied by the inverse (`worth`), of the others by that of phi^2.

No test speaks in the first 60 readings of a sensor, from which its noise is learnt. Limits are low: an alarm costs a
look, and what is said is up to that. After a look that found nothing half of a sum is left.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from robust_filterpy._checks import Array

__all__ = ["FAULTS", "SLOW", "Watch", "alarmed", "calm", "colour", "fresh", "looked_at", "recovered", "worth"]

#: What can be the matter with a sensor, by number: 0 is nothing, 1 something that is not known yet.
FAULTS = ("healthy", "departs", "biased", "drifting", "stuck", "noisier", "spikes")

# Columns of the tests, and their limits.
_UP, _DOWN, _WIDE, _FAR, _REPEATS, _USUAL, _LAST, SLOW, _COUNT, _SIGN, _KEEPS = range(11)
_SLACK = 0.35
_LIMITS = np.array([7.5, 7.5, 8.0, 7.0])
_AGAIN = 0.5
_CLIP, _MORE = 3.0, 0.2
# A run of exact repetitions that has so small a chance, by the share of repetitions learnt, is no accident.
_ACCIDENT = math.log(1e5)
# Readings from which noise is learnt before a test speaks, and over which what was learnt is averaged.
_FIRST, _AVERAGED = 60.0, 300.0
# A correlation of n readings is no colour up to this over sqrt(n): 1.5 standard deviations of pi/2 times the mean sign.
_BY_CHANCE = 2.4
# Readings over which recovery is judged.
_RECENT, _ENOUGH = 20.0, 30.0


class Watch(NamedTuple):
    """What is known of the health of each component and sensor; nothing in here is ever written to."""

    tests: Array
    """(M, 11)"""
    recent: Array
    """Of clipped e as noise was before the fault: mean, mean square, share beyond 3, how many; (M, 4)."""
    before: Array
    """Variance factors of the noise when the fault was seen, (M,)."""
    fault: Array
    """Place in `FAULTS`, (S,)."""
    odds: Array
    """Probability of it, (S,)."""
    size: Array
    """How large it is, in the sensor's standard deviations, or per second, or as a factor or a share; (S,)."""
    since: tuple[Any, ...]
    """Key of its onset, None where there is none."""
    due: Array
    """Readings of the sensor until the next look, (S,)."""
    model: float
    """Probability that the model of the motion was wrong at the last look."""
    model_since: Any
    """Key of the onset."""
    mended: Any
    """Key of the moment when what a sensor had said was last taken out of x."""

    @property
    def out(self) -> np.ndarray:
        """Which sensors are left out of x: whose lie is no noise."""
        return np.isin(self.fault, [2.0, 3.0, 4.0])


def fresh(components: int, sensors: int) -> Watch:
    """Return that nothing is the matter."""
    tests = np.zeros((components, 11))
    tests[:, _LAST], tests[:, SLOW] = np.nan, 1.0
    return Watch(
        tests, np.zeros((components, 4)), np.ones(components), np.zeros(sensors), np.ones(sensors),
        np.zeros(sensors), (None,) * sensors, np.zeros(sensors), 0.0, None, None,
    )  # fmt: skip


def looked_at(
    watch: Watch, z: Array, y: Array, spread: Array, R: Array, known: tuple[Array, Array], owner: np.ndarray
) -> Watch:
    """Return what is known after the readings of one moment."""
    here = ~np.isnan(y)
    tests = watch.tests.copy()
    factors, shares = known
    young, ill = tests[:, _COUNT] < _FIRST, here & (watch.fault[owner] > 0.0)
    quiet = here & ~ill & (tests[:, :4] < 0.5 * _LIMITS).all(axis=1)
    pace = np.where(young, 1.0, 1.0 / _AVERAGED)
    tests[quiet, SLOW] += (pace * (factors - tests[:, SLOW]))[quiet]
    tests[here, _COUNT] += 1.0
    e = np.where(here, y / np.sqrt(spread + tests[:, SLOW] * R), 0.0)
    clipped, sign = np.clip(e, -_CLIP, _CLIP), np.sign(e)
    pace = 1.0 / np.minimum(np.maximum(tests[:, _COUNT], 1.0), _AVERAGED)
    tests[quiet, _KEEPS] += (pace * (sign * tests[:, _SIGN] - tests[:, _KEEPS]))[quiet]
    tests[here, _SIGN] = sign[here]
    usual = np.clip(shares, 0.01, 0.5)
    far = np.where(np.abs(e) > _CLIP, np.log((usual + _MORE) / usual), np.log((1.0 - usual - _MORE) / (1.0 - usual)))
    steps = np.column_stack([clipped - _SLACK, -clipped - _SLACK, 0.375 * clipped**2 - math.log(2.0), far])
    old = here & ~young
    phi = colour(watch)
    # Squares of two such numbers have correlation phi^2.
    steps *= np.column_stack([worth(phi), worth(phi), worth(phi**2), worth(phi**2)])
    tests[old, :4] = np.maximum(0.0, tests[old, :4] + steps[old])
    same = here & (z == tests[:, _LAST])
    tests[here, _REPEATS] = np.where(same, tests[:, _REPEATS] + 1.0, 0.0)[here]
    # How often it repeats itself when nothing is the matter; a long run counts little.
    rate = np.where(tests[:, _REPEATS] <= 2.0, 0.01, 0.0)
    tests[here, _USUAL] += (rate * (same - tests[:, _USUAL]))[here]
    tests[here, _LAST] = z[here]
    recent = watch.recent
    if ill.any():
        recent = recent.copy()
        was = np.clip(np.where(ill, y / np.sqrt(spread + watch.before * R), 0.0), -_CLIP, _CLIP)
        recent[ill, 3] += 1.0
        share = 1.0 / np.minimum(np.maximum(recent[:, 3], 1.0), _RECENT)
        now = np.column_stack([was, was**2, np.abs(was) >= _CLIP])
        recent[ill, :3] += (share[:, None] * (now - recent[:, :3]))[ill]
    due = watch.due.copy()
    due[np.unique(owner[here])] -= 1.0
    return watch._replace(tests=tests, recent=recent, due=due)


def alarmed(watch: Watch, owner: np.ndarray) -> np.ndarray:
    """Return which sensors a test speaks against, (S,)."""
    over = (watch.tests[:, :4] > _LIMITS).any(axis=1) | repeating(watch)
    return np.isin(np.arange(len(watch.fault)), owner[over])


def colour(watch: Watch) -> Array:
    """Return the correlation of each component's readings with those before, (M,), in [0, .95]."""
    # What may be chance is 0. Signs of two normal numbers of correlation phi agree with probability 1/2 +
    # arcsin(phi)/pi.
    counts = np.minimum(watch.tests[:, _COUNT], 2.0 * _AVERAGED)
    phi = np.sin(0.5 * math.pi * watch.tests[:, _KEEPS])
    return np.where(phi > _BY_CHANCE / np.sqrt(np.maximum(counts, 1.0)), np.minimum(phi, 0.95), 0.0)


def worth(phi: Array) -> Array:
    """Return how much a reading counts if its correlation with the one before is phi, in (0, 1]."""
    return np.asarray((1.0 - phi) / (1.0 + phi))


def repeating(watch: Watch) -> np.ndarray:
    """Return which components say the same again and again, though that is not their way, (M,)."""
    usual = np.clip(watch.tests[:, _USUAL], 0.02, 0.98)
    return np.asarray((watch.tests[:, _REPEATS] >= 4.0) & (-watch.tests[:, _REPEATS] * np.log(usual) > _ACCIDENT))


def recovered(watch: Watch, owner: np.ndarray) -> np.ndarray:
    """Return which sensors are again as they were before their fault, (S,)."""
    mean, square, far, count = watch.recent.T
    well = (count >= _ENOUGH) & (np.abs(mean) < 0.5) & (square < 1.5) & (far < 0.08) & (watch.tests[:, _REPEATS] < 2.0)
    ill = watch.fault > 0.0
    return np.array([bool(ill[s] and well[owner == s].all()) for s in range(len(watch.fault))])


def calm(watch: Watch, sensors: np.ndarray, owner: np.ndarray) -> Watch:
    """Return that what the tests have against some sensors has been looked at."""
    tests = watch.tests.copy()
    tests[sensors[owner], :4] *= _AGAIN
    return watch._replace(tests=tests)
