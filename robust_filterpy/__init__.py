"""Kalman filtering and recursive identification that survive outliers: a plug-in to filterpy.

`RobustKalmanFilter` takes the place of `filterpy.kalman.KalmanFilter`; `ParameterTracker` follows
the parameters of a linear model. Every name is imported when it is first used, so that importing
this package costs no more than importing what is used of it.
"""

from __future__ import annotations

from robust_filterpy._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
