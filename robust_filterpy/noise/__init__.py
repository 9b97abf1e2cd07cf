"""Noise with outliers, estimated from a recording; as a distribution it is `Contaminated`, in `correction`.

* `estimation`: R, Q, contamination and scale ratio by maximum likelihood, with intervals.

Imports from below: `influence`, `correction`, `filters`.
"""

from __future__ import annotations

from robust_filterpy.noise.estimation import estimate_noise

__all__ = ["estimate_noise"]
