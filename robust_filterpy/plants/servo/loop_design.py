"""Gains of the servo's position loop, from its linear model, and the refusal of a loop that is not stable."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from robust_filterpy._checks import Array

from .parameters import NOMINAL_ALPHA, PneumaticParameters, as_parameters
from .steady_motion import STATE_SCALES, operating_point, state_matrices

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
