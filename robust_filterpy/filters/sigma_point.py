"""The sigma-point filters of filterpy, unscented and cubature, with a bounded correction."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from filterpy.kalman.CubatureKalmanFilter import spherical_radial_sigmas
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._arrays import noise_covariance, process_noise
from robust_filterpy._checks import FLOAT, Array
from robust_filterpy._filterpy import CubatureKalmanFilter, UnscentedKalmanFilter
from robust_filterpy.filters.nonlinear_mixin import (
    REDRAWS,
    NonlinearFilterMixin,
    covariance,
    drawn,
    require_finite,
    transformed,
)
from robust_filterpy.filters.policies import Options, with_options
from robust_filterpy.filters.snapshot import unchanged_if_refused, whole

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["RobustCubatureKalmanFilter", "RobustUnscentedKalmanFilter"]


class _SigmaPoint(NonlinearFilterMixin):
    """Correct by the moments of sigma points."""

    sigmas_h: Array
    # Between a prediction and its correction the sigma points are what the correction needs.
    _settings = {"Q": "Q", "R": "R", "sigmas_f": "sigmas_f"}

    def _correct(self, z: Any, sigmas_h: Array, zp: Any, C: Array, S: Array, R: Array, residual: Any) -> None:
        """Correct by a whole measurement; every check comes before the first assignment."""
        add = getattr(self, "state_add", np.add)
        taken = residual is np.subtract and add is np.add and self._stepped(z, zp, None, C, S, R)
        if not taken:
            require_finite(hx=sigmas_h, S=S, C=C)
            taken = self._correct_by_moments("hx", z, zp, C, S, R, residual, add)
        if taken:
            self.sigmas_h = sigmas_h


class RobustUnscentedKalmanFilter(_SigmaPoint, UnscentedKalmanFilter):
    """Filter like `filterpy.kalman.UnscentedKalmanFilter`, without believing outliers.

    Every attribute, method and shape is filterpy's; the correction is that of `robust_filterpy.RobustKalmanFilter`
    with the moments that the sigma points give: C = cov(x, z), S = cov(z)::

        x+ = x + C T' psi(T y),    P+ = P - C T' D T C'

    Parameters
    ----------
    dim_x : int
        Length of the state, >= 1.
    dim_z : int
        Length of the measurement, >= 1.
    dt : float
        Time between steps, handed to fx.
    hx : callable
        ``hx(x, **hx_args)`` returns the measurement that belongs to x, shape (dim_z,).
    fx : callable
        ``fx(x, dt, **fx_args)`` returns the next state, shape (dim_x,).
    points : object
        Sigma points, such as `filterpy.kalman.MerweScaledSigmaPoints`.
    sqrt_fn, x_mean_fn, z_mean_fn, residual_x, residual_z : callable, optional
        As in filterpy.
    state_add : callable, optional
        ``state_add(x, dx)`` moves a state (angles); with filterpy 1.4.5 too.
    influence : Influence, default Huber(1.345)
        psi, as in `RobustKalmanFilter`.
    scaling : {"learnt", "innovation", "unit", "bounded"}, optional
        T, as in `RobustKalmanFilter`.
    information : {"realized", "expected", "weight"}
        D, as in `RobustKalmanFilter`.
    grouping : {"component", "joint"} or tuple of tuple of int
        psi of each component of e, or of the length of e.
    noise, process, patience : optional
        As in `RobustKalmanFilter`; the models of `process` go on by the line through the sigma points.

    Attributes
    ----------
    weights, clipped, e, T, y_bounded : ndarray
        What the last correction did, as in `RobustKalmanFilter`.

    Raises
    ------
    ValueError
        If a dimension or an option is out of range. A call that is refused changes nothing.

    Notes
    -----
    NaN in z is a missing component; residual_z never sees it.

    Under ``noise=`` the part of S that no line explains (the measurement is curved) counts as uncertainty of the state
    and not as noise, of which R knows nothing. Where a jump is believed, P is widened. The sigma points of a
    widened P lie several times as far out as the jump: where the measurement is an angle that turns right round over
    such a distance, choose points that lie closer (a small alpha).

    `predict` is that of the installed filterpy: 2.0.0 draws new sigma points from the predicted covariance for the
    correction, 1.4.5 uses the propagated ones, without Q.

    Examples
    --------
    >>> import numpy as np
    >>> from filterpy.kalman import MerweScaledSigmaPoints
    >>> from robust_filterpy.filters.sigma_point import RobustUnscentedKalmanFilter
    >>> kf = RobustUnscentedKalmanFilter(
    ...     1, 1, dt=1.0, hx=lambda x: x**2, fx=lambda x, dt: x, points=MerweScaledSigmaPoints(1, 0.5, 2.0, 2.0)
    ... )
    >>> kf.x, kf.P = np.array([1.0]), 0.1 * np.eye(1)
    >>> kf.Q = 0.01 * np.eye(1)
    >>> for z in [1.1, 0.9, 1e6, 1.0]:
    ...     kf.predict()
    ...     kf.update(z)
    >>> bool(abs(kf.x[0] - 1.0) < 0.5)
    True
    """

    @with_options
    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dt: float,
        hx: Callable[..., ArrayLike],
        fx: Callable[..., ArrayLike],
        points: Any,
        sqrt_fn: Any = None,
        x_mean_fn: Any = None,
        z_mean_fn: Any = None,
        residual_x: Any = None,
        residual_z: Any = None,
        state_add: Any = None,
        **options: Unpack[Options],
    ) -> None:
        """Set up filterpy's attributes and the choices."""
        self._set_policy(options, dim_x=dim_x, dim_z=dim_z)
        # Robust's attributes ask for dim_z before filterpy's constructor has run.
        self._dim_x, self._dim_z = dim_x, dim_z
        super().__init__(dim_x, dim_z, dt, hx, fx, points, sqrt_fn, x_mean_fn, z_mean_fn, residual_x, residual_z)
        self.state_add = np.add if state_add is None else state_add
        self._start()

    @property
    def dim_x(self) -> int:  # type: ignore[override]
        """Length of the state."""
        return self._dim_x

    @property
    def dim_z(self) -> int:  # type: ignore[override]
        """Length of the measurement."""
        return self._dim_z

    @whole
    def predict(
        self,
        dt: float | None = None,
        UT: Callable[..., Any] | None = None,
        fx: Callable[..., ArrayLike] | None = None,
        **fx_args: Any,
    ) -> None:
        """Predict the next state, as filterpy does.

        Parameters
        ----------
        dt : float, optional
            Time step for this call.
        UT : callable, optional
            Unscented transform for this call.
        fx : callable, optional
            State transition for this call.
        **fx_args : dict
            Further arguments of fx.

        Raises
        ------
        ValueError
            If Q is negative or not symmetric or the prediction not finite; nothing has changed then.
        LinAlgError
            If P is not positive definite; nothing has changed then.
        """
        Q, before = process_noise(self.Q, None, self.dim_x), self._current()
        points = self.compute_process_sigmas(self._dt if dt is None else dt, fx, **fx_args)
        make = transformed if UT is None else UT
        x, P = make(self.sigmas_f, self.Wm, self.Wc, self.Q, self.x_mean, self.residual_x)
        require_finite(x=x, P=P)
        if before is None:
            self.x, self.P = x, P
        else:
            if points is None:
                points = drawn(self.points_fn, before.x, before.P)
            dx, moved = (
                where - mean if self.residual_x is np.subtract else
                np.array([self.residual_x(point, mean) for point in where])
                for where, mean in ((points, before.x), (self.sigmas_f, x))
            )
            self._move(before, dx, moved, self.Wc, x, P, Q)
        if REDRAWS:
            self.sigmas_f = drawn(self.points_fn, self.x, self.P)
        self.x_prior, self.P_prior = np.copy(self.x), np.copy(self.P)

    def compute_process_sigmas(  # type: ignore[override]
        self, dt: float, fx: Callable[..., ArrayLike] | None = None, **fx_args: Any
    ) -> Array | None:
        """Move the sigma points of the state; also before another `update` without a prediction, as with filterpy.

        Parameters
        ----------
        dt : float
            Time step.
        fx : callable, optional
            State transition for this call.
        **fx_args : dict
            Further arguments of fx.

        Returns
        -------
        ndarray, shape (points, dim_x)
            Where they were; a subclass may return None, as filterpy does.
        """
        fx, points = self.fx if fx is None else fx, drawn(self.points_fn, self.x, self.P)
        # A user's function may write into what it gets.
        for i, s in enumerate(points.copy()):
            self.sigmas_f[i] = fx(s, dt, **fx_args)
        return points

    def cross_variance(self, x: Array, z: Array, sigmas_f: Array, sigmas_h: Array) -> Array:
        """Return the covariance of state and measurement, shape (dim_x, dim_z).

        Parameters
        ----------
        x, z : ndarray, shape (dim_x,), (dim_z,)
            Their means.
        sigmas_f, sigmas_h : ndarray, shape (points, dim_x), (points, dim_z)
            Sigma points of both.
        """
        if self.residual_x is np.subtract and self.residual_z is np.subtract:
            return covariance(sigmas_f - x, sigmas_h - z, self.Wc)
        cross: Array = super().cross_variance(x, z, sigmas_f, sigmas_h)
        return cross

    @whole
    def update(
        self,
        z: ArrayLike | None,
        R: Any = None,
        UT: Callable[..., Any] | None = None,
        hx: Callable[..., ArrayLike] | None = None,
        **hx_args: Any,
    ) -> None:
        """Correct the state by a measurement whose influence is bounded.

        Parameters
        ----------
        z : array_like, shape (dim_z,), or scalar, or None
            Measurement; NaN marks a missing component, None a missing measurement.
        R : array_like, shape (dim_z, dim_z), or scalar, optional
            Noise covariance for this call, otherwise ``self.R``. A scalar here means R I.
        UT : callable, optional
            Unscented transform for this call.
        hx : callable, optional
            Measurement function for this call; z and R have the length of what it returns.
        **hx_args : dict
            Further arguments of hx. ``sensor=``, a name or a number, tells whose reading it is, where several sensors
            take turns, as in `RobustKalmanFilter.update`; hx has it, too, if it takes an argument of that name.

        Raises
        ------
        ValueError, TypeError
            If a shape does not fit, z is infinite or R not positive definite; nothing has changed then.
        SingularInnovationError, NotPositiveDefiniteError
            As in `RobustKalmanFilter.update`.
        """
        hx = self.hx if hx is None else hx
        if "sensor" in hx_args:
            sensor, takes = hx_args["sensor"], _checks.takes(hx, "sensor")
            handed = hx_args if takes else {name: value for name, value in hx_args.items() if name != "sensor"}
            if not takes or isinstance(sensor, (str, int)):
                self._spoken(sensor, lambda: self._update(z, R, UT, hx, handed))
                return
        self._update(z, R, UT, hx, hx_args)

    def _update(self, z: Any, R: Any, UT: Callable[..., Any] | None, hx: Callable[..., Any], hx_args: Any) -> None:
        """Correct by one sensor."""
        if z is None:
            self._skip()
            return
        sigmas_h = _rows("hx", [hx(s.copy(), **hx_args) for s in self.sigmas_f])
        R = noise_covariance(self.R, R, sigmas_h.shape[1])
        make = transformed if UT is None else UT
        zp, S = make(sigmas_h, self.Wm, self.Wc, R, self.z_mean, self.residual_z)
        C = self.cross_variance(self.x, zp, self.sigmas_f, sigmas_h)
        self._correct(z, sigmas_h, zp, C, S, R, self.residual_z)

    def batch_filter(
        self, zs: Any, Rs: Any = None, dts: Any = None, UT: Callable[..., Any] | None = None, saver: Any = None
    ) -> tuple[Array, Array]:
        """Filter a whole recording: predict and update for each measurement.

        Parameters
        ----------
        zs : sequence of length N
            Measurements as `update` takes them: numbers, arrays, rows with NaN, None.
        Rs : sequence of length N, optional
            Noise covariance of each step.
        dts : sequence of length N, or float, optional
            Time before each step.
        UT : callable, optional
            Unscented transform.
        saver : filterpy.common.Saver, optional
            Its ``save()`` is called after each step.

        Returns
        -------
        means : ndarray, shape (N, dim_x)
            Corrected states.
        covariances : ndarray, shape (N, dim_x, dim_x)
            Their covariances.

        Raises
        ------
        ValueError, LinAlgError
            As in `predict` and `update`, with the step named; the filter is then as it was before the call.
        """

        def step(z: Any, R: Any, dt: Any) -> None:
            self.predict(dt=dt, UT=UT)
            self.update(z, R, UT=UT)

        return self._filtered(zs, {"Rs": Rs, "dts": dts}, step, saver)


