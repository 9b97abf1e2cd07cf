"""The nonlinear filters that start to believe measurements that insist, as `RecoveringKalmanFilter` does."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array
from robust_filterpy.correction.options import Grouping, Information, Scaling
from robust_filterpy.filters._mixin import unchanged_if_refused
from robust_filterpy.filters._recovery import RecoveryMixin
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
from robust_filterpy.filters.sigma_point import RobustCubatureKalmanFilter, RobustUnscentedKalmanFilter
from robust_filterpy.influence.functions import Influence, TukeyBiweight

__all__ = ["RecoveringCubatureKalmanFilter", "RecoveringExtendedKalmanFilter", "RecoveringUnscentedKalmanFilter"]


class _RecoveringNonlinear(RecoveryMixin):
    """Compare innovations as the user compares measurements."""

    @contextmanager
    def _watched(self, residual: Callable[[Any, Any], Any], C: Array, N: Array) -> Iterator[Callable[[Any, Any], Any]]:
        """Hand out the residual function for a correction, and watch after it; all of that or nothing."""
        shapes = []

        def noted(z: Any, predicted: Any) -> Any:
            shapes.append(np.shape(predicted))
            return residual(z, predicted)

        def difference(y: Array, before: Array) -> Array:
            # A copy: a residual function may write into what it is given.
            apart = np.ravel(np.asarray(residual(y.reshape(shapes[0]).copy(), before.reshape(shapes[0])), dtype=float))
            if apart.size != y.size:
                raise ValueError(f"residual: expected {y.size} number(s), got {apart}")
            return apart

        with unchanged_if_refused(self):
            yield noted
            if self._insists(difference):
                self._widen(C, N)


class _RecoveringSigmaPoint(_RecoveringNonlinear):
    """Watch the moments of sigma points."""

    def _correct(self, z: Any, sigmas_h: Array, zp: Any, C: Array, S: Array, R: Array, residual: Any) -> None:
        """Correct by a whole measurement, and watch whether the refused ones agree."""
        with self._watched(residual, C, S - R) as noted:
            super()._correct(z, sigmas_h, zp, C, S, R, noted)  # type: ignore[misc]


class RecoveringExtendedKalmanFilter(_RecoveringNonlinear, RobustExtendedKalmanFilter):
    """Filter like `RobustExtendedKalmanFilter`, and start to believe measurements that insist.

    Parameters
    ----------
    dim_x, dim_z, dim_u, patience, influence, scaling, information, grouping
        As in `RecoveringKalmanFilter`.

    Raises
    ------
    ValueError
        If a dimension or an option is out of range.

    Notes
    -----
    The attributes are those of `RecoveringKalmanFilter`. The measurement is taken as linear around the predicted state,
    so a jump so far that the line is wrong there can take more than one recovery. Two refused innovations agree by
    their ``residual``, which is called with both of them: it may wrap angles, and must subtract otherwise.

    Examples
    --------
    >>> import numpy as np
    >>> kf = RecoveringExtendedKalmanFilter(1, 1, patience=5)
    >>> kf.x, kf.Q, kf.R = np.array([3.0]), 0.01 * np.eye(1), 0.1 * np.eye(1)
    >>> for z in [9.0] * 20 + [25.0] * 8:
    ...     kf.predict()
    ...     kf.update(z, HJacobian=lambda x: np.array([2.0 * x]), Hx=lambda x: x**2)
    >>> bool(abs(kf.x[0] - 5.0) < 0.1), kf.recoveries
    (True, 1)
    """

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        patience: int = 12,
        influence: Influence = TukeyBiweight(),
        scaling: Scaling = "innovation",
        information: Information = "realized",
        grouping: Grouping = "component",
    ) -> None:
        """Set up filterpy's attributes and the count."""
        super().__init__(
            dim_x, dim_z, dim_u, influence=influence, scaling=scaling, information=information, grouping=grouping
        )
        self._set_recovery(patience, dim_z)

    def _correct(
        self, z: Any, x: Array, P: Array, H: Array, Hx: Any, R: Any, hx_args: Any, residual: Callable[[Any, Any], Any]
    ) -> None:
        """Correct by a whole measurement, and watch whether the refused ones agree."""
        C = P @ H.T
        with self._watched(residual, C, H @ C) as noted:
            super()._correct(z, x, P, H, Hx, R, hx_args, noted)


class RecoveringUnscentedKalmanFilter(_RecoveringSigmaPoint, RobustUnscentedKalmanFilter):
    """Filter like `RobustUnscentedKalmanFilter`, and start to believe measurements that insist.

    Parameters
    ----------
    dim_x, dim_z, dt, hx, fx, points, sqrt_fn, x_mean_fn, z_mean_fn, residual_x, residual_z, state_add
        As in `RobustUnscentedKalmanFilter`.
    patience, influence, scaling, information, grouping
        As in `RecoveringKalmanFilter`.

    Raises
    ------
    ValueError
        If a dimension or an option is out of range.

    Notes
    -----
    The attributes are those of `RecoveringKalmanFilter`. P is widened along C (S - R)^-1 y, with C = cov(x, z)
    and S = cov(z) by the sigma points. Two refused innovations agree by residual_z, which is called with both of them:
    it may wrap angles, and must subtract otherwise.

    The sigma points of a widened P lie several times as far out as the jump. Where the measurement is an angle that
    turns right round over such a distance, their moments mean nothing: choose points that lie closer (a small alpha).
    """

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
        *,
        patience: int = 12,
        influence: Influence = TukeyBiweight(),
        scaling: Scaling = "innovation",
        information: Information = "realized",
        grouping: Grouping = "component",
    ) -> None:
        """Set up filterpy's attributes and the count."""
        super().__init__(
            dim_x, dim_z, dt, hx, fx, points, sqrt_fn, x_mean_fn, z_mean_fn, residual_x, residual_z, state_add,
            influence=influence, scaling=scaling, information=information, grouping=grouping,
        )  # fmt: skip
        self._set_recovery(patience, dim_z)


class RecoveringCubatureKalmanFilter(_RecoveringSigmaPoint, RobustCubatureKalmanFilter):
    """Filter like `RobustCubatureKalmanFilter`, and start to believe measurements that insist.

    Parameters
    ----------
    dim_x, dim_z, dt, hx, fx, x_mean_fn, z_mean_fn, residual_x, residual_z
        As in `RobustCubatureKalmanFilter`.
    patience, influence, scaling, information, grouping
        As in `RecoveringKalmanFilter`.

    Raises
    ------
    ValueError
        If a dimension or an option is out of range.

    Notes
    -----
    As in `RecoveringUnscentedKalmanFilter`, but the distance of the points is not to be chosen: where angles turn right
    round over a few times the distance of a jump, take that filter or `RecoveringExtendedKalmanFilter`.
    """

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
        *,
        patience: int = 12,
        influence: Influence = TukeyBiweight(),
        scaling: Scaling = "innovation",
        information: Information = "realized",
        grouping: Grouping = "component",
    ) -> None:
        """Set up filterpy's attributes and the count."""
        super().__init__(
            dim_x, dim_z, dt, hx, fx, x_mean_fn, z_mean_fn, residual_x, residual_z,
            influence=influence, scaling=scaling, information=information, grouping=grouping,
        )  # fmt: skip
        self._set_recovery(patience, dim_z)
