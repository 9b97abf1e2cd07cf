"""Nonlinear filters that survive outliers, in one place: extended, unscented, cubature."""

from __future__ import annotations

from robust_filterpy.extended import RobustExtendedKalmanFilter
from robust_filterpy.sigma_point import RobustCubatureKalmanFilter, RobustUnscentedKalmanFilter

__all__ = ["RobustCubatureKalmanFilter", "RobustExtendedKalmanFilter", "RobustUnscentedKalmanFilter"]
