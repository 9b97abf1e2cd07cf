"""Every name and module of `filterpy.kalman`, with the robust filters in place: one word changes in an import line.

``from filterpy.kalman import KalmanFilter`` becomes ``from robust_filterpy.kalman import KalmanFilter``. Ours are
`KalmanFilter`, `ExtendedKalmanFilter`, `UnscentedKalmanFilter`, `CubatureKalmanFilter`, `EnsembleKalmanFilter`,
`FixedLagSmoother` and the functions `update`, `batch_filter` and `rts_smoother`; the rest is filterpy's, and
takes our filters as its own (`IMMEstimator`, `MMAEFilterBank`, ..). With ``influence=Linear()`` results are filterpy's.

The modules are filterpy's too, so that ``from robust_filterpy.kalman.EKF import ExtendedKalmanFilter`` is ours:
`CubatureKalmanFilter`, `EKF`, `IMM`, `UKF`, `ensemble_kalman_filter`, `fading_memory`, `fixed_lag_smoother`,
`information_filter`, `kalman_filter`, `mmae`, `sigma_points`, `square_root`, `unscented_transform`.
"""

# ruff: noqa: F401, F403
from __future__ import annotations

import filterpy.kalman
from filterpy.kalman import *

# Each by its path: ``from robust_filterpy.kalman import IMM`` would find filterpy's, which is here already.
import robust_filterpy.kalman.fading_memory
import robust_filterpy.kalman.IMM
import robust_filterpy.kalman.information_filter
import robust_filterpy.kalman.mmae
import robust_filterpy.kalman.sigma_points
import robust_filterpy.kalman.square_root
from robust_filterpy.kalman.CubatureKalmanFilter import CubatureKalmanFilter
from robust_filterpy.kalman.EKF import ExtendedKalmanFilter
from robust_filterpy.kalman.ensemble_kalman_filter import EnsembleKalmanFilter
from robust_filterpy.kalman.fixed_lag_smoother import FixedLagSmoother
from robust_filterpy.kalman.kalman_filter import KalmanFilter, batch_filter, predict, rts_smoother, update
from robust_filterpy.kalman.UKF import UnscentedKalmanFilter
from robust_filterpy.kalman.unscented_transform import unscented_transform

__all__ = [name for name in dir(filterpy.kalman) if not name.startswith("_")]