class RobustCubatureKalmanFilter(_SigmaPoint, CubatureKalmanFilter):
    """Filter like `filterpy.kalman.CubatureKalmanFilter`, without believing outliers.

    Parameters
    ----------
    dim_x : int
        Length of the state, >= 1.
    dim_z : int
        Length of the measurement, >= 1.
    dt : float
        Time between steps, handed to fx.
    hx : callable
        ``hx(x, *hx_args)`` returns the measurement that belongs to x, shape (dim_z,).
    fx : callable
        ``fx(x, dt, *fx_args)`` returns the next state, shape (dim_x,).
    x_mean_fn, z_mean_fn, residual_x, residual_z : callable, optional
        As in filterpy.
    influence : Influence, default Huber(1.345)
        psi, as in `RobustKalmanFilter`.
    scaling : {"learnt", "innovation", "unit", "bounded"}, optional
        T, as in `RobustKalmanFilter`.
    information : {"realized", "expected", "weight"}
        D, as in `RobustKalmanFilter`.
    grouping : {"component", "joint"} or tuple of tuple of int
        psi of each component of e, or of the length of e.
    noise, process, patience : optional
        As in `RobustKalmanFilter`; the models of `process` go on by the line through the sigma points.

    Raises
    ------
    ValueError
        If a dimension or an option is out of range. A call that is refused changes nothing.

    Notes
    -----
    filterpy's `predict` turns x into a column; z may stay a row here.
    """

    @with_options
    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dt: float,
        hx: Callable[..., ArrayLike],
        fx: Callable[..., ArrayLike],
        x_mean_fn: Any = None,
        z_mean_fn: Any = None,
        residual_x: Any = None,
        residual_z: Any = None,
        **options: Unpack[Options],
    ) -> None:
        """Set up filterpy's attributes and the choices."""
        self._set_policy(options, dim_x=dim_x, dim_z=dim_z)
        super().__init__(dim_x, dim_z, dt, hx, fx, x_mean_fn, z_mean_fn, residual_x, residual_z)
        self.inv = np.linalg.inv
        # filterpy starts with y = 0 and K = 0, scalars that change their shape at the first update.
        self.y, self.K = np.zeros(dim_z), np.zeros((dim_x, dim_z))
        self._start()

    def predict(self, dt: float | None = None, fx_args: Any = ()) -> None:
        """Predict the next state, as filterpy does.

        Parameters
        ----------
        dt : float, optional
            Time step for this call.
        fx_args : tuple
            Further arguments of fx.

        Raises
        ------
        ValueError
            If Q is negative or not symmetric or the prediction not finite; nothing has changed then.
        LinAlgError
            If P is not positive definite; nothing has changed then.
        """
        with unchanged_if_refused(self):
            Q, before = process_noise(self.Q, None, self.dim_x), self._current()
            arguments = fx_args if isinstance(fx_args, tuple) else (fx_args,)
            points = spherical_radial_sigmas(np.asarray(self.x), self.P)
            # A user's function may write into what it gets.
            for k, point in enumerate(points.copy()):
                self.sigmas_f[k] = self.fx(point, self._dt if dt is None else dt, *arguments)
            weights = np.full(len(points), 1.0 / len(points))
            x, P = transformed(self.sigmas_f, weights, weights, self.Q)
            require_finite(x=x, P=P)
            self.x, self.P = x[:, None], P
            if before is not None:
                self._move(before, points - before.x, self.sigmas_f - x, weights, self.x, P, Q)
            self.x_prior, self.P_prior = self.x.copy(), self.P.copy()

    def update(self, z: ArrayLike | None, R: Any = None, hx_args: Any = (), *, sensor: str | int | None = None) -> None:
        """Correct the state by a measurement whose influence is bounded.

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement; NaN marks a missing component, None a missing measurement.
        R : array_like, shape (dim_z, dim_z), or scalar, optional
            Noise covariance for this call, otherwise ``self.R``. A scalar here means R I.
        hx_args : tuple
            Further arguments of hx.
        sensor : str or int, optional
            Whose reading it is, where several sensors take turns, as in `RobustKalmanFilter.update`; else its place in
            z tells.

        Raises
        ------
        ValueError, TypeError
            If a shape does not fit, z is infinite or R not positive definite; nothing has changed then.
        SingularInnovationError, NotPositiveDefiniteError
            As in `RobustKalmanFilter.update`.
        """
        if sensor is not None:
            self._spoken(sensor, lambda: RobustCubatureKalmanFilter.update(self, z, R, hx_args))
            return
        if z is None:
            self._skip()
            return
        arguments = hx_args if isinstance(hx_args, tuple) else (hx_args,)
        with unchanged_if_refused(self):
            sigmas_h = _rows("hx", [self.hx(s.copy(), *arguments) for s in self.sigmas_f])
            R = noise_covariance(self.R, R, sigmas_h.shape[1])
            weights = np.full(len(sigmas_h), 1.0 / len(sigmas_h))
            zp, S = transformed(sigmas_h, weights, weights, R)
            C = covariance(self.sigmas_f - np.ravel(self.x), sigmas_h - zp, weights)
            self._correct(z, sigmas_h, zp[:, None], C, S, R, self.residual_z)

    def batch_filter(self, zs: Any, Rs: Any = None, dts: Any = None, saver: Any = None) -> tuple[Array, Array]:
        """Filter a whole recording: predict and update for each measurement. filterpy has no such method.

        Parameters
        ----------
        zs : sequence of length N
            Measurements as `update` takes them: numbers, arrays, rows with NaN, None.
        Rs : sequence of length N, optional
            Noise covariance of each step.
        dts : sequence of length N, or float, optional
            Time before each step.
        saver : filterpy.common.Saver, optional
            Its ``save()`` is called after each step.

        Returns
        -------
        means : ndarray, shape (N, dim_x)
            Corrected states.
        covariances : ndarray, shape (N, dim_x, dim_x)
            Their covariances.

        Raises
        ------
        ValueError, TypeError, LinAlgError
            As in `predict` and `update`, with the step named; the filter is then as it was before the call.
        """

        def step(z: Any, R: Any, dt: Any) -> None:
            self.predict(dt)
            self.update(z, R)

        return self._filtered(zs, {"Rs": Rs, "dts": dts}, step, saver)


def _rows(name: str, values: list[Any]) -> Array:
    """Return what a function made of each sigma point, shape (points, m)."""
    try:
        if all(type(v) is np.ndarray and v.ndim == 1 and v.dtype == FLOAT for v in values):
            return np.array(values)
        return _checks.numbers(name, [np.ravel(v) for v in values]).reshape(len(values), -1)
    except ValueError:
        raise ValueError(f"{name}: expected the same number of measurements for every sigma point") from None
