"""`filterpy.kalman.kalman_filter` with ours in place."""

from filterpy.kalman.kalman_filter import predict as predict
from filterpy.kalman.kalman_filter import predict_steadystate as predict_steadystate
from filterpy.kalman.kalman_filter import update_steadystate as update_steadystate

from robust_filterpy.filters.conversion import batch_filter, rts_smoother, update
from robust_filterpy.filters.kalman import RobustKalmanFilter as KalmanFilter

__all__ = [
    "KalmanFilter", "batch_filter", "predict", "predict_steadystate", "rts_smoother", "update", "update_steadystate",
]  # fmt: skip
