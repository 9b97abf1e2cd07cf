"""What a fusion answers with: estimates, noise, and bands for what is to come, of readings and of their signal.

To begin with a band is that of the learned mixture: the state moved on, and the classes of noise as learned. Then the
readings that are kept say by how much such bands were too narrow or too wide: each is compared with the band that would
have been drawn for it as long before as the forecast looks ahead. Its score is the distance from the middle over half
the width; the quantile of the scores at the level widens the band. Few scores, or many that overlap, count little.

The signal was never seen. What the scores say about its spread is what they leave when the noise is taken off, and
counts as far as that spread exceeds the noise. It matters where Q is trusted: with one a hundred times too small bands
of .95 hold .58 to .75 of the time, without this .25 to .33.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr, ndtri

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy.fusion._stepping import Setup, State, covariance, moved
from robust_filterpy.fusion._table import Clock


class Estimate(NamedTuple):
    """The estimate of the state at a moment."""

    #: The moment, as a stamp.
    time: Any
    #: Mean, (n,).
    x: Array
    #: Its covariance, (n, n).
    P: Array
    #: Seconds since each sensor has spoken last; infinite if it never has.
    ages: dict[str, float]
    #: Whether it is open if a sensor or the state is wrong (``reacquire``): P covers both.
    undecided: bool = False

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class Forecast(NamedTuple):
    """What is to come at K times: two bands for each sensor, of its readings and of the signal without their noise."""

    #: Stamps, as given.
    times: tuple[Any, ...]
    #: What each sensor should read, (K, m).
    middle: dict[str, Array]
    #: Lower and upper end of the band of readings, (K, m, 2); NaN while a sensor's noise is not estimated.
    readings: dict[str, Array]
    #: Lower and upper end of the band of what is measured, noise apart, (K, m, 2).
    signal: dict[str, Array]

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class SensorNoise(NamedTuple):
    """What has been learned about a sensor's noise."""

    #: Standard deviation of its ordinary noise, in the unit of z, (m,); NaN before its first reading if not given.
    deviation: Array
    #: Share of outliers, (m,); NaN where it is not learnt.
    contamination: Array

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


# Stamps at the very beginning whose bands say nothing, and how many scores the learned mixture is worth.
_BEGINNING, _WORTH = 10, 5.0
# Limits of what the scores may say about the variance of the signal.
_FACTORS = np.log([1e-2, 1e3])


class _Ahead(NamedTuple):
    """What a state says about readings to come, for each component, or one for many moments."""

    #: NaN if a sensor's function has no answer.
    middle: Array
    #: Variance of the signal.
    spread: Array
    #: Variance of ordinary noise; NaN before it is estimated.
    r: Array
    #: Of the classes, (.., C).
    shares: Array


def forecast(line: Any, clock: Clock, state: State, at: float | int, times: Any, level: float) -> Forecast:
    """Return what each sensor should read at times to come, with its bands: `Fusion.forecast`."""
    # A string and a single stamp are one time.
    wanted = tuple(times) if np.ndim(times) == 1 else (times,)
    if not wanted:
        raise ValueError("times: expected a time, got none")
    ahead = [clock.between(at, clock.key(t, "times")) for t in wanted]
    if any(seconds < 0.0 for seconds in ahead):
        raise ValueError(
            f"times: expected times from the newest stamp on, {clock.stamp(at)}, got "
            f"{wanted[int(np.argmin(ahead))]}; estimate(t) tells the past"
        )
    layout = line.setup.layout
    forecasts = [bands(line, state, seconds, level) for seconds in ahead]
    middle, signal, readings = (np.array(part).reshape(-1, layout.size) for part in zip(*forecasts, strict=True))

    def by_sensor(part: Array) -> dict[str, Array]:
        return {name: part[:, place] for name, place in layout.places.items()}

    ends = (by_sensor(np.stack([middle - wide, middle + wide], axis=-1)) for wide in (readings, signal))
    return Forecast(wanted, by_sensor(middle), *ends)


