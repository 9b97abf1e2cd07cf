"""Linear models of the servo about a steady motion, by python-control: valve to velocity, reference to position."""

from __future__ import annotations

from typing import NamedTuple

import control
import numpy as np
from scipy.signal import ss2tf

from robust_filterpy.plants.servo import PneumaticParameters
from robust_filterpy.plants.servo.linearization import (
    feedback,
    operating_point,
    position_gains,
    sampled,
    state_matrices,
    without_dry_friction,
)


class LinearServo(NamedTuple):
    """Discrete transfer functions."""

    valve_to_velocity: control.TransferFunction  # m/s per unit of the command: mean velocity of the period before
    reference_to_position: control.TransferFunction  # of the loop of `simulate_servo`, its dead band compensated


def opened(command, dead_band: float):
    """Return how far a valve opens: not at all within its dead band, in proportion beyond it."""
    return np.sign(command) * np.clip((np.abs(command) - dead_band) / (1 - dead_band), 0.0, 1.0)


def linearized(
    parameters: PneumaticParameters, dt: float, position: float = 0.0, velocity: float = 0.05, load: float = 0.0,
    alpha: float = 1.2, beta: float | None = None,
) -> LinearServo:  # fmt: skip
    """Linearize the servo about a steady motion, without dry friction.

    Dry friction is not linear: once the piston slides faster than the Stribeck velocity it is a constant force.
    """
    p = without_dry_friction(parameters)
    beta = alpha * p.discharge_coefficient if beta is None else beta
    point = operating_point(p, position, velocity=velocity, load=load, alpha=alpha, beta=beta)
    A, B = state_matrices(p, point, alpha, beta)
    a, b = sampled(A, B, dt)
    gains, opening = position_gains(parameters), b[:, :1] * (1 - p.dead_band)
    to_position = transfer_function(a, b[:, :1], dt)
    closed = transfer_function(a - opening @ feedback(A, gains), gains.gain * opening, dt)
    # (1 - 1/z)/dt: the pole at 1 goes, one at 0 comes.
    numerator, denominator = to_position.num[0][0], np.polydiv(to_position.den[0][0], [1.0, -1.0])[0]
    return LinearServo(control.tf(numerator / dt, np.append(denominator, 0.0), dt), closed)


def transfer_function(a: np.ndarray, b: np.ndarray, dt: float) -> control.TransferFunction:
    """Return what (z I - a)^-1 b says of the position."""
    numerator, denominator = ss2tf(a, b, np.eye(1, 4), np.zeros((1, 1)))
    return control.tf(numerator[0, 1:], denominator, dt)
