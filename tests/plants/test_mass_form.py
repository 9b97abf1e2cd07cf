"""The servo once more, from a textbook of gas dynamics: masses of air, choked orifices, energy of the chambers.

Written without the package's equations. The states are position, velocity, and for each chamber the mass of air (an
isothermal chamber, alpha = 1) or its internal energy (alpha > 1); pressures follow from them by the gas law.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from robust_filterpy.plants.servo import PneumaticParameters, simulate_servo
from robust_filterpy.plants.servo.linearization import operating_point
from robust_filterpy.plants.servo.position_loop import simulate_actuator

P = PneumaticParameters(leakage_area=2e-9, dead_band=0.015)
R, T, KAPPA = 287.06, 293.15, 1.4
BORE, ROD, STROKE, DEAD = 19.05e-3, 6.35e-3, 76.2e-3, 5e-3
AREA = np.pi / 4 * np.array([BORE**2, BORE**2 - ROD**2])
ATMOSPHERE, PORT = 1e5, 2.815e-5
SIDE = np.array([1.0, -1.0])  # a grows with the position, b shrinks
DT, N = 0.01, 250


def mass_flow(area, upstream, downstream):
    """kg/s through an ideal nozzle: choked, isentropic, or, in the last thousandth, linear in the pressures."""
    ratio = downstream / upstream
    choked = np.sqrt(KAPPA / (R * T) * (2 / (KAPPA + 1)) ** ((KAPPA + 1) / (KAPPA - 1)))
    if ratio <= (2 / (KAPPA + 1)) ** (KAPPA / (KAPPA - 1)):
        return area * upstream * choked

    def isentropic(r):
        jet = np.sqrt(2 * KAPPA / (KAPPA - 1) * R * T * (1 - r ** ((KAPPA - 1) / KAPPA)))
        return area * upstream / (R * T) * r ** (1 / KAPPA) * jet

    return isentropic(ratio) if ratio < 0.999 else isentropic(0.999) * (1 - ratio) / 1e-3


def flow_between(area, p_from, p_to):
    return mass_flow(area, p_from, p_to) if p_from >= p_to else -mass_flow(area, p_to, p_from)


def dry_friction(v):
    return (5.7 + 1.7 * np.exp(-((v / 0.02) ** 2))) * np.tanh(v / 1e-3)


def stop_force(y, v):
    depth = abs(y) - STROKE / 2
    return np.sign(y) * 2e6 * depth * max(0.0, 1 + 10 * v * np.sign(y)) if depth > 0 else 0.0


def plant(valve, load, supply, discharge, alpha):
    """Right-hand side for a command held over a period; the state's last two are mass or internal energy."""
    opening = np.sign(valve) * max(0.0, abs(valve) - 0.015) / 0.985
    outside = np.array([supply, ATMOSPHERE] if valve >= 0 else [ATMOSPHERE, supply])

    def pressures(y, content):
        volume = AREA * (DEAD + STROKE / 2 + SIDE * y)
        return content * R * T / volume if alpha == 1 else content * (alpha - 1) / volume

    def rates(_, x):
        y, v, content = x[0], x[1], x[2:]
        p = pressures(y, content)
        port = discharge * PORT * abs(opening)
        entering = np.array([flow_between(port, outside[i], p[i]) for i in (0, 1)])
        entering -= SIDE * flow_between(2e-9, *p)
        force = AREA @ (SIDE * (p - ATMOSPHERE)) - 4.47 * v - dry_friction(v) - stop_force(y, v) - load
        # Air comes with its enthalpy at the temperature of the surroundings, and the chamber works on the piston.
        change = entering if alpha == 1 else alpha / (alpha - 1) * R * T * entering - p * AREA * SIDE * v
        return np.array([v, force / 1.0, *change])

    return rates, pressures


FORMS = pytest.mark.parametrize("alpha", [1.0, 1.25], ids=["mass of air", "internal energy"])


def trajectory(controller, physics, alpha):
    """Positions, pressures and commands of the other form, driven by controller(k, position, acceleration)."""
    start = operating_point(P, velocity=0.0)
    p, volume = np.array([start.P_a, start.P_b]), AREA * (DEAD + STROKE / 2)
    x = np.array([0.0, 0.0, *(p * volume / (R * T) if alpha == 1 else p * volume / (alpha - 1))])
    positions, inside, commands = np.empty(N), np.empty((N, 2)), np.empty(N)
    load, supply, discharge = physics["load"], physics["supply"], physics["discharge"]
    for k in range(N):
        rates, pressures = plant(0.0, load[k], supply[k], discharge[k], alpha)
        positions[k], inside[k] = x[0], pressures(x[0], x[2:])
        commands[k] = controller(k, x[0], rates(0.0, x)[1])
        rates, _ = plant(commands[k], load[k], supply[k], discharge[k], alpha)
        atol = 1e-12 * np.maximum(np.abs(x), [1e-2, 1.0, 0.0, 0.0])
        x = solve_ivp(rates, (0, DT), x, "LSODA", rtol=1e-11, atol=atol).y[:, -1]
    return positions, inside, commands


def physics():
    t = DT * np.arange(N)
    return dict(discharge=0.25 + 0.05 * np.sin(2 * t), load=8.0 * np.sin(3 * t), supply=5e5 - 3e4 * np.cos(4 * t))


def given(physics, alpha):
    """The same in the package's words."""
    return dict(alpha=alpha, beta=alpha * physics["discharge"], load=physics["load"], supply=physics["supply"])


@FORMS
def test_loop_is_that_of_the_mass_form_to_a_tenth_of_a_micrometre(alpha):
    world, reference = physics(), 0.03 * np.sign(np.sin(5 * DT * np.arange(N) + 0.1))

    def controller(k, position, acceleration):
        # The opening asked for, and the step over nine tenths of the overlap.
        opening = 1.2 * (reference[k] - position) - 4e-4 * acceleration
        return np.clip(np.sign(opening) * (0.0135 + 0.9865 * abs(opening)), -1, 1)

    positions, _, commands = trajectory(controller, world, alpha)
    got = simulate_servo(reference, DT, P, gain=1.2, damping=4e-4, rtol=1e-11, **given(world, alpha))
    assert np.abs(got.position - positions).max() < 1e-7
    assert got.valve == pytest.approx(commands, abs=1e-6)
    assert np.ptp(positions) > 0.05


@pytest.mark.nightly
@FORMS
def test_actuator_is_that_of_the_mass_form_from_stop_to_stop(alpha):
    world, valve = physics(), 0.25 * np.sign(np.sin(3 * DT * np.arange(N) + 0.1))
    positions, inside, _ = trajectory(lambda k, *_: valve[k], world, alpha)
    got = simulate_actuator(valve, DT, P, rtol=1e-11, **given(world, alpha))
    assert np.abs(got.position - positions).max() < 1e-7
    assert np.column_stack((got.P_a, got.P_b)) == pytest.approx(inside, rel=1e-6)
    # The run meets what it is meant to try: flow choked, isentropic and linear, and both stops.
    ratios = ATMOSPHERE / inside
    assert ratios.min() < 0.528 and ratios.max() > 0.999
    assert positions.max() > STROKE / 2 and positions.min() < -STROKE / 2
