"""The equations of the pneumatic servo, (1)-(7) with the print corrected: functions of floats, and a nonlinear system.

A five-port valve fills one chamber of a double-acting cylinder from the supply and vents the other. ``u > 0`` fills
chamber a and drives the piston towards positive positions. The position is counted from the middle of the stroke.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from .parameters import (
    ALPHA_RANGE,
    BETA_RANGE,
    NOMINAL_ALPHA,
    Coefficient,
    PneumaticParameters,
    as_parameters,
    beta_coefficient,
    coefficient_function,
    critical_ratio,
)

if TYPE_CHECKING:
    import control

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
    """Return the right-hand side of eq (7) as a lean function of floats."""
    # Everything that runs this plant (`pneumatic_servo`, the fast simulation, the linearization) calls this function.
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

    # Floats, as a solver's thousands of calls want them
    def derivatives(
        y: float, v: float, p_a: float, p_b: float, valve: float, load: float, alpha: float, beta: float,
        supply: float = mean_supply,
    ) -> tuple[float, float, float, float]:  # fmt: skip
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
    """Return f-bar of eq (5), of the pressure downstream over that upstream."""
    # Constant (0.6847 for air) below the critical ratio, where the flow is choked. From laminar_ratio to 1 it is the
    # straight line down to 0; at 1 there is no such line, and the slope there is infinite: an ODE solver then chatters
    # where a chamber has reached the outer pressure. The mass flow through an orifice of area A is ``C_d A P_up
    # f-bar(P_down/P_up) / sqrt(R T)``.
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


def pneumatic_servo(
    parameters: PneumaticParameters | None = None, *, alpha: Coefficient = NOMINAL_ALPHA,
    beta: Coefficient | None = None, supply: Coefficient | None = None, outputs: Sequence[str] = STATES,
    name: str = "pneumatic_servo",
) -> control.NonlinearIOSystem:  # fmt: skip
    """Build the pneumatic servo, eqs (1)-(7), as a nonlinear python-control system.

    ::

        m y'' = A_a P_a - A_b P_b - (A_a - A_b) P_atm - beta_e y' - F_f(y') - k_e y - F_stop - F_ext     (1)
        P_i'  = -alpha P_i V_i'/V_i + beta sqrt(R T_S)/V_i W |o| f(P_i) -+ alpha q/V_i,   i = a, b       (2)-(4)
        f(P)  = P_o fbar(P/P_o) if P_o >= P else -P fbar(P_o/P)                                          (5)

    with V_a = A_a (l + y), V_b = A_b (l - y), l half the stroke plus the dead length. P_o is the supply pressure for
    the chamber that the valve fills (a for u > 0, b for u < 0) and the atmosphere for the one that it vents. o is the
    opening, what the dead band leaves of the command u (`valve_opening`), and q the leakage from a to b past the
    piston, ``sqrt(R T_S) A_L f`` between the two pressures.

    States: `position` (m, from mid-stroke), `velocity` (m/s), `P_a`, `P_b` (Pa, absolute). Inputs: `valve` (u, a
    fraction of the spool's stroke, saturates at -1 and 1), `load` (F_ext, N, opposes positive motion).

    Parameters
    ----------
    parameters : PneumaticParameters, optional
    alpha : float or callable
        Heat coefficient, dimensionless, within [1, 1.3997]; a function of time in s, or a path that is interpolated
        linearly.
    beta : float or callable, optional
        Bound parameter, within [0.075, 1.3297]. By default eq (6) with the parameters' discharge coefficient and the
        nominal temperature: ``alpha(t) C_d``.
    supply : float or callable, optional
        Absolute supply pressure in Pa, at least the atmosphere's. By default the parameters'.
    outputs : sequence of str
        Which of the states are outputs, in which order.
    name : str
        Name of the system.

    Returns
    -------
    control.NonlinearIOSystem
        Continuous time, 4 states, 2 inputs.

    Raises
    ------
    ValueError
        If alpha, beta or supply leaves its range (for a function: when the system is evaluated there), or an output
        is not a state.
    TypeError
        If alpha, beta or supply is neither a number nor a function.

    Notes
    -----
    Departures from the print. (1) lacks the atmosphere's force on the rod, which absolute pressures need. (2), (4): the
    opening is |u|, R the specific gas constant, and the sign of the flow comes from (5) alone. (5): P_o is not one
    pressure but the supply's or the atmosphere's. (7): V_a' = A_a y', V_b' = -A_b y', and the opening multiplies h.
    The paper names leakage, overlap and a supply that varies among what its model leaves out; here they are in it.

    Friction is ``F_f = (F_c + (F_s - F_c) exp(-(v/v_s)^2)) tanh(v/v_0)``: smooth, so a piston that should stick creeps
    instead, slower than v_0 (1 mm/s). The end stops push back with ``k d max(0, 1 + c d')`` at a depth d beyond the
    stroke (Hunt and Crossley), continuous at the contact and never pulling; full supply pressure sinks 0.07 mm in.

    The flow alone can never carry a pressure out of [P_atm, P_supply]. Only motion can: a load (or the momentum of the
    mass) that compresses a chamber at supply pressure, or widens one at atmospheric pressure, faster than its port lets
    air out or in.

    The piston integrates: a constant opening moves it to an end. `simulate_servo` closes a position loop around it.

    Examples
    --------
    >>> servo = pneumatic_servo(outputs=("position",))
    >>> servo.nstates, servo.input_labels, servo.output_labels
    (4, ['valve', 'load'], ['position'])
    """
    import control

    parameters = as_parameters(parameters)
    alpha_at, beta_at = _coefficient_functions(parameters, alpha, beta)
    wrong = [label for label in outputs if label not in STATES]
    if wrong or not outputs or isinstance(outputs, str):
        raise ValueError(f"outputs: expected names out of {STATES}, got {outputs!r}")
    index = [STATES.index(label) for label in outputs]
    derivatives = servo_derivatives(parameters)
    pressure = parameters.supply_pressure if supply is None else supply
    supply_at = coefficient_function(pressure, "supply", (parameters.atmospheric_pressure, math.inf))

    def update(t: float, x: Any, u: Any, params: dict[str, Any]) -> Any:
        y, v, p_a, p_b = x.tolist()
        valve, load = u.tolist()
        return np.array(derivatives(y, v, p_a, p_b, valve, load, alpha_at(t), beta_at(t), supply_at(t)))

    def output(t: float, x: Any, u: Any, params: dict[str, Any]) -> Any:
        return np.asarray(x)[index]

    return control.NonlinearIOSystem(
        update, output, states=list(STATES), inputs=list(INPUTS), outputs=list(outputs), name=name, dt=0
    )


def _coefficient_functions(
    parameters: PneumaticParameters, alpha: Coefficient, beta: Coefficient | None
) -> tuple[Callable[[float], float], Callable[[float], float]]:
    """Return alpha and beta as checked functions of time, beta by eq (6) if it is None."""
    alpha_at = coefficient_function(alpha, "alpha", ALPHA_RANGE)
    if beta is not None:
        return alpha_at, coefficient_function(beta, "beta", BETA_RANGE)
    discharge = parameters.discharge_coefficient
    if not callable(alpha):
        constant = beta_coefficient(alpha_at(0.0), discharge)
        return alpha_at, lambda t: constant
    return alpha_at, coefficient_function(lambda t: alpha_at(t) * discharge, "beta", BETA_RANGE)
