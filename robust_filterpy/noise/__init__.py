"""Noise with outliers: as distributions, and estimated from a recording.

* `distributions`: the least favorable density in the manner of scipy.stats; `Contaminated` is in `correction`.
* `estimation`: R, Q, contamination and scale ratio by maximum likelihood, with intervals.

Imports from below: `influence`, `correction`, `filters`.
"""

from __future__ import annotations

from robust_filterpy.noise.distributions import LeastFavorable, fisher_information
from robust_filterpy.noise.estimation import estimate_noise

__all__ = ["LeastFavorable", "estimate_noise", "fisher_information"]
