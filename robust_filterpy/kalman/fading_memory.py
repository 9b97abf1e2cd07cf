"""`filterpy.kalman.fading_memory`, as it is."""

from filterpy.kalman.fading_memory import FadingKalmanFilter as FadingKalmanFilter
