"""`filterpy.kalman.fixed_lag_smoother` with ours in place."""

from robust_filterpy.smoothing.fixed_lag import FixedLagSmoother

__all__ = ["FixedLagSmoother"]
