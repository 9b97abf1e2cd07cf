"""Inputs with a prescribed spectrum.

* `signals`: band-limited 1/f noise, binary signals with a prescribed autocovariance (paper 54-57).

Imports from below: `_checks` alone.
"""

from __future__ import annotations

from robust_filterpy._lazy import elsewhere
from robust_filterpy.plants.excitation.signals import bandlimited_pink_autocovariance, prbs, receding_horizon_binary

__all__ = ["bandlimited_pink_autocovariance", "prbs", "receding_horizon_binary"]

__getattr__ = elsewhere(__name__)
