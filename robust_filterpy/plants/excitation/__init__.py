"""Inputs with a prescribed spectrum.

* `signals`: band-limited 1/f noise, binary signals with a prescribed autocovariance (paper 54-57).
* `receding_horizon`: the search behind them.

Imports from below: `_checks` alone.
"""

from __future__ import annotations

from robust_filterpy.plants.excitation.signals import (
    bandlimited_pink_autocovariance,
    bandlimited_pink_spectrum,
    prbs,
    receding_horizon_binary,
    sample_autocovariance,
)

__all__ = [
    "bandlimited_pink_autocovariance",
    "bandlimited_pink_spectrum",
    "prbs",
    "receding_horizon_binary",
    "sample_autocovariance",
]
