"""`filterpy.kalman.EKF` with ours in place."""

from robust_filterpy.filters.extended import RobustExtendedKalmanFilter as ExtendedKalmanFilter

__all__ = ["ExtendedKalmanFilter"]
