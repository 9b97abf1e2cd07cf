"""An observer of the servo: the motion of the piston, as its controller takes it, from sensors that err."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy.plants.servo.equations import BETA_RANGE, NOMINAL_ALPHA, PneumaticParameters, servo_derivatives
from robust_filterpy.plants.servo.linearization import STATE_SCALES, operating_point, sampled, without_dry_friction

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
    """What a controller takes for the motion."""

    position: float  # m
    acceleration: float  # m/s^2


class ServoObserver:
    """Estimate the motion of the piston from a position sensor and two pressure sensors, by an extended Kalman filter.

    The equations of `pneumatic_servo`, linearized at each estimate, with two random walks next to their four states:
    the force that the equations do not know, and beta, the flow through the valve::

        x = [position, velocity, P_a, P_b, force, beta / (alpha C_d)],    z = [position, P_a, P_b]

    The filter that corrects is the caller's, fresh, and may be a robust one: ``RobustKalmanFilter(6, 3, 6)`` or
    filterpy's ``KalmanFilter(6, 3, 6)``; std is what the ordinary noise of position, P_a and P_b has, in m, Pa, Pa. The
    states of the filter are in units of 1 cm, 10 cm/s, 1 bar, 1 bar, 1 N and 1.

    The state moves over a period by ``(e^(A dt) - I) A^-1 f(x)`` with the Jacobian A, exact for a linear plant. Dry
    friction is no part of A: it takes from the velocity what it can within the period, and at most all. An outlier may
    throw an estimate where the piston cannot be (beyond its stroke, its pressures near a vacuum, beta out of its
    range); it is put back on the border.
    """

    def __init__(self, filter: Any, dt: float, std: ArrayLike, parameters: PneumaticParameters | None = None) -> None:
        """Set the filter up at rest in mid-stroke."""
        p = PneumaticParameters() if parameters is None else parameters
        start = operating_point(p, velocity=0.0)
        self.filter, self._dt = filter, dt
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
        filter.R = np.diag((np.asarray(std) / _SCALES[_MEASURED]) ** 2)
        filter.P = np.diag((_START / _SCALES) ** 2)
        self._set_state(np.array([*start[:4], 0.0, 1.0]))

    @property
    def beta(self) -> float:
        """Estimate of the bound parameter beta."""
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

    def _set_state(self, state: np.ndarray) -> None:
        """Hand a state in SI units to the filter."""
        self.filter.x = (state / _SCALES)[:, None]

    def _rates(self, state: np.ndarray, valve: float) -> np.ndarray:
        """Return the derivatives of position, velocity and pressures, without dry friction."""
        *x, force, gain = state.tolist()
        return np.array(self._derivatives(*x, valve, force, NOMINAL_ALPHA, gain * self._nominal))

    def _moved(self, valve: float) -> tuple[np.ndarray, np.ndarray]:
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
