"""filterpy's filters with a bounded correction: thin shells around `robust_filterpy.correction`.

* `kalman`: `RobustKalmanFilter`.
* `extended`, `sigma_point`: nonlinear filters.
* `recovering`, `recovering_nonlinear`: a redescending psi that comes back after a jump.
* `gaussian_sum`: noise that is a known mixture.
* `multiple_model`: outliers in the process as well as in the measurement.
* `adaptive`, `adaptive_nonlinear`: noises that are learnt.
* `ensemble`: the ensemble Kalman filter.
* `functions`: filterpy's functions update, predict, batch_filter, rts_smoother.
* `conversion`: a robust filter made of an existing one.

Imports from below: `influence`, `correction`, `compiled`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from robust_filterpy.filters._outlier_share import OutlierShareWarning
from robust_filterpy.filters.kalman import RobustKalmanFilter

if TYPE_CHECKING:
    from robust_filterpy.filters.adaptive import AdaptiveKalmanFilter
    from robust_filterpy.filters.adaptive_nonlinear import (
        AdaptiveCubatureKalmanFilter,
        AdaptiveExtendedKalmanFilter,
        AdaptiveUnscentedKalmanFilter,
    )
    from robust_filterpy.filters.conversion import robust
    from robust_filterpy.filters.ensemble import RobustEnsembleKalmanFilter
    from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
    from robust_filterpy.filters.gaussian_sum import NoiseMatchedKalmanFilter
    from robust_filterpy.filters.multiple_model import TwoSidedKalmanFilter
    from robust_filterpy.filters.recovering import RecoveringKalmanFilter
    from robust_filterpy.filters.recovering_nonlinear import (
        RecoveringCubatureKalmanFilter,
        RecoveringExtendedKalmanFilter,
        RecoveringUnscentedKalmanFilter,
    )
    from robust_filterpy.filters.sigma_point import RobustCubatureKalmanFilter, RobustUnscentedKalmanFilter

_LAZY = {
    "AdaptiveCubatureKalmanFilter": "adaptive_nonlinear",
    "AdaptiveExtendedKalmanFilter": "adaptive_nonlinear",
    "AdaptiveKalmanFilter": "adaptive",
    "AdaptiveUnscentedKalmanFilter": "adaptive_nonlinear",
    "NoiseMatchedKalmanFilter": "gaussian_sum",
    "RecoveringCubatureKalmanFilter": "recovering_nonlinear",
    "RecoveringExtendedKalmanFilter": "recovering_nonlinear",
    "RecoveringKalmanFilter": "recovering",
    "RecoveringUnscentedKalmanFilter": "recovering_nonlinear",
    "RobustCubatureKalmanFilter": "sigma_point",
    "RobustEnsembleKalmanFilter": "ensemble",
    "RobustExtendedKalmanFilter": "extended",
    "RobustUnscentedKalmanFilter": "sigma_point",
    "TwoSidedKalmanFilter": "multiple_model",
    "robust": "conversion",
}
__all__ = [
    "AdaptiveCubatureKalmanFilter",
    "AdaptiveExtendedKalmanFilter",
    "AdaptiveKalmanFilter",
    "AdaptiveUnscentedKalmanFilter",
    "NoiseMatchedKalmanFilter",
    "OutlierShareWarning",
    "RecoveringCubatureKalmanFilter",
    "RecoveringExtendedKalmanFilter",
    "RecoveringKalmanFilter",
    "RecoveringUnscentedKalmanFilter",
    "RobustCubatureKalmanFilter",
    "RobustEnsembleKalmanFilter",
    "RobustExtendedKalmanFilter",
    "RobustKalmanFilter",
    "RobustUnscentedKalmanFilter",
    "TwoSidedKalmanFilter",
    "robust",
]


# Type checkers know the names from above, and that there are no others.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Import a filter when it is first asked for, so that `RobustKalmanFilter` alone stays quick to import."""
        if name in _LAZY:
            return getattr(importlib.import_module(f"{__name__}.{_LAZY[name]}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
