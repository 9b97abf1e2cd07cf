"""The nonlinear filters that learn their measurement noise, as `AdaptiveKalmanFilter` does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from robust_filterpy._checks import Array
from robust_filterpy.correction.definition import nothing_observed
from robust_filterpy.correction.learning import SCALES, NoiseClasses
from robust_filterpy.correction.options import Grouping
from robust_filterpy.correction.result import Correction
from robust_filterpy.filters._hypotheses import ScoreMixin
from robust_filterpy.filters._interacting import Bank
from robust_filterpy.filters._learnt_noise import Learnt, LearntNoiseMixin, ordinary_noise
from robust_filterpy.filters.extended import RobustExtendedKalmanFilter
from robust_filterpy.filters.sigma_point import RobustCubatureKalmanFilter, RobustUnscentedKalmanFilter

__all__ = ["AdaptiveCubatureKalmanFilter", "AdaptiveExtendedKalmanFilter", "AdaptiveUnscentedKalmanFilter"]


class _Found(NamedTuple):
    """A correction and what it has taught."""

    correction: Correction
    learnt: Learnt

    @property
    def x(self) -> Array:
        """Corrected state, shape (n,)."""
        return self.correction.x


class _AdaptiveNonlinear(LearntNoiseMixin, ScoreMixin):
    """Correct by the linear measurement that a nonlinear one is, around the predicted state."""

    _log_likelihood: float | None

    def _corrected(self, x: Array, P: Array, y: Array, H: Array, R: Array) -> Any:
        """Return the correction under learnt noise, H the derivative of the measurement."""
        return self._taught(x, P, y, H, np.zeros((0, 0)), R, np.add)

    def _corrected_by_moments(
        self, x: Array, P: Array, y: Array, C: Array, S: Array, R: Array, add: Callable[..., Any]
    ) -> Any:
        """Return the correction under learnt noise, the moments those of z = H x + curvature + noise."""
        unit = np.sqrt(np.where(P.diagonal() > 0.0, P.diagonal(), 1.0))
        H = (np.linalg.pinv(P / np.outer(unit, unit), hermitian=True) @ (C / unit[:, None])).T / unit
        values, vectors = np.linalg.eigh(S - R - H @ C)
        return self._taught(x, P, y, H, (vectors * np.maximum(values, 0.0)) @ vectors.T, R, add)

    def _taught(
        self, x: Array, P: Array, y: Array, H: Array, curvature: Array, R: Array, add: Callable[..., Any]
    ) -> Any:
        """Return the correction; what a line does not explain of z is a state of its own, of which R knows nothing."""
        n, m, known = x.size, y.size, self._known(y.size)
        y, ordinary = np.where(H.any(axis=1), y, np.nan), ordinary_noise(R, known)
        unexplained = curvature if curvature.size else np.zeros((m, m))
        whole, states = np.hstack((H, np.eye(m)[:, : len(curvature)])), block_diag(P, curvature)
        start = np.zeros((1, n + len(curvature)))
        bank = Bank(start, states[None], np.ones(1), start[0], states)
        learnt = self._learn(bank, y, whole, R, None, known)
        if learnt is None:
            return nothing_observed(x, P, H @ P @ H.T + unexplained + ordinary, m)
        shown = learnt.correction(y, np.zeros(n), P, H, ordinary + unexplained, None, self._inverse)
        x_post = np.asarray(add(x, learnt.bank.means[0, :n]), dtype=float)
        return _Found(shown._replace(x=x_post, P=learnt.bank.covariances[0, :n, :n]), learnt)

    def _keep(self, last: Any, z: Array) -> None:
        """Write the correction into the attributes, and what it has taught."""
        if not isinstance(last, _Found):
            super()._keep(last, z)  # type: ignore[misc]
            self._outlier_probability = 0.0
            return
        super()._keep(last.correction, z)  # type: ignore[misc]
        self._learnt, self._outlier_probability = last.learnt.known, last.learnt.outlier_probability
        self._log_likelihood = last.learnt.log_density

    def _skip(self) -> None:
        """Leave the noise as it is."""
        super()._skip()  # type: ignore[misc]
        self._outlier_probability = 0.0


class AdaptiveExtendedKalmanFilter(_AdaptiveNonlinear, RobustExtendedKalmanFilter):
    """Filter like `filterpy.kalman.ExtendedKalmanFilter`, and learn the measurement noise while filtering.

    Parameters
    ----------
    dim_x : int
        Length of the state, >= 1.
    dim_z : int
        Length of the measurement, >= 1.
    dim_u : int, default 0
        Length of the control input.
    measurement_scales : sequence of float, default (1, 10, 100, 1000)
        Factors of the covariance R, ascending from 1, as in `AdaptiveKalmanFilter`.
    grouping : {"component", "joint"}
        Whether each sensor has a noise of its own and fails on its own, or all together.
    memory : float, default 300
        Samples for which it is remembered how often each scale occurs, > 1.
    r_memory : float, default 30
        Ordinary samples for which the size of the noise is remembered, > 1.

    Attributes
    ----------
    noise : LearntNoise
        What has been learnt: r, contamination, scale ratio and length of outlier runs, with standard errors.
    R_learnt : ndarray, shape (dim_z, dim_z)
        Covariance of ordinary noise as learnt, r R.
    outlier_probability : float
        Probability that a component of the last measurement was an outlier.
    learnt : ndarray, shape (1 or sensors, 2 + 2 K + K^2)
        What is known of the noise, as in `AdaptiveKalmanFilter`.

    Raises
    ------
    ValueError, TypeError
        If a dimension or an option is out of range.

    Notes
    -----
    The measurement is taken as linear around the predicted state. Q is taken as it is told: where it is far too small,
    the state's own motion looks like noise and R grows; a Q on the large side does little harm.

    Examples
    --------
    >>> import numpy as np
    >>> from robust_filterpy.filters import AdaptiveExtendedKalmanFilter
    >>> rng = np.random.default_rng(0)
    >>> kf = AdaptiveExtendedKalmanFilter(1, 1)
    >>> kf.x, kf.R, kf.Q = np.array([3.0]), 100.0 * np.eye(1), 1e-4 * np.eye(1)
    >>> for bad in rng.random(500) < 0.1:
    ...     kf.predict()
    ...     z = 9.0 + rng.normal() * (10.0 if bad else 1.0)
    ...     kf.update(z, HJacobian=lambda x: np.array([2.0 * x]), Hx=lambda x: x**2)
    >>> bool(0.6 < kf.R_learnt[0, 0] < 1.6), bool(abs(kf.x[0] - 3.0) < 0.1)
    (True, True)
    """

    def __init__(
        self,
        dim_x: int,
        dim_z: int,
        dim_u: int = 0,
        *,
        measurement_scales: Sequence[float] = SCALES,
        grouping: Grouping = "component",
        memory: float = 300.0,
        r_memory: float = 30.0,
    ) -> None:
        """Set up filterpy's attributes and the noise."""
        classes = NoiseClasses(measurement_scales, grouping, memory, r_memory)
        super().__init__(dim_x, dim_z, dim_u, grouping=grouping)
        self._set_noise(classes, dim_z)


