"""Sigma points and their moments, as filterpy makes them, without a loop over the points where nobody asks for one."""

from __future__ import annotations

from typing import Any

import numpy as np
from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter, unscented_transform

from robust_filterpy._checks import FLOAT, Array

__all__ = ["REDRAWS", "covariance", "drawn", "transformed"]

#: Whether the installed filterpy draws new points from the predicted covariance for the correction; 1.4.5 does not.
REDRAWS = "sigma_points" in UnscentedKalmanFilter.predict.__code__.co_names


def drawn(points: Any, x: Array, P: Array) -> Array:
    """Return the sigma points of a state, shape (2 n + 1, n)."""
    plain = type(points) is MerweScaledSigmaPoints and points.subtract is np.subtract
    if not (plain and type(x) is np.ndarray and x.dtype == FLOAT and x.shape == (points.n,)):
        return points.sigma_points(x, P)  # type: ignore[no-any-return]
    n = points.n
    U = points.sqrt((points.alpha**2 * (n + points.kappa) - n + n) * P)
    found = np.empty((2 * n + 1, n))
    found[0] = x
    np.add(x, U, out=found[1 : n + 1])
    np.subtract(x, U, out=found[n + 1 :])
    return found


def transformed(
    sigmas: Array, Wm: Array, Wc: Array, noise: Any, mean: Any = None, residual: Any = None
) -> tuple[Array, Array]:
    """Return mean and covariance of points, the latter symmetric to the last bit and with that of the noise."""
    if mean is None and (residual is None or residual is np.subtract):
        x = Wm.dot(sigmas)
        P = covariance(sigmas - x, sigmas - x, Wc) + noise
    else:
        x, P = unscented_transform(sigmas, Wm, Wc, noise, mean, residual)
    # From nearby points with large weights of both signs rounding may leave much, which the kernel would decline.
    return x, 0.5 * (P + P.T)


def covariance(dx: Array, dz: Array, Wc: Array) -> Array:
    """Return sum W_i dx_i dz_i' of differences, one a row."""
    return np.asarray((dx * Wc[:, None]).T.dot(dz))
