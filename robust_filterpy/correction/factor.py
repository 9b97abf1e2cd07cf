"""One wrong factor of P, Q and R, of each part of a state by itself, learned from its first readings.

Where all three are c times too large or too small the Kalman filter's x is the same. So while a part is new the
recursion goes on as it was given, by the rule of `robust_filterpy.correction.spread`, whose typical innovation tells c.
Where c is beyond what the scales of Q reach, and this recursion foretells the readings better than the models do, it is
what the filter shows; if it still does after fifty readings, the models begin again from it, with c P, c Q and c R.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array
from robust_filterpy.correction import spread
from robust_filterpy.correction.definition import Innovation, correct_by_typical, innovation_moments
from robust_filterpy.correction.learning import LOG_DECIDES, LOG_EVIDENCE
from robust_filterpy.correction.options import Choices
from robust_filterpy.influence.functions import Huber

__all__ = ["Given", "judged"]

# Readings of a part from which on a factor may be taken, and after which it is 1 if it is near 1.
_DECIDES = 50.0
DECIDED = 2.0 * _DECIDES
# Less is left to the scales of Q and to r; a factor beyond a million million is rounding.
_LOG_BEYOND = math.log(30.0)
_LOG_FARTHEST, _LOG_ROOT = math.log(1e12), 0.5 * math.log(2.0 * math.pi)
_CHOICES = Choices(Huber(), "learnt")


class Given(NamedTuple):
    """The recursion as given, and for each state what its part has shown."""

    #: Shape (n,).
    x: Array
    #: Shape (n, n).
    P: Array
    #: How much likelier the readings are by it than by the models, in logarithms, at least 0, shape (n,).
    evidence: Array
    #: How many there were, 100 once it is decided, shape (n,).
    readings: Array
    #: Of P, Q and R, shape (n,).
    factor: Array

    @property
    def looks(self) -> np.ndarray:
        """States of which it is not decided."""
        return np.asarray(self.readings < DECIDED)

    @property
    def shown(self) -> np.ndarray:
        """States that are shown as this recursion has them."""
        return np.asarray(self.looks & (self.evidence >= LOG_DECIDES))

    def moved(self, F: Array, Q: Array, Bu: Array | None, alpha_sq: float) -> Given:
        """Return it after a prediction."""
        if not self.looks.any():
            return self
        x = F @ self.x
        return self._replace(x=x if Bu is None else x + Bu, P=alpha_sq * (F @ self.P @ F.T) + Q)


def scaled(covariance: Array, factor: Array) -> Array:
    """Return a covariance times a factor for each of its variables."""
    if (factor == 1.0).all():
        return covariance
    root = np.sqrt(factor)
    return np.asarray(covariance * np.multiply.outer(root, root))


def judged(
    given: Given, spreads: Array, z: Array, readings: Array, H: Array, R: Array, M: Array | None, logs: Array,
    parts: Array,
) -> tuple[Given, Array]:  # fmt: skip
    """Return the recursion after a reading, and what is learned of the sensors' typical innovations.

    z are measurements of x; `readings` are what the sensors said, of which z are the innovations in a nonlinear filter.
    `logs` are log densities of z by the models, NaN where there is none. Where the readings tell a factor, it is not 1
    any more.
    """
    here, seen, counts = ~np.isnan(logs), parts[np.argmax(H != 0.0, axis=1)].astype(int), given.readings
    C, S = innovation_moments(given.P, H, R, M)
    y = np.where(here, z - H @ given.x, np.nan)
    after = correct_by_typical(spreads, given.x, given.P, Innovation(readings, y, C, S, R, H), _CHOICES, True)
    evidence, count, factor = given.evidence.copy(), counts.copy(), given.factor.copy()
    for head in np.unique(seen[here & (counts[seen] < DECIDED)]):
        own, states = np.flatnonzero(here & (seen == head)), parts == head
        # A factor is common to all sensors of a part: that of the sensor which shows least of one.
        learned = spreads[own, spread.WEIGHT] > 0
        coarse = np.where(spreads[own, spread.REPEATS] > 0, spreads[own, spread.STEP] / spread.BEND, 0.0)
        sizes = np.maximum(np.maximum(spreads[own, spread.SPREAD], coarse / np.sqrt(S[own, own])), 1e-150)
        logs_of = np.clip(np.where(learned, 2 * np.log(sizes), 0.0), -_LOG_FARTHEST, _LOG_FARTHEST)
        log_c = float(logs_of[np.argmin(np.abs(logs_of))])
        gain, beyond = 0.0, abs(log_c) > _LOG_BEYOND
        # One that repeats the reading before is no sample of noise.
        for i in own[beyond & (readings[own] != spreads[own, spread.LAST])]:
            log_unit = 0.5 * (math.log(S[i, i]) + log_c)
            by_it = -float(_CHOICES.influence.rho(y[i] / math.exp(log_unit))) - log_unit - _LOG_ROOT
            gain += min(max(by_it - logs[i], -LOG_EVIDENCE), LOG_EVIDENCE)
        gain = min(max(evidence[head] + gain, 0.0), 2.0 * LOG_DECIDES) if beyond else 0.0
        count[states] = min(counts[head] + 1.0, DECIDED - float(beyond))
        evidence[states] = gain
        if count[head] > _DECIDES and gain == 2.0 * LOG_DECIDES:
            factor[states], count[states] = math.exp(log_c), DECIDED
    return Given(after.x, after.P, evidence, count, factor), np.asarray(after.memory)