class AdaptiveUnscentedKalmanFilter(_AdaptiveNonlinear, RobustUnscentedKalmanFilter):
    """Filter like `filterpy.kalman.UnscentedKalmanFilter`, and learn the measurement noise while filtering.

    Parameters
    ----------
    dim_x, dim_z, dt, hx, fx, points, sqrt_fn, x_mean_fn, z_mean_fn, residual_x, residual_z, state_add
        As in `RobustUnscentedKalmanFilter`.
    measurement_scales, grouping, memory, r_memory
        As in `AdaptiveExtendedKalmanFilter`.

    Raises
    ------
    ValueError, TypeError
        If a dimension or an option is out of range.

    Notes
    -----
    The attributes that show what was learnt are those of `AdaptiveExtendedKalmanFilter`. What the sigma points tell of
    the measurement beyond a line, S - R - C' P^-1 C, is a part of the state's uncertainty and not of the noise.
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
        measurement_scales: Sequence[float] = SCALES,
        grouping: Grouping = "component",
        memory: float = 300.0,
        r_memory: float = 30.0,
    ) -> None:
        """Set up filterpy's attributes and the noise."""
        classes = NoiseClasses(measurement_scales, grouping, memory, r_memory)
        super().__init__(
            dim_x, dim_z, dt, hx, fx, points, sqrt_fn, x_mean_fn, z_mean_fn, residual_x, residual_z, state_add,
            grouping=grouping,
        )  # fmt: skip
        self._set_noise(classes, dim_z)


class AdaptiveCubatureKalmanFilter(_AdaptiveNonlinear, RobustCubatureKalmanFilter):
    """Filter like `filterpy.kalman.CubatureKalmanFilter`, and learn the measurement noise while filtering.

    Parameters
    ----------
    dim_x, dim_z, dt, hx, fx, x_mean_fn, z_mean_fn, residual_x, residual_z
        As in `RobustCubatureKalmanFilter`.
    measurement_scales, grouping, memory, r_memory
        As in `AdaptiveExtendedKalmanFilter`.

    Raises
    ------
    ValueError, TypeError
        If a dimension or an option is out of range.

    Notes
    -----
    As in `AdaptiveUnscentedKalmanFilter`.
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
        measurement_scales: Sequence[float] = SCALES,
        grouping: Grouping = "component",
        memory: float = 300.0,
        r_memory: float = 30.0,
    ) -> None:
        """Set up filterpy's attributes and the noise."""
        classes = NoiseClasses(measurement_scales, grouping, memory, r_memory)
        super().__init__(
            dim_x, dim_z, dt, hx, fx, x_mean_fn, z_mean_fn, residual_x, residual_z, grouping=grouping
        )  # fmt: skip
        self._set_noise(classes, dim_z)
