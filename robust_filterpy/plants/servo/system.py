"""The pneumatic servo actuator of the paper's section 2 as a nonlinear python-control system.

A five-port valve fills one chamber of a double-acting cylinder from the supply and vents the other. ``u > 0`` fills
chamber a and drives the piston towards positive positions. The position is counted from the middle of the stroke.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .coefficients import ALPHA_RANGE, BETA_RANGE, Coefficient, beta_coefficient, coefficient_function
from .equations import INPUTS, STATES, servo_derivatives
from .parameters import NOMINAL_ALPHA, PneumaticParameters, as_parameters

if TYPE_CHECKING:
    import control


def pneumatic_servo(
    parameters: PneumaticParameters | None = None,
    *,
    alpha: Coefficient = NOMINAL_ALPHA,
    beta: Coefficient | None = None,
    supply: Coefficient | None = None,
    outputs: Sequence[str] = STATES,
    name: str = "pneumatic_servo",
) -> control.NonlinearIOSystem:
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
    alpha : float, callable or (times, values)
        Heat coefficient, dimensionless, within [1, 1.3997]; a function of time in s, or a path that is interpolated
        linearly.
    beta : float, callable or (times, values), optional
        Bound parameter, within [0.075, 1.3297]. By default eq (6) with the parameters' discharge coefficient and the
        nominal temperature: ``alpha(t) C_d``.
    supply : float, callable or (times, values), optional
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
        If alpha, beta or supply is of none of the three kinds.

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
    if not callable(alpha) and not isinstance(alpha, tuple):
        constant = beta_coefficient(alpha_at(0.0), discharge)
        return alpha_at, lambda t: constant
    return alpha_at, coefficient_function(lambda t: alpha_at(t) * discharge, "beta", BETA_RANGE)
