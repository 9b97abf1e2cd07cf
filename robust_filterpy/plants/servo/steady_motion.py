"""Steady motions of the pneumatic servo, and the derivative of its equations there."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robust_filterpy._checks import Array

from .equations import dry_friction, port_flow, reduced_flow, servo_derivatives
from .parameters import (
    ALPHA_RANGE,
    BETA_RANGE,
    NOMINAL_ALPHA,
    PneumaticParameters,
    as_parameters,
    beta_coefficient,
    checked,
)

#: What one unit of a scaled state and input is: m, m/s, Pa, Pa; command, N. One step of finite differences suits all.
STATE_SCALES = np.array([1e-2, 1e-1, 1e5, 1e5])
INPUT_SCALES = np.array([1.0, 1.0])
_STEP = 1e-6


class ServoOperatingPoint(NamedTuple):
    """Hold a steady motion of the pneumatic servo.

    Attributes
    ----------
    position, velocity : float
        In m from mid-stroke, in m/s.
    P_a, P_b : float
        Absolute pressures, in Pa.
    valve : float
        Command that keeps the velocity, a fraction of the spool's stroke, its dead band included.
    load : float
        Load force, in N.
    """

    position: float
    velocity: float
    P_a: float
    P_b: float
    valve: float
    load: float


def operating_point(
    parameters: PneumaticParameters | None = None,
    position: float = 0.0,
    *,
    velocity: float = 0.05,
    load: float = 0.0,
    alpha: float = NOMINAL_ALPHA,
    beta: float | None = None,
) -> ServoOperatingPoint:
    """Find the pressures and the valve command of a steady motion.

    With the valve closed any pair of pressures in balance with the forces is an equilibrium, but for the leakage. A
    piston that moves steadily has one pair alone, whatever its position: in each chamber the flow makes up for the
    change of volume and for the leakage q from a to b, and the forces of eq (1) balance::

        beta sqrt(R T_S) W |u| f(P_a) = alpha (P_a V_a' + q),    beta sqrt(R T_S) W |u| f(P_b) = alpha (P_b V_b' - q)

    The limit of zero velocity, without leakage, is the pair that a servo settles at when it creeps.

    Parameters
    ----------
    parameters : PneumaticParameters, optional
    position : float
        In m from mid-stroke.
    velocity : float
        In m/s; 0 stands for the limit from positive velocities, without friction and leakage, the valve about to open.
    load : float
        Load force, in N.
    alpha, beta : float
        Coefficients of eq (2); they decide the command, not the pressures. beta by default by eq (6), ``alpha C_d``.

    Returns
    -------
    ServoOperatingPoint

    Raises
    ------
    ValueError
        If the position is beyond the stroke, the pressures cannot hold the load, the valve cannot open wide enough for
        the velocity, the leakage is as large as the flow that moves the piston, or alpha or beta leaves its range.

    Examples
    --------
    >>> point = operating_point(velocity=0.1)
    >>> print(f"{point.P_a:.2e} {point.P_b:.2e} {point.valve:.4f}")
    3.84e+05 3.95e+05 0.0279
    """
    p = as_parameters(parameters)
    for name, value in (("velocity", velocity), ("load", load)):
        if not math.isfinite(value):
            raise ValueError(f"{name}: expected a finite number, got {value}")
    if not abs(position) <= p.stroke / 2:
        raise ValueError(f"position: expected within +-{p.stroke / 2:g} m, got {position}")
    alpha, beta = coefficients_at(p, alpha, beta)
    force = load + p.spring * position + p.viscous_friction * velocity + dry_friction(p)(velocity)
    pressures = _steady_pressures(p, force, velocity)

    through = port_flow(reduced_flow(p.kappa, p.laminar_ratio))
    speed = math.sqrt(p.gas_constant * p.temperature)
    filled = p.supply_pressure if velocity >= 0 else p.atmospheric_pressure
    full_flow = beta * speed * p.valve_area * through(filled, pressures[0])
    flow = alpha * (pressures[0] * p.area_a * velocity + speed * p.leakage_area * through(*pressures))
    opening = flow / full_flow if velocity else 0.0
    if opening > 1:
        raise ValueError(
            f"velocity: expected what the valve can feed, up to {abs(velocity / opening):.3g} m/s, got {velocity}"
        )
    valve = math.copysign(p.dead_band + (1 - p.dead_band) * opening, velocity)
    return ServoOperatingPoint(float(position), float(velocity), *pressures, valve, float(load))


def coefficients_at(p: PneumaticParameters, alpha: float, beta: float | None) -> tuple[float, float]:
    """Return alpha and beta as checked floats, beta by eq (6) if it is None."""
    alpha = float(checked(alpha, "alpha", ALPHA_RANGE))
    if beta is None:
        return alpha, beta_coefficient(alpha, p.discharge_coefficient)
    return alpha, float(checked(beta, "beta", BETA_RANGE))


def state_matrices(
    p: PneumaticParameters, point: ServoOperatingPoint, alpha: float, beta: float
) -> tuple[Array, Array]:
    """Return A (4, 4) and B (4, 2) of the equations at a point, for x / STATE_SCALES and u / INPUT_SCALES."""
    # Forward differences: where the valve is about to open (velocity 0), the derivative is that of the opening valve.
    from scipy.optimize import approx_fprime

    derivatives, scales = servo_derivatives(p), np.concatenate((STATE_SCALES, INPUT_SCALES))

    def rates(scaled: Array) -> Array:
        return np.array(derivatives(*(scaled * scales).tolist(), alpha, beta)) / STATE_SCALES

    jacobian = approx_fprime(np.array(point) / scales, rates, _STEP)
    return jacobian[:, :4], jacobian[:, 4:]


def _steady_pressures(p: PneumaticParameters, force: float, velocity: float) -> tuple[float, float]:
    """Solve force balance and flow balance for the two pressures."""
    from scipy.optimize import brentq

    reduced = reduced_flow(p.kappa, p.laminar_ratio)
    through = port_flow(reduced)
    supply, atmosphere, forward = p.supply_pressure, p.atmospheric_pressure, velocity >= 0
    # Seen from the chamber that is filled, both directions are the same problem.
    filled, vented = (p.area_a, p.area_b) if forward else (p.area_b, p.area_a)
    rod_force = (p.area_a - p.area_b) * atmosphere
    push = force + rod_force if forward else -force - rod_force
    # What leaks past the seal per m/s of the piston, as a volume at unit pressure.
    gap = math.sqrt(p.gas_constant * p.temperature) * p.leakage_area / abs(velocity) if velocity else 0.0

    def vented_pressure(pressure: float) -> float:
        return (filled * pressure - push) / vented

    def flows(pressure: float) -> tuple[float, float]:
        """Return what enters one chamber and leaves the other, over the velocity."""
        other = vented_pressure(pressure)
        leak = gap * through(pressure, other)
        return filled * pressure + leak, vented * other + leak

    def imbalance(pressure: float) -> float:
        (entering, leaving), other = flows(pressure), vented_pressure(pressure)
        return supply * reduced(pressure / supply) * leaving - other * reduced(min(atmosphere / other, 1.0)) * entering

    lowest = max((vented * atmosphere + push) / filled, 1e-3 * atmosphere)
    if lowest >= supply or vented_pressure(supply) <= atmosphere:
        limit = filled * supply - vented * atmosphere
        raise ValueError(
            f"load: expected forces that the piston can overcome, up to {limit - abs(rod_force):.4g} N with "
            f"friction and spring, got {force:.4g} N"
        )
    solvable = imbalance(lowest) > 0 > imbalance(supply)
    pressure = float(brentq(imbalance, lowest, supply, xtol=1e-6, rtol=1e-13)) if solvable else lowest
    if not solvable or min(flows(pressure)) <= 0:
        raise ValueError(
            f"velocity: expected faster than the leakage moves air, got {velocity} m/s with leakage_area = "
            f"{p.leakage_area:g} m^2"
        )
    other = vented_pressure(pressure)
    return (pressure, other) if forward else (other, pressure)
