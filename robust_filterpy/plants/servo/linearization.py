"""Steady motions of the servo, the matrices about them, and the gains of its position loop, stable or refused."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.signal import cont2discrete

from robust_filterpy._checks import Array, finite

from .equations import (
    NOMINAL_ALPHA,
    PneumaticParameters,
    as_parameters,
    coefficient_functions,
    dry_friction,
    servo_derivatives,
)

#: What is little of a state: m, m/s, Pa, Pa; with command and N as they are, one step of finite differences suits all.
STATE_SCALES = np.array([1e-2, 1e-1, 1e5, 1e5])
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
    parameters: PneumaticParameters | None = None, position: float = 0.0, *, velocity: float = 0.05,
    load: float = 0.0, alpha: float = NOMINAL_ALPHA, beta: float | None = None,
) -> ServoOperatingPoint:  # fmt: skip
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
    from scipy.optimize import brentq

    p = as_parameters(parameters)
    for name, value in (("velocity", velocity), ("load", load)):
        finite(name, value, ())
    if not abs(position) <= p.stroke / 2:
        raise ValueError(f"position: expected within +-{p.stroke / 2:g} m, got {position}")
    alpha, beta = (at(0.0) for at in coefficient_functions(p, alpha, beta))
    force = load + p.spring * position + p.viscous_friction * velocity + dry_friction(p)(velocity)
    push = force + (p.area_a - p.area_b) * p.atmospheric_pressure
    # Without leakage the pressures are those of any speed.
    forward, speed = velocity >= 0, velocity or 1.0
    derivatives = servo_derivatives(p if velocity else replace(p, leakage_area=0.0))

    def balanced(P_b: float) -> float:
        return (p.area_b * P_b + push) / p.area_a

    def rates(P_a: float) -> Array:
        """Return the derivatives of filled and vented pressure with the valve closed, and what a full opening adds."""
        P_b = (p.area_a * P_a - push) / p.area_b
        closed, full = (
            np.array(derivatives(position, speed, P_a, P_b, math.copysign(opening, speed), load, alpha, beta)[2:])
            for opening in (0.0, 1.0)
        )
        return np.array([closed, full - closed])[:, :: 1 if forward else -1]

    def imbalance(P_a: float) -> float:
        return float(np.linalg.det(rates(P_a)))

    # The chamber that is filled is not empty and below the supply, the other one above the atmosphere.
    filled, vented, supply, atmosphere = p.area_a, p.area_b, p.supply_pressure, p.atmospheric_pressure
    least, most = max(balanced(atmosphere), 1e-3 * atmosphere), supply
    if not forward:
        filled, vented, least, most = vented, filled, max(balanced(1e-3 * atmosphere), atmosphere), balanced(supply)
    if least >= most:
        limit = filled * supply - vented * atmosphere - abs(push - force)
        raise ValueError(
            f"load: expected forces that the piston can overcome, up to {limit:.4g} N with friction and spring, got "
            f"{force:.4g} N"
        )
    solvable = imbalance(least) < 0 < imbalance(most)
    P_a = float(brentq(imbalance, least, most, xtol=1e-6, rtol=1e-13)) if solvable else least
    (filling, venting), (added, _) = rates(P_a)
    if not solvable or not filling < 0 < venting:
        raise ValueError(
            f"velocity: expected faster than the leakage moves air, got {velocity} m/s with leakage_area = "
            f"{p.leakage_area:g} m^2"
        )
    opening = -filling / added if velocity else 0.0
    if opening > 1:
        raise ValueError(
            f"velocity: expected what the valve can feed, up to {abs(velocity / opening):.3g} m/s, got {velocity}"
        )
    valve = math.copysign(p.dead_band + (1 - p.dead_band) * opening, velocity)
    P_b = (p.area_a * P_a - push) / p.area_b
    return ServoOperatingPoint(float(position), float(velocity), P_a, P_b, valve, float(load))


def state_matrices(
    p: PneumaticParameters, point: ServoOperatingPoint, alpha: float, beta: float
) -> tuple[Array, Array]:
    """Return A (4, 4) and B (4, 2) of the equations at a point."""
    # Forward differences: where the valve is about to open (velocity 0), the derivative is that of the opening valve.
    from scipy.optimize import approx_fprime

    derivatives, scales = servo_derivatives(p), np.append(STATE_SCALES, [1.0, 1.0])

    def rates(scaled: Array) -> Array:
        return np.array(derivatives(*(scaled * scales).tolist(), alpha, beta)) / STATE_SCALES

    jacobian = approx_fprime(np.array(point) / scales, rates, _STEP) * STATE_SCALES[:, None] / scales
    return jacobian[:, :4], jacobian[:, 4:]


#: The row that takes states to the position.
_POSITION = np.eye(1, 4)
#: Bandwidth of the loop, and damping ratio that the feedback of acceleration adds: our choice.
_BANDWIDTH, _ADDED_DAMPING = 0.1, 0.1
#: Where the loop is tested: shares of the half stroke, and velocities in m/s.
_POSITIONS, _VELOCITIES = (-0.8, 0.0, 0.8), (-0.05, 0.05)


class UnstableLoopError(ValueError):
    """Refuse a position loop whose linear model has a pole outside the unit circle."""


class PositionGains(NamedTuple):
    """Hold the gains of the position loop, ``opening = gain (r - y) - damping y''``.

    Attributes
    ----------
    gain : float
        Opening per position error, in 1/m.
    damping : float
        Opening per acceleration, in s^2/m.
    """

    gain: float
    damping: float


def position_gains(parameters: PneumaticParameters | None = None) -> PositionGains:
    """Schedule the gains of the position loop by the linear model in mid-stroke.

    Valve to position is an integrator of gain K and the resonance omega of the moving mass on its air springs. The loop
    gets a tenth of the resonance as its bandwidth, and the feedback of acceleration adds .1 to the damping ratio::

        gain = 0.1 omega / K,    damping = 0.2 / (K omega)

    Parameters
    ----------
    parameters : PneumaticParameters, optional

    Returns
    -------
    PositionGains

    Raises
    ------
    TypeError
        If parameters is of another kind.

    Examples
    --------
    >>> for mass in (1.0, 5.0):
    ...     gains = position_gains(PneumaticParameters(mass=mass))
    ...     print(f"{gains.gain:.2f} {gains.damping:.1e}")
    1.40 4.7e-04
    0.63 1.0e-03
    """
    p = without_dry_friction(as_parameters(parameters))
    point = operating_point(p)
    A, _ = state_matrices(p, point, NOMINAL_ALPHA, NOMINAL_ALPHA * p.discharge_coefficient)
    resonance = float(np.abs(np.linalg.eigvals(A)).max())
    slope = point.velocity * (1 - p.dead_band) / (point.valve - p.dead_band)
    return PositionGains(_BANDWIDTH * resonance / slope, 2 * _ADDED_DAMPING / (slope * resonance))


def check_loop(p: PneumaticParameters, dt: float, gains: PositionGains, betas: Iterable[float]) -> None:
    """Raise UnstableLoopError if the sampled loop is unstable anywhere on the stroke, in either direction."""
    sliding = without_dry_friction(p)
    for beta, share, velocity in itertools.product(betas, _POSITIONS, _VELOCITIES):
        position = share * p.stroke / 2
        point = operating_point(sliding, position, velocity=velocity, beta=beta)
        A, B = state_matrices(sliding, point, NOMINAL_ALPHA, beta)
        # The controller steps over the dead band: it commands an opening.
        a, b = sampled(A, B[:, :1] * (1 - p.dead_band), dt)
        radius = float(np.abs(np.linalg.eigvals(a - b @ feedback(A, gains))).max())
        if radius >= 1:
            raise UnstableLoopError(
                f"position loop: expected a stable one, found a pole of size {radius:.4f} for gain={gains.gain:.3g}, "
                f"damping={gains.damping:.3g}, dt={dt:g} with mass={p.mass:g}, beta={beta:.3g} at position "
                f"{position:.3g}, velocity {velocity:g}; leave gain and damping out, or take those of "
                "position_gains(parameters), or a smaller dt"
            )


def without_dry_friction(p: PneumaticParameters) -> PneumaticParameters:
    """Return the parameters without Coulomb and static friction: the least damped loop."""
    return replace(p, coulomb_friction=0.0, static_friction=0.0)


def sampled(A: Array, B: Array, dt: float) -> tuple[Array, Array]:
    """Return A and B with the inputs held over dt."""
    n, m = B.shape
    return cont2discrete((A, B, np.eye(n), np.zeros((n, m))), dt)[:2]


def feedback(A: Array, gains: PositionGains) -> Array:
    """Return the row that takes states to minus the opening."""
    return gains.gain * _POSITION + gains.damping * A[1:2]


def chosen_gains(p: PneumaticParameters, gain: float | None, damping: float | None) -> PositionGains:
    """Return the gains of the loop: those given, checked, and for the others those that the parameters ask for."""
    scheduled = position_gains(p)
    given = PositionGains(*(old if new is None else new for old, new in zip(scheduled, (gain, damping), strict=True)))
    for name, value in given._asdict().items():
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name}: expected a finite number >= 0, got {value}")
    return given
