"""Noise with outliers: as distributions, and estimated from a recording.

* `distributions`: contaminated normal and least favourable densities in the manner of scipy.stats.
* `estimation`: R, Q, contamination and scale ratio by maximum likelihood.

Imports from below: `influence`, and `robust_filterpy._arrays`.
"""

from __future__ import annotations

from robust_filterpy.noise.distributions import (
    EpsilonContaminated,
    LabelledSample,
    LeastFavorable,
    fisher_information,
)
from robust_filterpy.noise.estimation import NoiseEstimate, estimate_noise

__all__ = [
    "EpsilonContaminated",
    "LabelledSample",
    "LeastFavorable",
    "NoiseEstimate",
    "estimate_noise",
    "fisher_information",
]
