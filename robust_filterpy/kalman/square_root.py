"""`filterpy.kalman.square_root`, as it is."""

from filterpy.kalman.square_root import SquareRootKalmanFilter as SquareRootKalmanFilter
