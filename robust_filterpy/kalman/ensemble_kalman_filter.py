"""`filterpy.kalman.ensemble_kalman_filter` with ours in place."""

from robust_filterpy.filters.ensemble import RobustEnsembleKalmanFilter as EnsembleKalmanFilter

__all__ = ["EnsembleKalmanFilter"]
