"""Kalman filtering and recursive identification that survive outliers: a plug-in to filterpy.

`RobustKalmanFilter` takes the place of `filterpy.kalman.KalmanFilter`; `ParameterTracker` follows
the parameters of a linear model. Everything but the filter itself is imported when it is first used,
so that importing this package costs little more than importing `filterpy.kalman`.
"""

from __future__ import annotations

import importlib
from typing import Any

from robust_filterpy._version import __version__
from robust_filterpy.influence import Hampel, Huber, Linear, StudentT, TukeyBiweight
from robust_filterpy.kalman_filter import RobustKalmanFilter

_LAZY = {
    "ARMAX": "identification",
    "ARX": "identification",
    "FIR": "identification",
    "LinearRegression": "identification",
    "OutputError": "identification",
    "ParameterTracker": "identification",
    "TrackerBank": "identification",
    "RobustExtendedKalmanFilter": "nonlinear",
    "RobustUnscentedKalmanFilter": "nonlinear",
    "RobustCubatureKalmanFilter": "nonlinear",
    "ContaminatedScore": "score",
    "NoiseMatchedKalmanFilter": "process",
    "RecoveringKalmanFilter": "recovery",
    "TwoSidedKalmanFilter": "two_sided",
    "FilterBank": "bank",
    "filter_series": "series",
    "smooth_series": "series",
    "diagnose": "diagnostics",
    "estimate_noise": "estimation",
}
__all__ = [
    "Hampel",
    "Huber",
    "Linear",
    "RobustKalmanFilter",
    "StudentT",
    "TukeyBiweight",
    "__version__",
    *_LAZY,
]


def __getattr__(name: str) -> Any:
    """Import a name of another module when it is first asked for (PEP 562)."""
    if name in _LAZY:
        return getattr(importlib.import_module(f"{__name__}.{_LAZY[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the lazily imported names too."""
    return sorted({*globals(), *__all__})
