"""Operating points of the pneumatic servo and its linearization there, by python-control."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .coefficients import ALPHA_RANGE, BETA_RANGE, beta_coefficient, checked
from .servo_equations import INPUTS, STATES, dry_friction, outer_flow, reduced_flow, servo_derivatives
from .servo_parameters import NOMINAL_ALPHA, PneumaticParameters, as_parameters

if TYPE_CHECKING:
    import control

#: Default position loop: valve opening per position error, in 1/m, and per acceleration, in s^2/m.
GAIN = 1.5
DAMPING = 5e-4

#: What one unit of a scaled state and input is: m, m/s, Pa, Pa; opening, N.
_STATE_SCALES = np.array([1e-2, 1e-1, 1e5, 1e5])
_INPUT_SCALES = np.array([1.0, 1.0])


class ServoOperatingPoint(NamedTuple):
    """Hold a steady motion of the pneumatic servo.

    Attributes
    ----------
    position, velocity : float
        In m from mid-stroke, in m/s.
    P_a, P_b : float
        Absolute pressures, in Pa.
    valve : float
        Opening that keeps the velocity.
    load : float
        Load force, in N.
    """

    position: float
    velocity: float
    P_a: float
    P_b: float
    valve: float
    load: float


class ServoLinearization(NamedTuple):
    """Hold the linear models of the pneumatic servo at an operating point.

    Attributes
    ----------
    point : ServoOperatingPoint
    continuous : control.StateSpace
        Inputs valve and load, states and outputs position, velocity, P_a, P_b; deviations from the point, SI units.
    discrete : control.StateSpace
        The same with its inputs held over dt.
    valve_to_position : control.TransferFunction
        Discrete, m per unit of opening; it has a pole at 1.
    reference_to_position : control.TransferFunction
        Discrete, the loop of `simulate_servo` closed.
    """

    point: ServoOperatingPoint
    continuous: control.StateSpace
    discrete: control.StateSpace
    valve_to_position: control.TransferFunction
    reference_to_position: control.TransferFunction


def operating_point(
    parameters: PneumaticParameters | None = None,
    position: float = 0.0,
    *,
    velocity: float = 0.05,
    load: float = 0.0,
    alpha: float = NOMINAL_ALPHA,
    beta: float | None = None,
) -> ServoOperatingPoint:
    """Find the pressures and the valve opening of a steady motion.

    With the valve closed any pair of pressures in balance with the forces is an equilibrium. A piston that moves
    steadily has one pair alone, whatever its position: in each chamber the flow makes up for the change of volume,
    ``alpha P_i V_i' = beta sqrt(R T_S) W |u| f(P_i)``, and the forces of eq (1) balance. The limit of zero velocity
    is the pair that a servo settles at when it creeps.

    Parameters
    ----------
    parameters : PneumaticParameters, optional
    position : float
        In m from mid-stroke.
    velocity : float
        In m/s; 0 stands for the limit from positive velocities, friction 0.
    load : float
        Load force, in N.
    alpha, beta : float
        Coefficients of eq (2); they decide the opening, not the pressures. beta by default by eq (6), ``alpha C_d``.

    Returns
    -------
    ServoOperatingPoint

    Raises
    ------
    ValueError
        If the position is beyond the stroke, the pressures cannot hold the load, the valve cannot open wide enough for
        the velocity, or alpha or beta leaves its range.

    Examples
    --------
    >>> point = operating_point(velocity=0.1)
    >>> print(f"{point.P_a:.3e} {point.P_b:.3e} {point.valve:.4f}")
    3.837e+05 4.155e+05 0.0181
    """
    p = as_parameters(parameters)
    for name, value in (("velocity", velocity), ("load", load)):
        if not math.isfinite(value):
            raise ValueError(f"{name}: expected a finite number, got {value}")
    if not abs(position) <= p.stroke / 2:
        raise ValueError(f"position: expected within +-{p.stroke / 2:g} m, got {position}")
    alpha, beta = _coefficients(p, alpha, beta)
    force = load + p.spring * position + p.viscous_friction * velocity + dry_friction(p)(velocity)
    p_a, p_b = _steady_pressures(p, force, forward=velocity >= 0)

    outer = outer_flow(reduced_flow(p.kappa, p.laminar_ratio))
    p_o = p.supply_pressure if velocity >= 0 else p.atmospheric_pressure
    full_flow = beta * math.sqrt(p.gas_constant * p.temperature) * p.valve_area * abs(outer(p_o, p_a))
    valve = alpha * p_a * p.area_a * velocity / full_flow if velocity else 0.0
    if abs(valve) > 1:
        raise ValueError(
            f"velocity: expected what the valve can feed, up to {abs(velocity / valve):.3g} m/s, got {velocity}"
        )
    return ServoOperatingPoint(float(position), float(velocity), p_a, p_b, valve, float(load))


def linearize_servo(
    parameters: PneumaticParameters | None = None,
    position: float = 0.0,
    *,
    dt: float,
    velocity: float = 0.05,
    load: float = 0.0,
    alpha: float = NOMINAL_ALPHA,
    beta: float | None = None,
    gain: float = GAIN,
    damping: float = DAMPING,
    friction: str = "full",
) -> ServoLinearization:
    """Linearize the pneumatic servo about a steady motion, with python-control.

    The models have four states. Valve to position is an integrator, the resonance of the mass between the two air
    springs (12 Hz by default in mid-stroke), and one real pole.

    Parameters
    ----------
    parameters : PneumaticParameters, optional
    position : float
        In m from mid-stroke.
    dt : float
        Sampling period of the discrete models, in s.
    velocity : float
        Of the steady motion, in m/s, see Notes.
    load : float
        Load force, in N.
    alpha, beta : float
        Coefficients of eq (2); beta by default by eq (6).
    gain, damping : float
        Of the position loop, in 1/m and s^2/m, as in `simulate_servo`.
    friction : {"full", "viscous"}
        "viscous" leaves the Coulomb, static and Stribeck parts of the friction out.

    Returns
    -------
    ServoLinearization

    Raises
    ------
    ValueError
        If dt is not positive, `friction` is unknown, and as `operating_point`.

    Notes
    -----
    Dry friction is not linear. At standstill its smooth stand-in ``tanh(v / v_0)`` has the slope F_s / v_0, 600 N s/m
    by default: that is a stuck piston, right for motions slower than v_0 alone. Once the piston slides faster than the
    Stribeck velocity, dry friction is a constant force, and its slope is gone: hence the default velocity of 0.05 m/s.
    ``friction="viscous"`` says the same for every velocity. A motion that reverses within the recording sees something
    between the two, a damping that falls as the amplitude grows.

    |u| and the change from supply to atmosphere put a kink at u = 0; at velocity 0 the models are those of u > 0.

    Examples
    --------
    >>> model = linearize_servo(dt=0.01)
    >>> print(abs(model.reference_to_position(1)).round(6))
    1.0
    """
    import control

    p = as_parameters(parameters)
    if not (math.isfinite(dt) and dt > 0):
        raise ValueError(f"dt: expected a finite number > 0, got {dt}")
    if friction not in ("full", "viscous"):
        raise ValueError(f"friction: expected 'full' or 'viscous', got {friction!r}")
    if friction == "viscous":
        p = replace(p, coulomb_friction=0.0, static_friction=0.0)
    point = operating_point(p, position, velocity=velocity, load=load, alpha=alpha, beta=beta)
    alpha, beta = _coefficients(p, alpha, beta)

    # In units of 1 cm and 1 bar one step of finite differences suits every state, and polynomials are well scaled.
    scaled = control.linearize(
        _scaled_servo(p, alpha, beta),
        np.array(point[:4]) / _STATE_SCALES,
        np.array([point.valve, point.load]) / _INPUT_SCALES,
    )
    sampled = control.sample_system(scaled, dt, method="zoh")
    a, b = sampled.A, sampled.B[:, :1]
    row = np.array([[_STATE_SCALES[0], 0.0, 0.0, 0.0]])
    feedback = gain * row + damping * _STATE_SCALES[1] * scaled.A[1:2]
    return ServoLinearization(
        point,
        _in_si_units(scaled),
        _in_si_units(sampled),
        _transfer_function(a, b, row, dt),
        _transfer_function(a - b @ feedback, gain * b, row, dt),
    )


def _coefficients(p: PneumaticParameters, alpha: float, beta: float | None) -> tuple[float, float]:
    """Return alpha and beta as checked floats, beta by eq (6) if it is None."""
    alpha = float(checked(alpha, "alpha", ALPHA_RANGE))
    if beta is None:
        return alpha, beta_coefficient(alpha, p.discharge_coefficient)
    return alpha, float(checked(beta, "beta", BETA_RANGE))


def _steady_pressures(p: PneumaticParameters, force: float, forward: bool) -> tuple[float, float]:
    """Solve force balance and flow balance for the two pressures."""
    from scipy.optimize import brentq

    reduced = reduced_flow(p.kappa, p.laminar_ratio)
    supply, atmosphere = p.supply_pressure, p.atmospheric_pressure
    # Seen from the chamber that is filled, both directions are the same problem.
    filled, vented = (p.area_a, p.area_b) if forward else (p.area_b, p.area_a)
    rod_force = (p.area_a - p.area_b) * atmosphere
    push = force + rod_force if forward else -force - rod_force

    def vented_pressure(pressure: float) -> float:
        return (filled * pressure - push) / vented

    def imbalance(pressure: float) -> float:
        other = vented_pressure(pressure)
        filling = supply / pressure * reduced(pressure / supply) / filled
        return filling - reduced(min(atmosphere / other, 1.0)) / vented

    lowest = max((vented * atmosphere + push) / filled, 1e-3 * atmosphere)
    if lowest >= supply or vented_pressure(supply) <= atmosphere:
        limit = filled * supply - vented * atmosphere
        raise ValueError(
            f"load: expected forces that the piston can overcome, up to {limit - abs(rod_force):.4g} N with "
            f"friction and spring, got {force:.4g} N"
        )
    pressure = float(brentq(imbalance, lowest, supply, xtol=1e-6, rtol=1e-13))
    other = vented_pressure(pressure)
    return (pressure, other) if forward else (other, pressure)


def _scaled_servo(p: PneumaticParameters, alpha: float, beta: float) -> Any:
    """Return the plant of eq (7) in scaled states, all of them outputs."""
    import control

    derivatives = servo_derivatives(p)

    def update(t: float, x: Any, u: Any, params: dict[str, Any]) -> Any:
        state, inputs = x * _STATE_SCALES, u * _INPUT_SCALES
        y, v, p_a, p_b = state.tolist()
        valve, load = inputs.tolist()
        return np.array(derivatives(y, v, p_a, p_b, valve, load, alpha, beta)) / _STATE_SCALES

    return control.NonlinearIOSystem(
        update, lambda t, x, u, params: x, states=list(STATES), inputs=list(INPUTS), outputs=list(STATES), dt=0
    )


def _in_si_units(system: control.StateSpace) -> control.StateSpace:
    """Undo the scaling of states, inputs and outputs."""
    import control

    a = _STATE_SCALES[:, None] * system.A / _STATE_SCALES
    b = _STATE_SCALES[:, None] * system.B / _INPUT_SCALES
    return control.ss(
        a, b, np.eye(4), np.zeros((4, 2)), dt=system.dt, states=list(STATES), inputs=list(INPUTS), outputs=list(STATES)
    )


def _transfer_function(a: Any, b: Any, c: Any, dt: float) -> control.TransferFunction:
    """Return c (z I - a)^-1 b, by the rank-one identity det(zI - a + b c) - det(zI - a)."""
    import control

    denominator = np.poly(a)
    numerator = (np.poly(a - b @ c) - denominator)[1:]
    return control.tf(numerator, denominator, dt)
