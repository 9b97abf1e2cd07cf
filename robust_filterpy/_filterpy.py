"""filterpy's filters, which the robust ones extend; the types of their attributes, which filterpy does not tell, are in
the stub next to this page.
"""

from __future__ import annotations

from filterpy.kalman import CubatureKalmanFilter as CubatureKalmanFilter
from filterpy.kalman import EnsembleKalmanFilter as EnsembleKalmanFilter
from filterpy.kalman import ExtendedKalmanFilter as ExtendedKalmanFilter
from filterpy.kalman import FixedLagSmoother as FixedLagSmoother
from filterpy.kalman import KalmanFilter as KalmanFilter
from filterpy.kalman import UnscentedKalmanFilter as UnscentedKalmanFilter
