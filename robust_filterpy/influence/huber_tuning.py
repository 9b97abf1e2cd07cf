"""Closed forms of Huber's function: threshold <-> contamination <-> efficiency, and its density's constant."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy import special

_LOG_SQRT_2PI = 0.5 * math.log(2.0 * math.pi)


def outlier_odds(k: float) -> float:
    """Return eps/(1 - eps) for which k is minimax."""
    density = math.exp(-0.5 * k * k) / math.sqrt(2.0 * math.pi)
    return max(2.0 * density / k - 2.0 * float(special.ndtr(-k)), 0.0)


def normal_efficiency(k: float) -> float:
    """Return (E psi')^2 / E psi^2 under the standard normal."""
    if k > 38.0:
        return 1.0
    inside = 2.0 * float(special.ndtr(k)) - 1.0
    density = math.exp(-0.5 * k * k) / math.sqrt(2.0 * math.pi)
    return inside**2 / (inside - 2.0 * k * density + 2.0 * k * k * float(special.ndtr(-k)))


@lru_cache(maxsize=256)
def minimax_threshold(contamination: float) -> float:
    """Invert `outlier_odds`; k runs over many decades, so the search is over log k."""
    from scipy.optimize import brentq

    odds = contamination / (1.0 - contamination)
    if odds < 1e-290:
        return math.inf
    return math.exp(brentq(lambda s: math.log(outlier_odds(math.exp(s)) / odds), -700.0, math.log(36.0), xtol=1e-15))


@lru_cache(maxsize=256)
def efficient_threshold(efficiency: float) -> float:
    """Invert `normal_efficiency`."""
    from scipy.optimize import brentq

    if efficiency >= normal_efficiency(8.0):
        return math.inf
    return float(brentq(lambda k: normal_efficiency(k) - efficiency, 1e-9, 8.0, xtol=1e-14))


@lru_cache(maxsize=256)
def huber_log_normalizer(k: float, dim: int) -> float:
    """Return log of the radial integral in closed form by incomplete gamma functions."""
    half = 0.5 * dim
    if math.isinf(k):
        return dim * _LOG_SQRT_2PI
    sphere = math.log(2.0) + half * math.log(math.pi) - special.gammaln(half)
    core = math.log(special.gammainc(half, 0.5 * k * k)) + special.gammaln(half) + (half - 1.0) * math.log(2.0)
    # log(exp(k^2/2) Gamma(dim, k^2)/k^dim); for integer dim the upper incomplete gamma is a finite sum.
    terms = -special.gammaln(np.arange(dim) + 1.0) + 2.0 * np.arange(dim) * math.log(k)
    tail = special.gammaln(dim) - 0.5 * k * k + special.logsumexp(terms) - dim * math.log(k)
    return float(sphere + np.logaddexp(core, tail))
