"""Robust smoothing: all states of a recording from all of its measurements, outliers and jumps distinguished.

* `smoother`: `smooth` for a filter and its recording, `smooth_series` for many series.
* `linear_pass`: from filters and lists to whitened arrays, checked; one weighted pass of a linear smoother.
* `rules`: what is made of the residuals: weights of a psi, or contamination and size of outliers, learned on the way.
* `sweeps`: pass after pass until the estimate stays; what else of a recording may be left out, which reading of it is
  the most probable; whether Q and R fit.
* `nonlinear`: extended, unscented and cubature filters, made linear about the smoothed trajectory.
* `fixed_lag`: the live form.

Imports from below: `influence`, `correction`, `kernel`, `filters`.
"""

from __future__ import annotations

from robust_filterpy.smoothing.fixed_lag import FixedLagSmoother
from robust_filterpy.smoothing.smoother import smooth, smooth_series

__all__ = ["FixedLagSmoother", "smooth", "smooth_series"]
