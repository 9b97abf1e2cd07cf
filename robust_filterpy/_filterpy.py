"""filterpy's filters, which the robust ones extend; the types of their attributes, which filterpy does not tell, are in
the stub next to this page.
"""

from __future__ import annotations

from filterpy.kalman import (
    CubatureKalmanFilter,
    EnsembleKalmanFilter,
    ExtendedKalmanFilter,
    FixedLagSmoother,
    KalmanFilter,
    UnscentedKalmanFilter,
)

__all__ = [
    "CubatureKalmanFilter", "EnsembleKalmanFilter", "ExtendedKalmanFilter", "FixedLagSmoother", "KalmanFilter",
    "UnscentedKalmanFilter",
]  # fmt: skip
