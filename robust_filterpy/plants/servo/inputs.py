"""What drives the servo in a simulated experiment: every signal checked, and one value of it for each sample."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from robust_filterpy._checks import Array, numbers, positive

from .coefficients import ALPHA_RANGE, BETA_RANGE, Coefficient, checked, coefficient_function
from .equations import STATES
from .parameters import PneumaticParameters
from .steady_motion import operating_point

Signal: TypeAlias = "Coefficient | ArrayLike"


class ServoInputs:
    """What drives the plant beside its valve, checked and sampled."""

    def __init__(  # the quantities that both simulations take
        self,
        n: int,
        dt: float,
        rtol: float,
        p: PneumaticParameters,
        alpha: Signal,
        beta: Signal | None,
        load: Signal,
        supply: Signal | None,
        noise: ArrayLike | None,
        initial: ArrayLike | None,
    ) -> None:
        """Bring every signal to one value a sample."""
        for name, value in (("dt", dt), ("rtol", rtol)):
            positive(name, value)
        self.dt, self.rtol = dt, rtol
        self.t = t = dt * np.arange(n, dtype=np.float64)
        self.alpha = _samples(alpha, t, "alpha", ALPHA_RANGE)
        if beta is None:
            self.beta = checked(self.alpha * p.discharge_coefficient, "beta", BETA_RANGE)
        else:
            self.beta = _samples(beta, t, "beta", BETA_RANGE)
        self.load = _samples(load, t, "load", (-math.inf, math.inf))
        pressure = p.supply_pressure if supply is None else supply
        self.supply = _samples(pressure, t, "supply", (p.atmospheric_pressure, math.inf))
        self.noise = np.zeros((n, 3)) if noise is None else numbers("noise", noise)
        if self.noise.shape != (n, 3) or not np.all(np.isfinite(self.noise)):
            raise ValueError(
                f"noise: expected finite numbers of shape ({n}, 3), for position, P_a and P_b, got shape "
                f"{self.noise.shape}"
            )
        self.x0 = _initial_state(initial, p, float(self.load[0]))


def sampled_reference(reference: ArrayLike | Callable[[float], float], dt: float, duration: float | None) -> Array:
    """Return the reference at the sampling times."""
    if callable(reference):
        if duration is None or not (math.isfinite(duration) and math.isfinite(dt) and dt > 0 and duration >= dt):
            raise ValueError(
                f"duration: expected at least dt = {dt} s for a reference that is a function, got {duration}"
            )
        r = np.array([float(reference(dt * k)) for k in range(round(duration / dt))])
    else:
        if duration is not None:
            raise ValueError("duration: expected None for a sampled reference, whose length says it")
        r = np.array(reference, dtype=float)
    if r.ndim != 1 or r.size == 0:
        raise ValueError(f"reference: expected a non-empty sequence of positions, got shape {r.shape}")
    if not np.all(np.isfinite(r)):
        raise ValueError(
            f"reference: expected finite positions, got {r[~np.isfinite(r)][0]} at {np.argmin(np.isfinite(r))}"
        )
    return r


def _samples(value: Signal, t: Array, name: str, limits: tuple[float, float]) -> Array:
    """Return a signal at the sampling times."""
    if not callable(value) and not isinstance(value, tuple) and np.ndim(value):
        samples = checked(value, name, limits)
        if samples.shape != t.shape:
            raise ValueError(f"{name}: expected one value for each of the {t.size} samples, got shape {samples.shape}")
    else:
        function = coefficient_function(value, name, limits)  # type: ignore[arg-type]
        samples = np.array([function(now) for now in t.tolist()])
    if not np.all(np.isfinite(samples)):
        raise ValueError(f"{name}: expected finite values")
    return samples.copy()


def _initial_state(initial: ArrayLike | None, parameters: PneumaticParameters, load: float) -> Array:
    """Return the state at t = 0."""
    if initial is None:
        point = operating_point(parameters, load=load, velocity=0.0)
        return np.array([0.0, 0.0, point.P_a, point.P_b])
    x = np.array(initial, dtype=float)
    if x.shape != (4,) or not np.all(np.isfinite(x)):
        raise ValueError(f"initial: expected 4 finite numbers {STATES}, got {initial!r}")
    if x[2] <= 0 or x[3] <= 0:
        raise ValueError(f"initial: expected positive absolute pressures, got P_a = {x[2]:g} and P_b = {x[3]:g} Pa")
    if abs(x[0]) > parameters.stroke / 2:
        raise ValueError(f"initial: expected a position within +-{parameters.stroke / 2:g} m, got {x[0]:g}")
    return x
