"""The variance R of a tracker's ordinary noise, followed sample by sample through outliers.

What is followed is a scale of the standardized innovation e = nu/sqrt(S): the mean of min(e^2, 4), which no outlier
moves by more than 4 (Huber's proposal 2), against what it would be if R were right. The learnt share and size of the
outliers belong to what it would be, so that R stays the variance of the ordinary samples.
"""

from __future__ import annotations

import math
from typing import Any, Final, NamedTuple

from scipy.special import erfc, gammainc

from robust_filterpy.correction.contaminated import Contaminated

__all__ = ["NoiseScale", "followed", "ordinary_mean"]

# Standard deviations from which on an innovation is as large as any.
_REACH: Final = 2.0
# The first samples count as if there had been none before, so that R may be wrong by many powers of ten.
_FIRST: Final = 5.0
#: Up to so many samples P grows with R: what was learnt with an R far too small is known less well by as much.
EARLY: Final = 20.0
# min(e^2, 4) moves with R two thirds as much as e^2 does.
_PACE: Final = 1.5


class NoiseScale(NamedTuple):
    """What following R takes besides R itself."""

    samples: float
    """How many samples R stands on."""
    mean: float
    """Mean of min(e^2, 4) where R is right."""
    memory: float
    """Number of samples that R is to remember; 0: R stays as it is."""
    rounding: float
    """Steps of the sensor, or what arithmetic loses, in the unit of y; 0: not known. R is what they make at least."""


def followed(R: float, scale: NoiseScale, nu: float, S: float) -> tuple[float, float]:
    """Return R after one more innovation, and how many samples it stands on."""
    # A sample whose regressor overflows tells nothing of R.
    if not S < 1e290:
        return R, scale.samples
    share = R / S
    gain = share * max(_PACE / scale.memory, min(1.0, _FIRST / (scale.samples + 1.0)))
    surprise = min(nu * nu / S, _REACH * _REACH) / scale.mean - 1.0
    # A plant at rest shows no noise in steps of its sensor, one that moves does.
    least = max(scale.rounding * scale.rounding / 12.0, 1e-290)
    return max(R * math.exp(gain * surprise), least), scale.samples + share


def ordinary_mean(influence: Any) -> float:
    """Return the mean of min(e^2, 4) for normal noise, or for a learnt mixture."""
    if not isinstance(influence, Contaminated):
        return _mean(1.0)
    c = influence.contamination
    return (1.0 - c) * _mean(1.0) + c * _mean(influence.scale_ratio)


def _mean(scale: float) -> float:
    """Return the mean of min(s^2, 4) of a normal s with this standard deviation."""
    a = _REACH / scale
    # s^2 below a^2 has three degrees of freedom; as a difference it would be lost in a wide mixture.
    return scale * scale * float(gammainc(1.5, 0.5 * a * a)) + _REACH * _REACH * float(erfc(a / math.sqrt(2.0)))
