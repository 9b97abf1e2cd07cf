"""What a fusion answers with, and how it warns."""

from __future__ import annotations

from typing import Any, NamedTuple

from robust_filterpy._brief import brief
from robust_filterpy._checks import Array
from robust_filterpy._warning import RobustFilterWarning

__all__ = ["Estimate", "Forecast", "FusionWarning", "SensorNoise"]


class FusionWarning(RobustFilterWarning):
    """Say what a fusion cannot use, or whom it does not believe."""


class Estimate(NamedTuple):
    """The estimate of the state at a moment."""

    time: Any
    """The moment, as a stamp."""
    x: Array
    """Mean, (n,)."""
    P: Array
    """Its covariance, (n, n)."""
    ages: dict[str, float]
    """Seconds since each sensor has spoken last; infinite if it never has."""
    undecided: bool = False
    """Whether it is open if a sensor or the state is wrong (``reacquire``): P covers both."""

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class Forecast(NamedTuple):
    """What is to come at K times: two bands for each sensor, of its readings and of the signal without their noise."""

    times: tuple[Any, ...]
    """Stamps, as given."""
    middle: dict[str, Array]
    """What each sensor should read, (K, m)."""
    readings: dict[str, Array]
    """Lower and upper end of the band of readings, (K, m, 2); NaN while a sensor's noise is not estimated."""
    signal: dict[str, Array]
    """Lower and upper end of the band of what is measured, noise apart, (K, m, 2)."""

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)


class SensorNoise(NamedTuple):
    """What has been learned about a sensor's noise."""

    deviation: Array
    """Standard deviation of its ordinary noise, in the unit of z, (m,); NaN before its first reading if not given."""
    contamination: Array
    """Share of outliers, (m,); NaN where it is not learnt."""

    def __str__(self) -> str:
        """Return a line for each part."""
        return brief(self)
