"""What a fusion answers with: estimates, noise, and bands for what is to come, of readings and of their signal.

The state is moved on; around what it says a reading lies as the classes of noise, as learned, say. The bands are as
sure as what was learned of R and of the scale of Q; where these are given they are taken as they are.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtri

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy.correction.contaminated import low_quantile
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


def forecast(setup: Setup, clock: Clock, state: State, at: float | int, times: Any, level: float) -> Forecast:
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
    layout = setup.layout
    later = [moved(setup, state, seconds) for seconds in ahead]
    # Readings of 0 differ from what is expected by that, with the sign turned.
    seen = [layout.seen_from(one.x, np.zeros(layout.size)) for one in later]
    middle = np.array([sensors.H @ one.x - sensors.z for one, sensors in zip(later, seen, strict=True)])
    spread = np.array([((n.H @ one.P) * n.H).sum(axis=1) for one, n in zip(later, seen, strict=True)])
    widths = _half_width(setup, state, spread, level), ndtri(0.5 + 0.5 * level) * np.sqrt(spread)

    def by_sensor(part: Array) -> dict[str, Array]:
        return {name: part[:, place] for name, place in layout.places.items()}

    ends = (by_sensor(np.stack([middle - wide, middle + wide], axis=-1)) for wide in widths)
    return Forecast(wanted, by_sensor(middle), *ends)


def _half_width(setup: Setup, state: State, spread: Array, level: float) -> Array:
    """Return half the width of the symmetric bands in which readings lie with a probability; spread: of the signal."""
    policy, memory = setup.policy, state.memory
    R = policy.factors(memory) * covariance(setup.layout, state.sizes).diagonal()
    scales, shares = policy.shares(memory)
    shares = np.where(np.isnan(policy.contamination(memory))[:, None], np.eye(len(scales))[0], shares)
    sd = np.sqrt(spread[..., None] + scales * R[:, None])
    half = -low_quantile(np.full(spread.shape, 0.5 - 0.5 * level), sd, shares)
    return np.asarray(np.where(np.isnan(state.sizes), np.nan, half))
