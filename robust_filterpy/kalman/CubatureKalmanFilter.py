"""`filterpy.kalman.CubatureKalmanFilter` with the robust filter in place."""

from filterpy.kalman.CubatureKalmanFilter import ckf_transform as ckf_transform
from filterpy.kalman.CubatureKalmanFilter import spherical_radial_sigmas as spherical_radial_sigmas

from robust_filterpy.filters.sigma_point import RobustCubatureKalmanFilter as CubatureKalmanFilter

__all__ = ["CubatureKalmanFilter", "ckf_transform", "spherical_radial_sigmas"]
