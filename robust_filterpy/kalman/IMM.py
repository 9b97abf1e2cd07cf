"""`filterpy.kalman.IMM`, as it is."""

from filterpy.kalman.IMM import IMMEstimator as IMMEstimator
