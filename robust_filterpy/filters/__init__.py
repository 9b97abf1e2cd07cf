"""filterpy's filters with a bounded correction: thin shells around `robust_filterpy.correction`.

* `kalman`: `RobustKalmanFilter`.
* `extended`, `sigma_point`: nonlinear filters.
* `recovering`, `recovering_nonlinear`: a redescending psi that comes back after a jump.
* `gaussian_sum`: noise that is a known mixture.
* `multiple_model`: outliers in the process as well as in the measurement.
* `adaptive`, `adaptive_nonlinear`: noises that are learnt.
* `ensemble`: the ensemble Kalman filter.
* `functions`: filterpy's functions update, predict, batch_filter, rts_smoother.
* `conversion`: a robust filter made of an existing one.

Each is imported when it is first used. Imports from below: `influence`, `correction`, `kernel`.
"""

from __future__ import annotations

from robust_filterpy._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
