"""Linear models of the servo about a steady motion, and the gains of its position loop, stable or refused."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from scipy.linalg import expm

from robust_filterpy._checks import Array, option, positive

from .equations import INPUTS, STATES
from .parameters import NOMINAL_ALPHA, PneumaticParameters, as_parameters
from .steady_motion import (
    INPUT_SCALES,
    STATE_SCALES,
    ServoOperatingPoint,
    coefficients_at,
    operating_point,
    state_matrices,
)

if TYPE_CHECKING:
    import control

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
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    both = expm(block * dt)
    return both[:n, :n], both[:n, n:]


def feedback(A: Array, gains: PositionGains) -> Array:
    """Return the row that takes scaled states to minus the opening."""
    position = np.array([[STATE_SCALES[0], 0.0, 0.0, 0.0]])
    return gains.gain * position + gains.damping * STATE_SCALES[1] * A[1:2]


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
        Discrete, m per unit of the valve's command; it has a pole at 1.
    valve_to_velocity : control.TransferFunction
        Discrete, m/s per unit of the valve's command: the difference of successive positions over dt, which is the
        mean velocity of the period before.
    reference_to_position : control.TransferFunction
        Discrete, the loop of `simulate_servo` closed, its dead band compensated.
    """

    point: ServoOperatingPoint
    continuous: control.StateSpace
    discrete: control.StateSpace
    valve_to_position: control.TransferFunction
    valve_to_velocity: control.TransferFunction
    reference_to_position: control.TransferFunction


def linearize_servo(  # an argument for each quantity of the motion and of the loop, by name
    parameters: PneumaticParameters | None = None,
    position: float = 0.0,
    *,
    dt: float,
    velocity: float = 0.05,
    load: float = 0.0,
    alpha: float = NOMINAL_ALPHA,
    beta: float | None = None,
    gain: float | None = None,
    damping: float | None = None,
    friction: str = "full",
) -> ServoLinearization:
    """Linearize the pneumatic servo about a steady motion.

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
    gain, damping : float, optional
        Of the position loop, in 1/m and s^2/m; by default those of `position_gains`.
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
    Dry friction is not linear. At standstill its smooth stand-in ``tanh(v / v_0)`` has the slope F_s / v_0, 7400 N s/m
    by default: that is a stuck piston, right for motions slower than v_0 alone. Once the piston slides faster than the
    Stribeck velocity, dry friction is a constant force, and its slope is gone: hence the default velocity of 0.05 m/s.
    ``friction="viscous"`` says the same for every velocity. A motion that reverses within the recording sees something
    between the two, a damping that falls as the amplitude grows.

    |u|, its dead band and the change from supply to atmosphere put a kink at u = 0; at velocity 0 the models are those
    of the valve that opens for u > 0.

    Examples
    --------
    >>> model = linearize_servo(dt=0.01)
    >>> print(abs(model.reference_to_position(1)).round(6))
    1.0
    """
    import control

    p = as_parameters(parameters)
    positive("dt", dt)
    option("friction", friction, ("full", "viscous"))
    gains = chosen_gains(p, gain, damping)
    if friction == "viscous":
        p = without_dry_friction(p)
    point = operating_point(p, position, velocity=velocity, load=load, alpha=alpha, beta=beta)
    A, B = state_matrices(p, point, *coefficients_at(p, alpha, beta))

    scaled = control.ss(A, B, np.eye(4), np.zeros((4, 2)))
    held = control.sample_system(scaled, dt, method="zoh")
    a, b = held.A, held.B[:, :1]
    row = np.array([[STATE_SCALES[0], 0.0, 0.0, 0.0]])
    to_position = _transfer_function(a, b, row, dt)
    opening = b * (1 - p.dead_band)
    return ServoLinearization(
        point,
        _in_si_units(scaled),
        _in_si_units(held),
        to_position,
        _differenced(to_position, dt),
        _transfer_function(a - opening @ feedback(A, gains), gains.gain * opening, row, dt),
    )


def chosen_gains(p: PneumaticParameters, gain: float | None, damping: float | None) -> PositionGains:
    """Return the gains of the loop: those given, checked, and for the others those that the parameters ask for."""
    scheduled = position_gains(p)
    given = PositionGains(*(old if new is None else new for old, new in zip(scheduled, (gain, damping), strict=True)))
    for name, value in given._asdict().items():
        if not (math.isfinite(value) and value >= 0):
            raise ValueError(f"{name}: expected a finite number >= 0, got {value}")
    return given


def _in_si_units(system: control.StateSpace) -> control.StateSpace:
    """Undo the scaling of states, inputs and outputs."""
    import control

    a = STATE_SCALES[:, None] * system.A / STATE_SCALES
    b = STATE_SCALES[:, None] * system.B / INPUT_SCALES
    return control.ss(
        a, b, np.eye(4), np.zeros((4, 2)), dt=system.dt, states=list(STATES), inputs=list(INPUTS), outputs=list(STATES)
    )


def _transfer_function(a: Any, b: Any, c: Any, dt: float) -> control.TransferFunction:
    """Return c (z I - a)^-1 b, by the rank-one identity det(zI - a + b c) - det(zI - a)."""
    import control

    denominator = np.poly(a)
    numerator = (np.poly(a - b @ c) - denominator)[1:]
    return control.tf(numerator, denominator, dt)


def _differenced(to_position: control.TransferFunction, dt: float) -> control.TransferFunction:
    """Return (1 - 1/z)/dt times the transfer function: the pole at 1 goes, one at 0 comes."""
    import control

    numerator, denominator = to_position.num[0][0], to_position.den[0][0]
    reduced, _ = np.polydiv(denominator, [1.0, -1.0])
    return control.tf(numerator / dt, np.append(reduced, 0.0), dt)
