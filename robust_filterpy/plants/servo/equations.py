"""The equations of the pneumatic servo, (1)-(7) of the paper with the print corrected, as functions of floats."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .parameters import PneumaticParameters, critical_ratio

STATES = ("position", "velocity", "P_a", "P_b")
INPUTS = ("valve", "load")
#: (y, v, P_a, P_b, valve, load, alpha, beta[, supply]) -> (y', v', P_a', P_b')
Derivatives: TypeAlias = Callable[..., tuple[float, float, float, float]]


def valve_opening(command: ArrayLike, dead_band: float) -> Any:
    """Return how far a valve opens: not at all within its dead band, in proportion beyond it.

    ``sgn(u) max(0, |u| - d) / (1 - d)``, limited to [-1, 1].

    Parameters
    ----------
    command : float or array_like, any shape
        Position of the spool, u, as a fraction of its stroke.
    dead_band : float
        Overlap d of the spool as a fraction of its stroke, in [0, 1).

    Returns
    -------
    float or numpy.ndarray, shape of command
        Fraction of the full opening, in [-1, 1].

    Raises
    ------
    ValueError
        If dead_band is not in [0, 1).

    Examples
    --------
    >>> valve_opening([0.005, 0.208, -1.5], 0.01).round(3)
    array([ 0. ,  0.2, -1. ])
    """
    if not 0 <= dead_band < 1:
        raise ValueError(f"dead_band: expected a fraction of the spool's stroke in [0, 1), got {dead_band}")
    u = np.asarray(command, dtype=float)
    opening = np.sign(u) * np.clip((np.abs(u) - dead_band) / (1 - dead_band), 0.0, 1.0)
    return float(opening) if opening.ndim == 0 else opening


def servo_derivatives(parameters: PneumaticParameters) -> Derivatives:
    """Return the right-hand side of eq (7) as a lean function of floats.

    Everything that runs this plant (`pneumatic_servo`, the fast simulation, the linearization) calls this function.

    Parameters
    ----------
    parameters : PneumaticParameters

    Returns
    -------
    callable
        ``(y, v, P_a, P_b, valve, load, alpha, beta, supply) -> (y', v', P_a', P_b')``, SI units, see `pneumatic_servo`;
        without its last argument the supply pressure is the parameters'.
    """
    p = parameters
    area_a, area_b, atmosphere, mean_supply = p.area_a, p.area_b, p.atmospheric_pressure, p.supply_pressure
    middle = p.dead_length + p.stroke / 2
    shortest = 1e-3 * p.dead_length
    rod_force = (area_a - area_b) * atmosphere
    speed = math.sqrt(p.gas_constant * p.temperature)
    valve_flow, leakage = speed * p.valve_area, speed * p.leakage_area
    dead_band, stretch = p.dead_band, 1 / (1 - p.dead_band)
    friction = dry_friction(p)
    stop = end_stop(p)
    through = port_flow(reduced_flow(p.kappa, p.laminar_ratio))
    viscous, spring, mass = p.viscous_friction, p.spring, p.mass

    def derivatives(  # floats, as a solver's thousands of calls want them
        y: float,
        v: float,
        p_a: float,
        p_b: float,
        valve: float,
        load: float,
        alpha: float,
        beta: float,
        supply: float = mean_supply,
    ) -> tuple[float, float, float, float]:
        force = area_a * p_a - area_b * p_b - rod_force - viscous * v - friction(v) - spring * y - stop(y, v) - load
        # What `valve_opening` says, for one float.
        opening = min(1.0, max(0.0, (abs(valve) - dead_band) * stretch))
        filling = beta * valve_flow * opening
        leaking = alpha * leakage * through(p_a, p_b)
        outside_a, outside_b = (supply, atmosphere) if valve >= 0 else (atmosphere, supply)
        # Only a solver's trial step can come this near to an empty chamber; the stops hold the piston off it.
        length_a, length_b = max(middle + y, shortest), max(middle - y, shortest)
        return (
            v,
            force / mass,
            (filling * through(outside_a, p_a) - leaking - alpha * p_a * area_a * v) / (area_a * length_a),
            (filling * through(outside_b, p_b) + leaking + alpha * p_b * area_b * v) / (area_b * length_b),
        )

    return derivatives


def reduced_flow(kappa: float, laminar_ratio: float) -> Callable[[float], float]:
    """Return f-bar of eq (5), of the pressure downstream over that upstream.

    Constant (0.6847 for air) below the critical ratio, where the flow is choked. From laminar_ratio to 1 it is the
    straight line down to 0; at 1 there is no such line, and the slope there is infinite: an ODE solver then chatters
    where a chamber has reached the outer pressure. The mass flow through an orifice of area A is
    ``C_d A P_up f-bar(P_down/P_up) / sqrt(R T)``.
    """
    critical = critical_ratio(kappa)
    factor, low, high = 2 * kappa / (kappa - 1), 2 / kappa, (kappa + 1) / kappa
    choked = math.sqrt(factor * (critical**low - critical**high))
    laminar_slope = 0.0
    if laminar_ratio < 1:
        laminar_slope = math.sqrt(factor * (laminar_ratio**low - laminar_ratio**high)) / (1 - laminar_ratio)

    def reduced(r: float) -> float:
        if r <= critical:
            return choked
        if r >= laminar_ratio:
            return laminar_slope * (1 - r)
        return math.sqrt(factor * (r**low - r**high))

    return reduced


def port_flow(reduced: Callable[[float], float]) -> Callable[[float, float], float]:
    """Return f of eq (5), from the first pressure to the second: positive into the chamber, in Pa."""

    def through(p_outer: float, p_chamber: float) -> float:
        if p_outer >= p_chamber:
            return p_outer * reduced(p_chamber / p_outer)
        return -p_chamber * reduced(p_outer / p_chamber)

    return through


def dry_friction(p: PneumaticParameters) -> Callable[[float], float]:
    """Return F_f of eq (1) without its viscous part."""
    coulomb, excess = p.coulomb_friction, p.static_friction - p.coulomb_friction
    stribeck, smoothing = p.stribeck_velocity, p.friction_smoothing

    def friction(v: float) -> float:
        return (coulomb + excess * math.exp(-((v / stribeck) ** 2))) * math.tanh(v / smoothing)

    return friction


def end_stop(p: PneumaticParameters) -> Callable[[float, float], float]:
    """Return the force of the end stops, positive at the positive end."""
    end, stiffness, damping = p.stroke / 2, p.stop_stiffness, p.stop_damping

    def stop(y: float, v: float) -> float:
        if y > end:
            return stiffness * (y - end) * max(0.0, 1 + damping * v)
        if y < -end:
            return stiffness * (y + end) * max(0.0, 1 - damping * v)
        return 0.0

    return stop
