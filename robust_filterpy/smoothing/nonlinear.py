"""Nonlinear filters: the problem made linear about the smoothed trajectory, again in every sweep.

The unknowns are deviations from a nominal trajectory, by the filter's own difference and sum of states and difference
of measurements, so that angles stay angles. With Jacobians (extended filter) this is the Gauss-Newton method (B. M.
Bell, SIAM Journal on Optimization 4, 1994), with sigma points the iterated posterior linearization smoother (A. F.
Garcia-Fernandez, L. Svensson, S. Sarkka, IEEE Transactions on Signal Processing 65, 2017).
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from filterpy.kalman import CubatureKalmanFilter, ExtendedKalmanFilter, UnscentedKalmanFilter
from filterpy.kalman.CubatureKalmanFilter import spherical_radial_sigmas

from robust_filterpy import _checks
from robust_filterpy._arrays import stack
from robust_filterpy._checks import Array
from robust_filterpy.filters.conversion import robust
from robust_filterpy.filters.driver import columns_of
from robust_filterpy.filters.nonlinear_mixin import covariance, innovation_of
from robust_filterpy.filters.policies import regressed
from robust_filterpy.filters.shell import Shell
from robust_filterpy.smoothing.linear_pass import Model, Recording, Smooth, problem


class Tangent(NamedTuple):
    """A function y = f(x) near x: A dx + value, and the covariance of what that leaves out."""

    value: Array
    A: Array
    rest: Array


def is_nonlinear(kf: Any) -> bool:
    """Return whether a filter is one of those that this file is for."""
    return isinstance(kf, (ExtendedKalmanFilter, UnscentedKalmanFilter, CubatureKalmanFilter))


def nonlinear_trajectory(
    kf: Any, zs: Any, Rs: Any, us: Any, dts: Any, functions: tuple[Any, Any, Any, Any, Callable[..., Any]]
) -> Trajectory:
    """Return where to start smoothing a recording with a nonlinear filter; functions: as `Extended` takes them."""
    zs, us, dts = columns_of({"zs": zs, "us": us, "dts": dts})
    if not len(zs):
        raise ValueError("zs: expected at least one measurement, got none")
    n, m = np.size(kf.x), kf.dim_z if isinstance(kf, ExtendedKalmanFilter) else len(kf.R)
    model: Extended | SigmaPoints
    if isinstance(kf, ExtendedKalmanFilter):
        if not callable(functions[0]) or not callable(functions[1]):
            raise TypeError("HJacobian, Hx: expected the functions that an ExtendedKalmanFilter's update takes")
        model = Extended(kf, zs, Rs, us, functions)
    else:
        model = SigmaPoints(kf, zs, Rs, dts)
    return Trajectory(model, stack("Q", kf.Q, None, None, (n, n)), stack("R", kf.R, Rs, len(zs), (m, m)))


class Trajectory:
    """The nominal trajectory, and the linear problem about it."""

    def __init__(self, model: Extended | SigmaPoints, Q: Array, R: Array) -> None:
        """Start from what a robust filter finds; Q and R have the axis of steps in front."""
        self.model, self.Q, self.R = model, Q, R
        # filterpy's unscented filter hides its dim_x.
        self.prior = _checks.numbers("x", model.kf.x).ravel().copy()
        self.P0 = _checks.matrix("P", model.kf.P, (model.n, model.n), f"dim_x={model.n}")
        means, covariances = model.filtered()
        self.x, self.P = np.vstack([self.prior, means]), np.concatenate([self.P0[None], covariances])

    def recording(self) -> Recording:
        """Return the linear problem of the deviations."""
        model, steps = self.model, len(self.x) - 1
        F, c, Q = np.empty((steps, model.n, model.n)), np.empty((steps, model.n)), np.empty((steps, model.n, model.n))
        H, z, R = np.empty((steps, model.m, model.n)), np.empty((steps, model.m)), np.empty((steps, model.m, model.m))
        for k in range(steps):
            there = model.transition(k, self.x[k], self.P[k])
            F[k], c[k] = there.A, np.ravel(model.residual_x(there.value, self.x[k + 1]))
            Q[k] = self.Q[k % len(self.Q)] + there.rest
            z[k], seen = model.measurement(k, self.x[k + 1], self.P[k + 1])
            H[k], R[k] = seen.A, self.R[k % len(self.R)] + seen.rest
        x0 = np.ravel(model.residual_x(self.prior, self.x[0]))
        return problem(*(a[None] for a in (F, Q, c, H, R, z, x0, self.P0)))

    def advanced(self, smooth: Smooth) -> tuple[Model, Array]:
        """Move to the smoothed states; return the problem about them and by how many standard deviations they moved."""
        step, P = np.vstack([smooth.x0, smooth.x[0]]), np.concatenate([smooth.P0, smooth.P[0]])
        variance = np.diagonal(P, axis1=1, axis2=2)
        moved = np.sqrt(np.mean(step**2 / np.maximum(variance, 1e-12 * variance.max())))
        added = getattr(self.model.kf, "state_add", np.add)
        self.x = np.array([np.ravel(added(x, dx)) for x, dx in zip(self.x, step, strict=True)])
        self.P = P
        return self.recording().model, np.array([moved])


class Extended:
    """An extended Kalman filter with its recording."""

    residual_x: Any = staticmethod(np.subtract)

    def __init__(
        self, kf: Any, zs: Any, Rs: Any, us: Any, functions: tuple[Any, Any, Any, Any, Callable[..., Any]]
    ) -> None:
        """Keep HJacobian, Hx, args, hx_args and residual."""
        self.kf, self.zs, self.Rs, self.us = kf, zs, Rs, us
        self.HJacobian, self.Hx, args, hx_args, self.residual = functions
        self.args, self.hx_args = (a if isinstance(a, tuple) else (a,) for a in (args, hx_args))
        self.n, self.m, self.shape = kf.dim_x, kf.dim_z, np.shape(kf.x)

    def transition(self, k: int, x: Array, P: Array) -> Tangent:
        """Return what predict_x makes of x, and F, which it may set."""
        kf = copy.copy(self.kf)
        kf.x = x.reshape(self.shape)
        kf.predict_x(*(() if self.us[k] is None else (self.us[k],)))
        F = _checks.matrix("F", kf.F, (self.n, self.n), "dim_x")
        return Tangent(np.ravel(kf.x), F, np.zeros((self.n, self.n)))

    def measurement(self, k: int, x: Array, P: Array) -> tuple[Array, Tangent]:
        """Return the residual at x, and Jacobian."""
        x = x.reshape(self.shape)
        H = _checks.numbers("HJacobian", self.HJacobian(x, *self.args)).reshape(-1, self.n)
        at = self.Hx(x, *self.hx_args)
        e = innovation_of(self.zs[k], at, self.m, self.residual, "Hx")[1]
        return e, Tangent(np.ravel(at), H, np.zeros((self.m, self.m)))

    def filtered(self) -> tuple[Array, Array]:
        """Run a robust filter."""
        given = self.zs, self.HJacobian, self.Hx, self.Rs, self.us
        further = {"args": self.args, "hx_args": self.hx_args, "residual": self.residual}
        return _robust_copy(self.kf).batch_filter(*given, **further)  # type: ignore[no-any-return]


class SigmaPoints:
    """An unscented or cubature Kalman filter with its recording."""

    def __init__(self, kf: Any, zs: Any, Rs: Any, dts: Any) -> None:
        """Keep the filter and what it was given."""
        self.kf, self.zs, self.Rs, self.dts = kf, zs, Rs, dts
        self.n, self.m = np.size(kf.x), len(kf.R)
        if hasattr(kf, "points_fn"):
            self.points, self.Wm, self.Wc = kf.points_fn.sigma_points, kf.Wm, kf.Wc
            self.x_mean, self.z_mean, self.residual_x = kf.x_mean, kf.z_mean, kf.residual_x
        else:
            self.points = spherical_radial_sigmas
            self.Wm = self.Wc = np.full(2 * self.n, 0.5 / self.n)
            self.x_mean = self.z_mean = None
            self.residual_x = np.subtract

    def transition(self, k: int, x: Array, P: Array) -> Tangent:
        """Return the regression of fx on x."""
        dt = self.kf._dt if self.dts[k] is None else self.dts[k]
        return self._regression(lambda s: self.kf.fx(s, dt), x, P, self.x_mean, self.residual_x)

    def measurement(self, k: int, x: Array, P: Array) -> tuple[Array, Tangent]:
        """Return the residual at the mean prediction, and the regression of hx on x."""
        seen = self._regression(self.kf.hx, x, P, self.z_mean, self.kf.residual_z)
        return innovation_of(self.zs[k], seen.value, self.m, self.kf.residual_z, "hx")[1], seen

    def filtered(self) -> tuple[Array, Array]:
        """Run a robust filter."""
        return _robust_copy(self.kf).batch_filter(self.zs, self.Rs, self.dts)  # type: ignore[no-any-return]

    def _regression(self, function: Any, x: Array, P: Array, mean: Any, residual: Any) -> Tangent:
        """Return the linear regression of a function on a state with this mean and covariance, by sigma points."""
        # A state that is known exactly has no sigma points; so small a spread shows the derivative.
        P = P + 1e-12 * max(float(np.trace(self.kf.P)), float(np.trace(P)), 1e-12) * np.eye(self.n)
        s = np.asarray(self.points(x, P)).reshape(-1, self.n)
        y = np.array([np.ravel(function(one)) for one in s], dtype=float)
        value = np.ravel(self.Wm @ y if mean is None else mean(y, self.Wm))
        apart = np.array([np.ravel(residual(one, value)) for one in y])
        dx = np.array([np.ravel(self.residual_x(one, x)) for one in s])
        return Tangent(value, *regressed(P, covariance(dx, apart, self.Wc), covariance(apart, apart, self.Wc)))


def _robust_copy(kf: Any) -> Any:
    """Return a robust filter that may be run."""
    return copy.deepcopy(kf) if isinstance(kf, Shell) else robust(kf)
