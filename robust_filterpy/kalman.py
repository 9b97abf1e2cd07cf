"""Every name of `filterpy.kalman`, with the robust filters in place: one word changes in an import line.

``from filterpy.kalman import KalmanFilter`` becomes ``from robust_filterpy.kalman import KalmanFilter``. Ours are
`KalmanFilter`, `ExtendedKalmanFilter`, `UnscentedKalmanFilter`, `CubatureKalmanFilter`, `EnsembleKalmanFilter`,
`FixedLagSmoother` and the functions `update`, `predict`, `batch_filter` and `rts_smoother`; the rest is filterpy's, and
takes our filters as its own (`IMMEstimator`, `MMAEFilterBank`, ..). With ``influence=Linear()`` results are filterpy's.
"""

# ruff: noqa: F401, F403
from __future__ import annotations

import filterpy.kalman
from filterpy.kalman import *

from robust_filterpy.filters.ensemble import RobustEnsembleKalmanFilter as EnsembleKalmanFilter
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter as ExtendedKalmanFilter
from robust_filterpy.filters.functions import batch_filter, predict, rts_smoother, update
from robust_filterpy.filters.kalman import RobustKalmanFilter as KalmanFilter
from robust_filterpy.filters.sigma_point import RobustCubatureKalmanFilter as CubatureKalmanFilter
from robust_filterpy.filters.sigma_point import RobustUnscentedKalmanFilter as UnscentedKalmanFilter
from robust_filterpy.smoothing.fixed_lag import FixedLagSmoother

__all__ = [name for name in dir(filterpy.kalman) if not name.startswith("_")]
