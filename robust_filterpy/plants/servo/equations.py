"""The equations of the pneumatic servo, (1)-(7) with the print corrected, and their parameters in SI units.

A five-port valve fills one chamber of a double-acting cylinder from the supply and vents the other. ``u > 0`` fills
chamber a and drives the piston towards positive positions. The position is counted from the middle of the stroke.

alpha(t) and beta(t) of eqs (2) and (6) are uncertain: alpha is the polytropic exponent of the air in the chambers (1:
isothermal, kappa: adiabatic); beta joins it with the discharge coefficient of the valve and the temperature of the gas.
Both are known only within a range, and wander in it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from robust_filterpy._checks import Array, numbers, real

if TYPE_CHECKING:
    import control

#: Heat coefficient where none is given: halfway between isothermal and adiabatic.
NOMINAL_ALPHA = 1.2

_MAY_BE_ZERO = frozenset(
    ("rod", "viscous_friction", "coulomb_friction", "static_friction", "spring", "dead_band", "leakage_area")
    + ("stop_damping",)
)


@dataclass(frozen=True)
class PneumaticParameters:
    """Hold the physical parameters of the cylinder, the valve and the air, in SI units.

    Attributes
    ----------
    bore, rod, stroke : float
        Diameter of the piston, diameter of the rod (0: none), length of the stroke between the end stops, in m [1]_.
    dead_length : float
        Length of chamber that remains at the end of the stroke, in m. Ours: 5 mm.
    mass : float
        Moving mass: piston, rod and load, in kg. Ours: 1 kg, of which the load is nearly all.
    viscous_friction : float
        beta_e of eq (1), in N s/m [1]_.
    coulomb_friction, static_friction : float
        Kinetic and breakaway level of F_f, in N. 5 % of the piston's force at supply pressure: half of the 10 % that
        the rule of design takes for ordinary cylinders [2]_, as a servo's cylinder has seals of low friction; the
        breakaway level is 1.3 times as high. (The cylinder of [1]_ has 0.486 N, 0.4 %, far below what is on sale.)
    stribeck_velocity : float
        Velocity over which friction falls from the static to the kinetic level, in m/s. Ours: 0.02 m/s.
    friction_smoothing : float
        v_0 of ``tanh(v / v_0)``, which stands for sgn(v), in m/s. Ours: 1 mm/s.
    spring : float
        k_e of eq (1), in N/m, unloaded at mid-stroke. Ours: none.
    supply_pressure, atmospheric_pressure : float
        Absolute pressures, in Pa [1]_; the supply is the mean of one that varies, see `simulate_servo`.
    temperature : float
        T_S, absolute, of the supply and of the surroundings, in K: the 20 degrees Celsius of ISO 8778.
    kappa, gas_constant : float
        Ratio of the specific heats, and specific gas constant R in J/(kg K), of dry air.
    valve_area : float
        W of eq (4): area of one port at full opening, |u| = 1, in m^2 [1]_.
    discharge_coefficient : float
        C_d of the valve, from which eq (6) makes beta where beta is not given [1]_.
    dead_band : float
        Overlap of the spool as a fraction of its stroke: below it the valve stays closed, see `pneumatic_servo`. Ours:
        1 %; ISO 5598 calls a valve with less than 3 % a servo-valve, one with more a proportional valve.
    leakage_area : float
        Effective area of the gap between the chambers, past the seal of the piston, in m^2. The default lets 0.8 dm3/h
        of free air pass from 7.3 bar absolute, the order of what ISO 10099 grants a new cylinder of this bore; a worn
        seal lets a hundred times as much pass.
    laminar_ratio : float
        Pressure ratio above which the flow is linear in the pressure drop, 0 at equal pressures. Ours: 0.999.
    stop_stiffness, stop_damping : float
        End stops, in N/m and s/m, see `pneumatic_servo`. Ours: full supply pressure sinks 0.07 mm into a stop [3]_.

    Raises
    ------
    ValueError
        If a parameter is not a positive number (rod, spring, friction, dead_band, leakage_area and stop_damping: not
        negative), the rod is not thinner than the bore, the supply not above the atmosphere, kappa not above 1, static
        friction below the kinetic one, dead_band not below 1 or laminar_ratio outside the subsonic range.
    TypeError
        If a parameter is no number.

    References
    ----------
    .. [1] E. Richer and Y. Hurmuzlu, "A high performance pneumatic force actuator system: Part I - Nonlinear
       mathematical model", ASME Journal of Dynamic Systems, Measurement, and Control 122(3), 2000.
    .. [2] P. Croser and F. Ebel, "Pneumatics, Basic Level", Festo Didactic, 2002.
    .. [3] K. H. Hunt and F. R. E. Crossley, "Coefficient of restitution interpreted as damping in vibroimpact", ASME
       Journal of Applied Mechanics 42(2), 1975.

    Examples
    --------
    >>> p = PneumaticParameters()
    >>> print(f"{p.area_a:.3e} {p.area_b:.3e}")
    2.850e-04 2.534e-04
    """

    bore: float = 19.05e-3
    rod: float = 6.35e-3
    stroke: float = 76.2e-3
    dead_length: float = 5e-3
    mass: float = 1.0
    viscous_friction: float = 4.47
    coulomb_friction: float = 5.7
    static_friction: float = 7.4
    stribeck_velocity: float = 0.02
    friction_smoothing: float = 1e-3
    spring: float = 0.0
    supply_pressure: float = 5e5
    atmospheric_pressure: float = 1e5
    temperature: float = 293.15
    kappa: float = 1.4
    gas_constant: float = 287.06
    valve_area: float = 2.815e-5
    discharge_coefficient: float = 0.25
    dead_band: float = 0.01
    leakage_area: float = 1.5e-10
    laminar_ratio: float = 0.999
    stop_stiffness: float = 2e6
    stop_damping: float = 10.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = real(field.name, getattr(self, field.name))
            if not (math.isfinite(value) and (value > 0 or (value == 0 and field.name in _MAY_BE_ZERO))):
                expected = ">= 0" if field.name in _MAY_BE_ZERO else "> 0"
                raise ValueError(f"{field.name}: expected a finite number {expected}, got {value}")
        least, atmosphere = critical_ratio(self.kappa) if self.kappa > 1 else 0.0, self.atmospheric_pressure
        for name, good, expected in (
            ("rod", self.rod < self.bore, f"less than the bore {self.bore}"),
            ("supply_pressure", self.supply_pressure > atmosphere, f"more than the atmosphere's {atmosphere:g} Pa"),
            ("dead_band", self.dead_band < 1, "a fraction of the spool's stroke below 1"),
            ("kappa", self.kappa > 1, "more than 1"),
            ("static_friction", self.static_friction >= self.coulomb_friction,
             f"at least coulomb_friction {self.coulomb_friction}"),
            ("laminar_ratio", least < self.laminar_ratio <= 1, f"in ({least:.4f}, 1]"),
        ):  # fmt: skip
            if not good:
                got = getattr(self, name)
                mended = f"{got:g}; pressures are absolute" if name == "supply_pressure" else got
                raise ValueError(f"{name}: expected {expected}, got {mended}")

    @property
    def area_a(self) -> float:
        """Return the piston area on the head side, in m^2."""
        return math.pi / 4 * self.bore**2

    @property
    def area_b(self) -> float:
        """Return the piston area on the rod side, in m^2."""
        return math.pi / 4 * (self.bore**2 - self.rod**2)


def critical_ratio(kappa: float = 1.4) -> float:
    """Return the pressure ratio below which the flow is choked, 0.528 for air.

    Examples
    --------
    >>> round(critical_ratio(1.4), 4)
    0.5283
    """
    return (2 / (kappa + 1)) ** (kappa / (kappa - 1))


def as_parameters(parameters: PneumaticParameters | None) -> PneumaticParameters:
    """Return the parameters, the default set for None, or refuse what is neither."""
    if parameters is None:
        return PneumaticParameters()
    if not isinstance(parameters, PneumaticParameters):
        raise TypeError(f"parameters: expected PneumaticParameters, got {type(parameters).__name__}")
    return parameters


#: A number, or a function of time.
Coefficient: TypeAlias = "float | Callable[[float], float]"

ALPHA_RANGE = (1.0, 1.3997)
BETA_RANGE = (0.075, 1.3297)


def coefficient_function(value: Coefficient, name: str, limits: tuple[float, float]) -> Callable[[float], float]:
    """Return a coefficient as a function of time that refuses to leave its range."""
    if callable(value):
        return lambda t: float(checked(value(t), f"{name}({t:g})", limits))
    constant = checked(value, name, limits)
    if constant.ndim:
        raise TypeError(
            f"{name}: expected a number or a function of time, got an array of shape {constant.shape}; use "
            f"lambda t: np.interp(t, times, {name})"
        )
    return lambda t: float(constant)


def checked(value: Any, name: str, limits: tuple[float, float]) -> Array:
    """Return value as an array inside limits, or refuse it."""
    array = numbers(name, value)
    if len(outside := array[~(np.isfinite(array) & (array >= limits[0]) & (array <= limits[1]))]):
        raise ValueError(f"{name}: expected finite values in [{limits[0]:g}, {limits[1]:g}], got {outside[0]:g}")
    return array


STATES = ("position", "velocity", "P_a", "P_b")
INPUTS = ("valve", "load")
#: (y, v, P_a, P_b, valve, load, alpha, beta[, supply]) -> (y', v', P_a', P_b')
Derivatives: TypeAlias = Callable[..., tuple[float, float, float, float]]


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
        if abs(y) <= end:
            return 0.0
        side = math.copysign(1.0, y)
        return stiffness * (y - side * end) * max(0.0, 1 + damping * side * v)

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
    opening, what the dead band d leaves of the command, ``sgn(u) max(0, |u| - d) / (1 - d)`` up to 1, and q the leakage
    from a to b past the piston, ``sqrt(R T_S) A_L f`` between the two pressures.

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
    alpha_at, beta_at = coefficient_functions(parameters, alpha, beta)
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


def coefficient_functions(
    parameters: PneumaticParameters, alpha: Coefficient, beta: Coefficient | None
) -> tuple[Callable[[float], float], Callable[[float], float]]:
    """Return alpha and beta as checked functions of time, beta by eq (6) if it is None."""
    alpha_at, discharge = coefficient_function(alpha, "alpha", ALPHA_RANGE), parameters.discharge_coefficient
    if beta is None:
        beta = (lambda t: alpha_at(t) * discharge) if callable(alpha) else alpha_at(0.0) * discharge
    return alpha_at, coefficient_function(beta, "beta", BETA_RANGE)
