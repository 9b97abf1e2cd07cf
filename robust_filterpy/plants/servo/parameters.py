"""Physical parameters of the pneumatic servo, in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

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
        Overlap of the spool as a fraction of its stroke: below it the valve stays closed, see `valve_opening`. Ours:
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
            value = getattr(self, field.name)
            if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
                raise TypeError(f"{field.name}: expected a number, got {type(value).__name__}")
            if not (math.isfinite(value) and (value > 0 or (value == 0 and field.name in _MAY_BE_ZERO))):
                expected = ">= 0" if field.name in _MAY_BE_ZERO else "> 0"
                raise ValueError(f"{field.name}: expected a finite number {expected}, got {value}")
        if self.rod >= self.bore:
            raise ValueError(f"rod: expected less than the bore {self.bore}, got {self.rod}")
        if self.supply_pressure <= self.atmospheric_pressure:
            raise ValueError(
                f"supply_pressure: expected more than the atmosphere's {self.atmospheric_pressure:g} Pa, got "
                f"{self.supply_pressure:g}; pressures are absolute"
            )
        if self.dead_band >= 1:
            raise ValueError(f"dead_band: expected a fraction of the spool's stroke below 1, got {self.dead_band}")
        if self.kappa <= 1:
            raise ValueError(f"kappa: expected more than 1, got {self.kappa}")
        if self.static_friction < self.coulomb_friction:
            raise ValueError(
                f"static_friction: expected at least coulomb_friction {self.coulomb_friction}, got "
                f"{self.static_friction}"
            )
        if not critical_ratio(self.kappa) < self.laminar_ratio <= 1:
            raise ValueError(
                f"laminar_ratio: expected in ({critical_ratio(self.kappa):.4f}, 1], got {self.laminar_ratio}"
            )

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
