"""State-space models with a name: the linear systems, and one nonlinear sensor, that the scenarios are drawn from.

    x(k) = F x(k-1) + B u(k) + w(k),  w ~ N(0, Q)          z(k) = H x(k) + v(k),  v ~ N(0, R)

======================  =============================================================================================
name                    good for
======================  =============================================================================================
constant velocity       the usual tracker in the plane: four states, two sensors, a velocity that nobody measures
level                   one number that wanders and sometimes jumps: does a filter believe what is true?
paper                   equations 31-34 of the paper: three of four states are seen through the model alone
range and bearing       a nonlinear sensor, for extended and sigma-point filters
random stable           any size, full F, H, Q, R and B: a transposed or forgotten matrix has nowhere to hide
======================  =============================================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy import _checks
from robust_filterpy._checks import Array

__all__ = ["StateModel"]


@dataclass(frozen=True, eq=False)
class StateModel:
    """Hold what a filter is given about a system, and how the system departs from that.

    Attributes
    ----------
    x : ndarray, shape (n,)
        Mean of the state before the first step.
    P : ndarray, shape (n, n)
        Its covariance.
    F, Q : ndarray, shape (n, n)
        Transition matrix, covariance of the process noise.
    H : ndarray, shape (m, n)
        Measurement matrix; of a nonlinear sensor, the Jacobian at x.
    R : ndarray, shape (m, m)
        Covariance of the measurement noise.
    B : ndarray, shape (n, dim_u), optional
        Control matrix.
    sensor : callable, optional
        h(x), shape (m,), of a nonlinear sensor.
    sensor_jacobian : callable, optional
        dh/dx at x, shape (m, n).
    jump_probability : float
        With this probability the process noise of a step is multiplied by `jump_ratio`; no filter is given that.
    jump_ratio : float
        See there.

    Raises
    ------
    ValueError
        If a shape does not fit; the message names the matrix.
    """

    x: Array
    P: Array
    F: Array
    H: Array
    Q: Array
    R: Array
    B: Array | None = None
    sensor: Callable[[Array], Array] | None = None
    sensor_jacobian: Callable[[Array], Array] | None = None
    jump_probability: float = 0.0
    jump_ratio: float = 10.0

    def __post_init__(self) -> None:
        """Check every shape against those of x and R."""
        x, R = _checks.finite_vector("x", self.x), _checks.numbers("R", self.R)
        if R.ndim != 2 or R.shape[0] != R.shape[1]:
            raise ValueError(f"R: expected a square matrix, got {_checks.described(R)}")
        n, m = x.size, len(R)
        wanted = {"P": (n, n), "F": (n, n), "H": (m, n), "Q": (n, n), "R": (m, m)}
        object.__setattr__(self, "x", x)
        for name, shape in wanted.items():
            value = _checks.matrix(name, getattr(self, name), shape, f"x of {n} numbers and R of {m} rows")
            object.__setattr__(self, name, value)
        if self.B is not None:
            B = _checks.numbers("B", self.B)
            if B.ndim != 2 or len(B) != n:
                raise ValueError(f"B: expected shape ({n}, dim_u) for x of {n} numbers, got {_checks.described(B)}")
            object.__setattr__(self, "B", B)
        if (self.sensor is None) != (self.sensor_jacobian is None):
            raise ValueError("sensor, sensor_jacobian: expected both for a nonlinear sensor, or neither")

    @property
    def dims(self) -> tuple[int, int, int]:
        """Lengths of the state, the measurement and the input."""
        return len(self.x), len(self.R), 0 if self.B is None else self.B.shape[1]

    def measured(self, x: Array) -> Array:
        """Return the measurement that belongs to x, without noise, shape (m,)."""
        return self.H @ x if self.sensor is None else self.sensor(x)

    def jacobian(self, x: Array) -> Array:
        """Return its derivative at x, shape (m, n)."""
        return self.H if self.sensor_jacobian is None else self.sensor_jacobian(x)

    def innovation_covariance(self, P: Array) -> Array:
        """Return S = H P H' + R of a linear sensor, shape (m, m)."""
        return self.H @ P @ self.H.T + self.R

    def with_(self, **changes: Any) -> StateModel:
        """Return the model with some of its fields replaced."""
        return replace(self, **changes)

    def in_units(self, state: ArrayLike, sensors: ArrayLike) -> StateModel:
        """Return the same linear system in other units: every state and every sensor times a factor.

        Parameters
        ----------
        state : array_like, shape (n,)
            Factor of each state.
        sensors : array_like, shape (m,)
            Factor of each sensor.

        Returns
        -------
        StateModel
        """
        a, b = np.asarray(state, dtype=float), np.asarray(sensors, dtype=float)
        return self.with_(
            x=a * self.x, P=np.outer(a, a) * self.P, F=np.outer(a, 1 / a) * self.F, H=np.outer(b, 1 / a) * self.H,
            Q=np.outer(a, a) * self.Q, R=np.outer(b, b) * self.R,
        )  # fmt: skip


