"""`filterpy.kalman.UKF` with ours in place."""

from robust_filterpy.filters.sigma_point import RobustUnscentedKalmanFilter as UnscentedKalmanFilter

__all__ = ["UnscentedKalmanFilter"]
