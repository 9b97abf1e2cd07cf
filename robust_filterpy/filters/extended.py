"""RobustExtendedKalmanFilter: filterpy's ExtendedKalmanFilter with a bounded correction."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._arrays import (
    control_term,
    measured,
    noise_covariance,
    process_noise,
    require_finite_prediction,
    state_of,
)
from robust_filterpy._checks import Array
from robust_filterpy._filterpy import ExtendedKalmanFilter
from robust_filterpy.filters.nonlinear_mixin import (
    NonlinearFilterMixin,
    require_finite,
)
from robust_filterpy.filters.policies import Options, with_options
from robust_filterpy.filters.snapshot import whole

if TYPE_CHECKING:
    from typing_extensions import Unpack

__all__ = ["RobustExtendedKalmanFilter"]


class RobustExtendedKalmanFilter(NonlinearFilterMixin, ExtendedKalmanFilter):
    """Filter like `filterpy.kalman.ExtendedKalmanFilter`, without believing outliers.

    Every attribute, method and shape is filterpy's; the correction is that of `robust_filterpy.RobustKalmanFilter`
    with the innovation y = residual(z, Hx(x)) and H the Jacobian at x::

        x+ = x + P H' T' psi(T y),    P+ = P - P H' T' D T H P

    Parameters
    ----------
    dim_x : int
        Length of the state, >= 1.
    dim_z : int
        Length of the measurement, >= 1.
    dim_u : int, default 0
        Length of the control input.
    influence : Influence, default Huber(1.345)
        psi: `Huber`, `Linear` (the extended Kalman filter), `Hampel`, `TukeyBiweight`, `StudentT`, or any norm of
        `statsmodels.robust.norms`. Thresholds are in standard deviations of the innovation.
    scaling : {"learnt", "innovation", "unit", "bounded"}, optional
        T, as in `RobustKalmanFilter`.
    information : {"realized", "expected", "weight"}
        D, as in `RobustKalmanFilter`.
    grouping : {"component", "joint"} or tuple of tuple of int
        psi of each component of e, or of the length of e.
    noise, process, patience : optional
        As in `RobustKalmanFilter`; the models of `process` go on to first order around the state that is shown.

    Attributes
    ----------
    weights, clipped, e, T, y_bounded : ndarray
        What the last correction did, as in `RobustKalmanFilter`.

    Raises
    ------
    ValueError
        If a dimension or an option is out of range. Every call checks its arrays first and raises ValueError or
        TypeError before it changes anything.

    Notes
    -----
    NaN (or None, or a masked entry) in z is a missing component. The residual function never sees it: it is called
    with the predicted value in its place. z may be a row or a column, whatever Hx returns. HJacobian and Hx are given
    copies of x, which they may write into.

    Under ``noise=`` the measurement is linear around the predicted state, and nothing else of it is believed. A jump is
    believed where innovations, as ``residual`` gives them, keep their sign: not by half a turn, where they lie on both
    sides of pi. One so far that the line is wrong there can be believed in parts.

    ``x_prior`` after `predict_update` is the predicted state; filterpy leaves the state before the prediction there.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
    >>> kf = RobustExtendedKalmanFilter(dim_x=1, dim_z=1)
    >>> kf.x = np.array([1.0])
    >>> for z in [1.1, 0.9, 1.05, 1e6, 1.0]:
    ...     kf.predict()
    ...     kf.update(z, HJacobian=lambda x: np.array([2.0 * x]), Hx=lambda x: x**2)
    >>> bool(abs(kf.x[0] - 1.0) < 0.5)
    True
    """

    @with_options
    def __init__(self, dim_x: int, dim_z: int, dim_u: int = 0, **options: Unpack[Options]) -> None:
        """Set up filterpy's attributes and the choices."""
        self._set_policy(options, dim_x=dim_x, dim_z=dim_z, dim_u=dim_u)
        super().__init__(dim_x, dim_z, dim_u)
        self.inv = np.linalg.inv
        self._start()

    _settings = {name: name for name in ("F", "Q", "R", "B")}
    # filterpy's has no fading memory; the kernel asks for one.
    _alpha_sq = 1.0

    def predict_x(self, u: ArrayLike = 0) -> None:
        """Predict the state alone, x = F x + B u; override it for a nonlinear model, as with filterpy.

        Parameters
        ----------
        u : array_like, shape (dim_u,) or (dim_u, 1), or scalar
            Control input.
        """
        x, _ = state_of(self)
        F = _checks.matrix("F", self.F, (len(x), len(x)), "dim_x")
        self.x = F.dot(x) + (0.0 if u is None else control_term(self.B, u, x.shape))

    def predict(self, u: ArrayLike = 0) -> None:
        """Predict the next state: `predict_x`, and P = F P F' + Q.

        Parameters
        ----------
        u : array_like, shape (dim_u,) or (dim_u, 1), or scalar
            Control input.

        Raises
        ------
        ValueError
            If a shape does not fit, Q is negative or not symmetric, or the prediction not finite; nothing has changed
            then.
        """
        if not (self._is_linear() and self._predict_extended(u)):
            self._predict(u)

    @whole
    def _predict(self, u: ArrayLike) -> None:
        """Predict by `predict_x`."""
        n = self.dim_x
        _checks.matrix("F", self.F, (n, n), "dim_x")
        process_noise(self.Q, None, n)
        before = self._current()
        self.predict_x(u)
        if before is not self._kept or not self._predict_extended(None, moved=False):
            x, P = state_of(self)
            F, Q = _checks.matrix("F", self.F, (n, n), "dim_x"), process_noise(self.Q, None, n)
            if before is None:
                self.P = F.dot(P).dot(F.T) + Q
            else:
                self._kept = self._policy.predicted_to(before, x.ravel(), F, Q)
                self.x, self.P = self._kept.x.reshape(x.shape).copy(), self._kept.P.copy()
            require_finite_prediction(self.x, self.P)
            self.x_prior, self.P_prior = np.copy(self.x), np.copy(self.P)

    def _is_linear(self) -> bool:
        """Return whether x moves by F alone."""
        return type(self).predict_x is RobustExtendedKalmanFilter.predict_x and "predict_x" not in vars(self)

    @whole
    def update(
        self,
        z: ArrayLike | None,
        HJacobian: Callable[..., ArrayLike],
        Hx: Callable[..., ArrayLike],
        R: Any = None,
        args: Any = (),
        hx_args: Any = (),
        residual: Callable[[Any, Any], Any] = np.subtract,
        *,
        sensor: str | int | None = None,
    ) -> None:
        """Correct the state by a measurement whose influence is bounded.

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement; NaN marks a missing component, None a missing measurement.
        HJacobian : callable
            ``HJacobian(x, *args)`` returns H, shape (m, dim_x); z and R then have its height m.
        Hx : callable
            ``Hx(x, *hx_args)`` returns the measurement that belongs to x.
        R : array_like, shape (dim_z, dim_z), or scalar, optional
            Noise covariance for this call, otherwise ``self.R``. A scalar here means R I.
        args, hx_args : tuple
            Further arguments of HJacobian and Hx; anything else than a tuple is the only one.
        residual : callable, default numpy.subtract
            ``residual(z, Hx(x))``, for measurements that do not subtract (angles).
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
            given = (z, HJacobian, Hx, R, args, hx_args, residual)
            self._spoken(sensor, lambda: RobustExtendedKalmanFilter.update(self, *given))
            return
        if z is None or (type(z) is not np.ndarray and np.ndim(z) == 0 and measured(z, 1) is None):
            self._skip()
            return
        x, _ = state_of(self)
        self._correct(z, x, HJacobian(x.copy(), *_arguments(args)), Hx, R, hx_args, residual)

    @whole
    def predict_update(
        self,
        z: ArrayLike | None,
        HJacobian: Callable[..., ArrayLike],
        Hx: Callable[..., ArrayLike],
        args: Any = (),
        hx_args: Any = (),
        u: ArrayLike = 0,
    ) -> None:
        """Predict, then correct, with H the Jacobian at the state before the prediction, as in filterpy.

        Parameters
        ----------
        z : array_like, shape (dim_z,) or (dim_z, 1), or scalar, or None
            Measurement, as in `update`.
        HJacobian, Hx : callable
            As in `update`.
        args, hx_args : tuple
            As in `update`.
        u : array_like, shape (dim_u,) or (dim_u, 1), or scalar
            Control input.

        Raises
        ------
        ValueError, SingularInnovationError, NotPositiveDefiniteError
            As in `predict` and `update`; nothing has changed then.
        """
        x, _ = state_of(self)
        H = None if z is None else HJacobian(x.copy(), *_arguments(args))
        self.predict(u)
        if z is None:
            self._skip()
            return
        x, _ = state_of(self)
        self._correct(z, x, H, Hx, None, hx_args, np.subtract)

    def batch_filter(
        self,
        zs: Any,
        HJacobian: Callable[..., ArrayLike],
        Hx: Callable[..., ArrayLike],
        Rs: Any = None,
        us: Any = None,
        *,
        args: Any = (),
        hx_args: Any = (),
        residual: Callable[[Any, Any], Any] = np.subtract,
        saver: Any = None,
    ) -> tuple[Array, Array]:
        """Filter a whole recording: predict and update for each measurement. filterpy has no such method.

        Parameters
        ----------
        zs : sequence of length N
            Measurements as `update` takes them: numbers, arrays, rows with NaN, None.
        HJacobian, Hx : callable
            As in `update`.
        Rs : sequence of length N, optional
            Noise covariance of each step.
        us : sequence of length N, optional
            Control input before each step.
        args, hx_args : tuple
            As in `update`.
        residual : callable, default numpy.subtract
            As in `update`.
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

        def step(z: Any, R: Any, u: Any) -> None:
            self.predict() if u is None else self.predict(u)
            self.update(z, HJacobian, Hx, R, args, hx_args, residual)

        return self._filtered(zs, {"Rs": Rs, "us": us}, step, saver)

    def _correct(
        self, z: Any, x: Array, H: Any, Hx: Any, R: Any, hx_args: Any, residual: Callable[[Any, Any], Any]
    ) -> None:
        """Correct by a whole measurement; every check comes before the first assignment."""
        at = Hx(x.copy(), *_arguments(hx_args))
        if residual is np.subtract and self._stepped(z, at, None, H, None, R):
            return
        H = self._checked(H, len(x))
        self._correct_by_moments("Hx", z, at, H, None, noise_covariance(self.R, R, len(H)), residual)

    def _checked(self, H: Any, n: int) -> Array:
        """Return the Jacobian that the user's function gave, checked."""
        H = _checks.numbers("HJacobian", H)
        if H.ndim != 2 or H.shape[1] != n or not len(H):
            raise ValueError(
                f"HJacobian: expected shape ({self.dim_z}, {n}) for dim_z={self.dim_z}, dim_x={n}, "
                f"got {_checks.described(H)}"
            )
        require_finite(HJacobian=H)
        return H


def _arguments(given: Any) -> tuple[Any, ...]:
    """Return further arguments of a model function; anything else than a tuple is the only one."""
    return given if isinstance(given, tuple) else (given,)
