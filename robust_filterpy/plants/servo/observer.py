"""A state observer of the pneumatic servo around any filter of filterpy's kind, for a loop with sensors that err."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, finite_vector, positive

from .equations import servo_derivatives
from .linearization import STATE_SCALES, operating_point, sampled, without_dry_friction
from .parameters import BETA_RANGE, NOMINAL_ALPHA, PneumaticParameters, as_parameters

#: Units of position, velocity, P_a, P_b, force and beta over its nominal value within the filter.
_SCALES = np.append(STATE_SCALES, [1.0, 1.0])
_MEASURED = [0, 2, 3]
#: What each state gains as standard deviation in a second, in SI units: our choice.
_DRIFT = np.array([1e-3, 5e-3, 2.5e4, 2.5e4, 3.0, 0.3])
#: Standard deviations at the start.
_START = np.array([1e-3, 1e-2, 2e4, 2e4, 10.0, 0.3])
_STEP = 1e-6
#: Bounds of an estimate: velocity in m/s, beyond what such cylinders are made for, and share of the half stroke.
_FASTEST, _FURTHEST = 2.0, 0.95


class MotionEstimate(NamedTuple):
    """Hold what a controller takes for the motion.

    Attributes
    ----------
    position, acceleration : float
        In m and m/s^2.
    """

    position: float
    acceleration: float


class ServoObserver:
    """Estimate the motion of the piston from a position sensor and two pressure sensors, by an extended Kalman filter.

    The equations of `pneumatic_servo`, linearized at each estimate, with two random walks next to their four states:
    the force that the equations do not know, and beta, the flow through the valve::

        x = [position, velocity, P_a, P_b, force, beta / (alpha C_d)],    z = [position, P_a, P_b]

    The filter that corrects is the caller's, and may be a robust one.

    Parameters
    ----------
    filter : filter object
        Of filterpy's kind, fresh, dim_x = 6, dim_z = 3, dim_u = 6: ``RobustKalmanFilter(6, 3, 6)`` or filterpy's
        ``KalmanFilter(6, 3, 6)``. Its x, P, F, B, H, Q and R are set here.
    dt : float
        Sampling period, in s.
    std : array_like, shape (3,)
        Standard deviation of the ordinary noise of position, P_a and P_b, in m, Pa, Pa.
    parameters : PneumaticParameters, optional
    position : float
        Where the piston is at first, in m.

    Attributes
    ----------
    filter : filter object
        As given; its states are in units of 1 cm, 10 cm/s, 1 bar, 1 bar, 1 N and 1.

    Raises
    ------
    ValueError
        If dt or a standard deviation is not positive, the position is beyond the stroke, or the filter is of other
        dimensions.

    Notes
    -----
    The state moves over a period by ``(e^(A dt) - I) A^-1 f(x)`` with the Jacobian A, exact for a linear plant. Dry
    friction is no part of A: it takes from the velocity what it can within the period, and at most all. An outlier may
    throw an estimate where the piston cannot be (beyond its stroke, its pressures near a vacuum, beta out of its
    range); it is put back on the border.

    Examples
    --------
    >>> from filterpy.kalman import KalmanFilter
    >>> observer = ServoObserver(KalmanFilter(6, 3, 6), 0.01, [5e-5, 500.0, 500.0])
    >>> estimate = observer([1e-3, 3.9e5, 4.1e5], 0.0)
    >>> 0 < estimate.position <= 1e-3
    True
    """

    def __init__(
        self, filter: Any, dt: float, std: ArrayLike, parameters: PneumaticParameters | None = None, *,
        position: float = 0.0,
    ) -> None:  # fmt: skip
        """Set the filter up at rest."""
        noise = finite_vector("std", std)
        if noise.shape != (3,) or not np.all(noise > 0):
            raise ValueError(f"std: expected 3 numbers > 0, of position, P_a and P_b, got {noise}")
        shape = (filter.dim_x, filter.dim_z, filter.dim_u)
        if shape != (6, 3, 6):
            raise ValueError(f"filter: expected dim_x, dim_z, dim_u = (6, 3, 6), got {shape}")
        p = as_parameters(parameters)
        start = operating_point(p, position, velocity=0.0)
        self.filter, self._dt = filter, positive("dt", dt)
        self._nominal = NOMINAL_ALPHA * p.discharge_coefficient
        self._derivatives = servo_derivatives(without_dry_friction(p))
        self._friction, self._mass = p.coulomb_friction, p.mass
        end, low, high = _FURTHEST * p.stroke / 2, 0.5 * p.atmospheric_pressure, 2 * p.supply_pressure
        force, (least, most) = p.area_a * high, (limit / self._nominal for limit in BETA_RANGE)
        self._lower = np.array([-end, -_FASTEST, low, low, -force, least])
        self._upper = np.array([end, _FASTEST, high, high, force, most])
        self._slowed = 0.0
        filter.B, filter.H = np.eye(6), np.eye(6)[_MEASURED]
        filter.Q = np.diag((_DRIFT / _SCALES) ** 2 * dt)
        filter.R = np.diag((noise / _SCALES[_MEASURED]) ** 2)
        filter.P = np.diag((_START / _SCALES) ** 2)
        self._set_state(np.array([*start[:4], 0.0, 1.0]))

    @property
    def beta(self) -> float:
        """Estimate of the bound parameter beta, eq (6)."""
        return float(np.ravel(self.filter.x)[5] * self._nominal)

    def __call__(self, z: Sequence[float] | ArrayLike, valve: float, R: ArrayLike | None = None) -> MotionEstimate:
        """Take the readings of one sample."""
        kf, units = self.filter, _SCALES[_MEASURED]
        F, moved = self._moved(valve)
        # The filter's own prediction is linear: an input makes up for what is not.
        kf.predict(u=(moved - F @ np.ravel(kf.x))[:, None], F=F)
        covariance = None if R is None else np.asarray(R, dtype=float) / np.outer(units, units)
        kf.update((np.asarray(z, dtype=float) / units)[:, None], R=covariance)
        state = np.clip(np.ravel(kf.x) * _SCALES, self._lower, self._upper)
        self._set_state(state)
        return MotionEstimate(float(state[0]), float(self._rates(state, 0.0)[1] - self._slowed))

    def _set_state(self, state: Array) -> None:
        """Hand a state in SI units to the filter."""
        self.filter.x = (state / _SCALES)[:, None]

    def _rates(self, state: Array, valve: float) -> Array:
        """Return the derivatives of position, velocity and pressures, without dry friction."""
        *x, force, gain = state.tolist()
        return np.array(self._derivatives(*x, valve, force, NOMINAL_ALPHA, gain * self._nominal))

    def _moved(self, valve: float) -> tuple[Array, Array]:
        """Return the derivative of the state after a period, and that state, scaled."""
        state = np.ravel(self.filter.x) * _SCALES
        now, A = self._rates(state, valve), np.zeros((6, 6))
        for j, step in enumerate(_STEP * _SCALES):
            ahead = state.copy()
            ahead[j] += step
            A[:4, j] = (self._rates(ahead, valve) - now) / step
        inputs = np.zeros((6, 2))
        inputs[:4, 0], inputs[1, 1] = now, -1 / self._mass
        F, moves = sampled(A, inputs, self._dt)
        friction = float(np.clip(-(state[1] + moves[1, 0]) / moves[1, 1], -self._friction, self._friction))
        self._slowed = friction / self._mass
        return F * _SCALES / _SCALES[:, None], (state + moves @ [1.0, friction]) / _SCALES
