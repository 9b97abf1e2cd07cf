"""Kalman filtering and recursive identification that survive outliers: a plug-in to filterpy.

`RobustKalmanFilter` takes the place of `filterpy.kalman.KalmanFilter`; `ParameterTracker` follows
the parameters of a linear model. Everything but the filter itself is imported when it is first used,
so that importing this package costs little more than importing `filterpy.kalman`.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from robust_filterpy._version import __version__
from robust_filterpy.filters._outlier_share import OutlierShareWarning
from robust_filterpy.filters.kalman import RobustKalmanFilter
from robust_filterpy.influence import Hampel, Huber, Linear, StudentT, TukeyBiweight

if TYPE_CHECKING:
    from robust_filterpy.batch import FilterBank, adaptive_series, filter_series
    from robust_filterpy.correction.mixture import ContaminatedScore
    from robust_filterpy.diagnostics import diagnose
    from robust_filterpy.edge import export_c
    from robust_filterpy.filters import (
        AdaptiveCubatureKalmanFilter,
        AdaptiveExtendedKalmanFilter,
        AdaptiveKalmanFilter,
        AdaptiveUnscentedKalmanFilter,
        NoiseMatchedKalmanFilter,
        RecoveringCubatureKalmanFilter,
        RecoveringExtendedKalmanFilter,
        RecoveringKalmanFilter,
        RecoveringUnscentedKalmanFilter,
        RobustCubatureKalmanFilter,
        RobustExtendedKalmanFilter,
        RobustUnscentedKalmanFilter,
        TwoSidedKalmanFilter,
        robust,
    )
    from robust_filterpy.identification import (
        AR,
        ARMA,
        ARMAX,
        ARX,
        FIR,
        BoxJenkins,
        LinearRegression,
        Model,
        OutputError,
        ParameterTracker,
        TrackerBank,
        compare,
        select_structure,
        validate,
    )
    from robust_filterpy.identification.identify import identify
    from robust_filterpy.noise import estimate_noise, tune
    from robust_filterpy.smoothing import smooth, smooth_series

_LAZY = {
    "AR": "identification",
    "ARMA": "identification",
    "ARMAX": "identification",
    "ARX": "identification",
    "AdaptiveCubatureKalmanFilter": "filters",
    "AdaptiveExtendedKalmanFilter": "filters",
    "AdaptiveKalmanFilter": "filters",
    "AdaptiveUnscentedKalmanFilter": "filters",
    "BoxJenkins": "identification",
    "ContaminatedScore": "correction.mixture",
    "FIR": "identification",
    "FilterBank": "batch",
    "LinearRegression": "identification",
    "Model": "identification",
    "NoiseMatchedKalmanFilter": "filters",
    "OutputError": "identification",
    "ParameterTracker": "identification",
    "RecoveringCubatureKalmanFilter": "filters",
    "RecoveringExtendedKalmanFilter": "filters",
    "RecoveringKalmanFilter": "filters",
    "RecoveringUnscentedKalmanFilter": "filters",
    "RobustCubatureKalmanFilter": "filters",
    "RobustExtendedKalmanFilter": "filters",
    "RobustUnscentedKalmanFilter": "filters",
    "TrackerBank": "identification",
    "TwoSidedKalmanFilter": "filters",
    "adaptive_series": "batch",
    "compare": "identification",
    "diagnose": "diagnostics",
    "estimate_noise": "noise",
    "export_c": "edge",
    "filter_series": "batch",
    "identify": "identification",
    "robust": "filters",
    "select_structure": "identification",
    "smooth": "smoothing",
    "smooth_series": "smoothing",
    "tune": "noise",
    "validate": "identification",
}
__all__ = [
    "AR",
    "ARMA",
    "ARMAX",
    "ARX",
    "FIR",
    "AdaptiveCubatureKalmanFilter",
    "AdaptiveExtendedKalmanFilter",
    "AdaptiveKalmanFilter",
    "AdaptiveUnscentedKalmanFilter",
    "BoxJenkins",
    "ContaminatedScore",
    "FilterBank",
    "Hampel",
    "Huber",
    "Linear",
    "LinearRegression",
    "Model",
    "NoiseMatchedKalmanFilter",
    "OutlierShareWarning",
    "OutputError",
    "ParameterTracker",
    "RecoveringCubatureKalmanFilter",
    "RecoveringExtendedKalmanFilter",
    "RecoveringKalmanFilter",
    "RecoveringUnscentedKalmanFilter",
    "RobustCubatureKalmanFilter",
    "RobustExtendedKalmanFilter",
    "RobustKalmanFilter",
    "RobustUnscentedKalmanFilter",
    "StudentT",
    "TrackerBank",
    "TukeyBiweight",
    "TwoSidedKalmanFilter",
    "__version__",
    "adaptive_series",
    "compare",
    "diagnose",
    "estimate_noise",
    "export_c",
    "filter_series",
    "identify",
    "robust",
    "select_structure",
    "smooth",
    "smooth_series",
    "tune",
    "validate",
]


# Type checkers know the names from above, and that there are no others.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        """Import a name of another module when it is first asked for (PEP 562)."""
        if name in _LAZY:
            return getattr(importlib.import_module(f"{__name__}.{_LAZY[name]}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the lazily imported names too."""
    return sorted({*globals(), *__all__})
