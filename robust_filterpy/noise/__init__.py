"""Noise with outliers: as distributions, and estimated from a recording.

* `distributions`: the least favourable density in the manner of scipy.stats; `Contaminated` is in `correction`.
* `estimation`: R, Q, contamination and scale ratio by maximum likelihood, with intervals.
* `tuning`: from a recording to a filter of the kind that its noises ask for.

Imports from below: `influence`, `correction`, `filters`.
"""

from __future__ import annotations

from robust_filterpy.noise.distributions import LeastFavorable, fisher_information
from robust_filterpy.noise.estimation import estimate_noise
from robust_filterpy.noise.tuning import tune

__all__ = ["LeastFavorable", "estimate_noise", "fisher_information", "tune"]