def constant_velocity(dt: float = 1.0) -> StateModel:
    """Return a point in the plane whose position is measured, state [p_1, v_1, p_2, v_2]."""
    dt = _checks.positive("dt", dt)
    Q = 0.02 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    # The same for both axes of the plane.
    blocks = np.diag([1.0, 0.1]), [[1.0, dt], [0.0, 1.0]], [[1.0, 0.0]], Q
    P, F, H, Q = (np.asarray(np.kron(np.eye(2), block), dtype=float) for block in blocks)
    return StateModel(x=np.array([0.0, 1.0, 0.0, -0.5]), P=P, F=F, H=H, Q=Q, R=np.eye(2))


def level(jump_probability: float = 0.005) -> StateModel:
    """Return a level that wanders by a tenth of the sensor's deviation a step, and now and then jumps."""
    one = np.eye(1)
    probability = _checks.fraction("jump_probability", jump_probability)
    return StateModel(np.zeros(1), one, one, one, 0.01 * one, one, jump_probability=probability, jump_ratio=100.0)


def paper(P0: float = 0.1) -> StateModel:
    """Return the state-estimation problem of the paper, equations 31-34, from P(0|0) = P0 I."""
    F = np.array([
        [0.99, -0.012, 0.001, -0.001], [-0.005, 0.98, -0.001, 0.005],
        [-0.001, 0.01, 1.0, -0.001], [0.01, 0.001, -0.002, 1.0],
    ])  # fmt: skip
    return StateModel(np.zeros(4), P0 * np.eye(4), F, np.eye(1, 4), 0.001 * np.eye(4), np.array([[0.1]]))


def range_bearing() -> StateModel:
    """Return a target in the plane that a sensor at the origin sees by distance (m) and angle (rad)."""
    cart = constant_velocity()
    x = np.array([1000.0, -2.0, 500.0, 3.0])

    def sensor(x: Array) -> Array:
        return np.array([np.hypot(x[0], x[2]), np.arctan2(x[2], x[0])])

    def jacobian(x: Array) -> Array:
        r = np.hypot(x[0], x[2])
        return np.array([[x[0] / r, 0.0, x[2] / r, 0.0], [-x[2] / r**2, 0.0, x[0] / r**2, 0.0]])

    return cart.with_(
        x=x, P=25.0 * cart.P, H=jacobian(x), R=np.diag([25.0, 0.004**2]), sensor=sensor, sensor_jacobian=jacobian
    )


def random_stable(
    dim_x: int = 4, dim_z: int = 2, dim_u: int = 0, *, rng: np.random.Generator | int | None = None
) -> StateModel:
    """Draw a stable system whose matrices are full and far from symmetric."""
    n, m = _checks.count("dim_x", dim_x, 1), _checks.count("dim_z", dim_z, 1)
    p, rng = _checks.count("dim_u", dim_u), np.random.default_rng(rng)

    def covariance(size: int, scale: float) -> Array:
        root = rng.normal(size=(size, size))
        return np.asarray(scale * (root @ root.T / size + 0.5 * np.eye(size)))

    F, Q = rng.normal(size=(n, n)), covariance(n, 0.1)
    return StateModel(
        x=rng.normal(size=n), P=covariance(n, 1.0) + Q, F=F * 0.95 / np.abs(np.linalg.eigvals(F)).max(),
        H=rng.normal(size=(m, n)), Q=Q, R=covariance(m, 0.5), B=rng.normal(size=(n, p)) if p else None,
    )  # fmt: skip


#: What `draw` knows by name.
MODELS: dict[str, Callable[..., StateModel]] = {
    "constant velocity": constant_velocity, "level": level, "paper": paper,
    "range and bearing": range_bearing, "random stable": random_stable,
}  # fmt: skip