def bands(line: Any, state: State, seconds: float, level: float) -> tuple[Array, Array, Array]:
    """Return the bands some seconds after the last entry."""
    setup: Setup = line.setup
    scales, now = setup.policy.shares(state.memory)[0], _ahead(setup, moved(setup, state, seconds))
    wide = _half_width(now, scales, level)
    readings, signal = wide.copy(), np.asarray(ndtri(0.5 + 0.5 * level) * np.sqrt(now.spread))
    apart, then, keys = _looked_back(line, seconds)
    for c in range(setup.layout.size):
        there = np.flatnonzero(np.isfinite(apart[:, c] + then.r[:, c]))
        if len(there) < 2:
            continue
        past = _Ahead(*(part[there, c] for part in then))
        # Bands of which one begins before the other ends are one.
        length = Clock.between(keys[there[0]], keys[there[-1]])
        count = min(float(len(there)), length / seconds if seconds > 0.0 else np.inf)
        trust = count / (count + _WORTH)
        scores = np.abs(apart[there, c]) / _half_width(past, scales, level)
        # As many of n + 1 as the level says, the next one among them.
        rank = min(level * (len(there) + 1) / len(there), 1.0)
        readings[c] *= max(float(np.quantile(scores, rank)), 1e-3) ** trust
        seen = now.spread[c] / (now.spread[c] + now.r[c])
        signal[c] *= _factor(np.abs(apart[there, c]), past, scales) ** (0.5 * trust * seen)
    return now.middle, signal, readings


def _ahead(setup: Setup, state: State) -> _Ahead:
    """Return what a state says about readings of its moment."""
    layout, policy = setup.layout, setup.policy
    # Readings of 0 differ from what is expected by that, with the sign turned.
    seen = layout.seen_from(state.x, np.zeros(layout.size))
    middle, spread = seen.H @ state.x - seen.z, ((seen.H @ state.P) * seen.H).sum(axis=1)
    R = covariance(layout, state.sizes).diagonal()
    r = np.where(np.isnan(state.sizes), np.nan, policy.factors(state.memory) * R)
    shares = np.array(policy.shares(state.memory)[1])
    shares[np.isnan(policy.contamination(state.memory))] = np.eye(shares.shape[1])[0]
    return _Ahead(middle, spread, r, shares)


def _looked_back(line: Any, seconds: float) -> tuple[Array, _Ahead, list[Any]]:
    """Return how far each kept reading was from what the state so many seconds before had said, and what that was."""
    setup, keys = line.setup, line.keys
    apart, predictions, at = [], [], []
    for j in range(_BEGINNING, len(keys)):
        i = min(bisect_right(keys, Clock.moved(keys[j], -seconds)), j) - 1
        z = line.entries[j].z
        if i < 0 or np.isnan(z).all():
            continue
        state = moved(setup, line.entries[i].moment.state, Clock.between(keys[i], keys[j]))
        seen = setup.layout.seen_from(state.x, z)
        apart.append(seen.z - seen.H @ state.x)
        predictions.append(_ahead(setup, state))
        at.append(keys[j])
    if not predictions:
        none = np.zeros((0, setup.layout.size))
        return none, _Ahead(none, none, none, none[:, :, None]), at
    return np.array(apart), _Ahead(*(np.array(part) for part in zip(*predictions, strict=True))), at


def _half_width(ahead: _Ahead, scales: Array, level: float) -> Array:
    """Return half the width of the symmetric band in which a reading lies with a probability."""
    sd = np.sqrt(ahead.spread[..., None] + scales * ahead.r[..., None])
    low, high = np.zeros(sd.shape[:-1]), ndtri(0.5 + 0.5 * level) * sd.max(axis=-1)
    for _ in range(40):
        middle = 0.5 * (low + high)
        held = (ahead.shares * (2.0 * ndtr(middle[..., None] / sd) - 1.0)).sum(axis=-1)
        low, high = np.where(held < level, middle, low), np.where(held < level, high, middle)
    return np.asarray(np.where(np.isnan(ahead.r), np.nan, high))


def _factor(apart: Array, past: _Ahead, scales: Array) -> float:
    """Return by how much the variance of the signal is to be multiplied for half the scores to be in half bands."""
    low, high = _FACTORS
    for _ in range(20):
        middle = 0.5 * (low + high)
        wide = _half_width(past._replace(spread=past.spread * np.exp(middle)), scales, 0.5)
        low, high = (middle, high) if np.mean(apart <= wide) < 0.5 else (low, middle)
    return float(np.exp(0.5 * (low + high)))
