"""filterpy's filters with a bounded correction: thin shells around `robust_filterpy.correction`.

* `kalman`: `RobustKalmanFilter`.
* `extended`, `sigma_point`: nonlinear filters.
* `policies`: what judges measurements: psi , or noise given or learned, in several
  models of the state.
* `series`: `filter_series`, many recordings, the noise of each learned on request.
* `driver`: many steps, by the kernel where it serves, else by the definition.
* `ensemble`: the ensemble Kalman filter.
* `conversion`: code of filterpy's made robust: `robust`; `AdaptiveKalmanFilter`, which learns the noises; filterpy's
  functions update, predict, batch_filter, rts_smoother.
* `shell`, `nonlinear_mixin`: what these classes share: options, steps by the kernel, what a correction shows.
* `states`: what a filter holds and has learned, put away and taken up again.
* `problem`: a recording of a linear filter, read once, and `batch_filter`.
* `snapshot`: a call that is refused has not happened.
* `notices`: what a filter says once.

Each is imported when it is first used. Imports from below: `influence`, `correction`, `kernel`.
"""

from __future__ import annotations

from robust_filterpy._lazy import attach

__getattr__, __dir__, __all__ = attach(__name__, __file__)
