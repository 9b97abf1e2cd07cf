"""Physics of the pneumatic servo: the paper's eqs (1)-(7) one by one, and what they come to together."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from robust_filterpy.plants.servo import PneumaticParameters, pneumatic_servo
from robust_filterpy.plants.servo.equations import beta_coefficient, reduced_flow, servo_derivatives, valve_opening
from robust_filterpy.plants.servo.linearization import operating_point
from robust_filterpy.plants.servo.position_loop import simulate_actuator

P = PneumaticParameters()
#: The paper's own plant: no overlap of the spool, no leakage.
PAPER = replace(P, dead_band=0.0, leakage_area=0.0)
# A piston too heavy to move: the chambers are two vessels of constant volume.
FIXED = replace(PAPER, mass=1e12)
FREE = replace(PAPER, viscous_friction=0.0, coulomb_friction=0.0, static_friction=0.0)
ALPHA, BETA = 1.3, 0.4


def textbook_flow(p_up, p_down, kappa=1.4):
    """Flow through a nozzle over C_d A p_up / sqrt(R T), from velocity and density of the isentropic jet."""
    pressure = max(p_down, p_up * (2 / (kappa + 1)) ** (kappa / (kappa - 1)))
    ratio = pressure / p_up
    velocity = math.sqrt(2 * kappa / (kappa - 1) * (1 - ratio ** ((kappa - 1) / kappa)))
    return velocity * ratio ** (1 / kappa)


def dry_friction(v):
    """Coulomb and static friction with the defaults' numbers."""
    return (5.7 + (7.4 - 5.7) * math.exp(-((v / 0.02) ** 2))) * math.tanh(v / 1e-3)


def port_flow(p_outer, p_chamber):
    """Return f of eq (5), positive into the chamber, by the textbook."""
    if p_outer >= p_chamber:
        return p_outer * textbook_flow(p_outer, p_chamber)
    return -p_chamber * textbook_flow(p_chamber, p_outer)


def volumes(p, y):
    half = p.dead_length + p.stroke / 2
    return p.area_a * (half + y), p.area_b * (half - y)


def random_states(n=50, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        yield (
            rng.uniform(-0.037, 0.037), rng.normal(0, 0.2), rng.uniform(0.9e5, 5.5e5), rng.uniform(0.9e5, 5.5e5),
            rng.uniform(-1, 1), rng.normal(0, 20),
        )  # fmt: skip


# --- the reduced flow function -----------------------------------------------------------------------------------


@pytest.mark.parametrize("kappa", [1.1, 1.4, 5 / 3])
def test_flow_is_that_of_an_isentropic_nozzle_and_laminar_at_last(kappa):
    ratios = np.linspace(0, 1, 101)
    exact, found = reduced_flow(kappa, 1.0), reduced_flow(kappa, 0.999)
    assert [exact(ratio) for ratio in ratios] == pytest.approx([textbook_flow(1.0, r, kappa) for r in ratios], abs=1e-8)
    edge, line = exact(0.999), [found(r) for r in (0.9989999, 0.999, 0.9995, 1.0)]
    assert line == pytest.approx([edge, edge, edge / 2, 0.0], rel=1e-4)


# --- one test for each numbered equation --------------------------------------------------------------------------


def test_equation_1_forces_on_the_piston_with_the_atmosphere_on_the_rod():
    p = replace(P, spring=120.0)
    rhs = servo_derivatives(p)
    for y, v, p_a, p_b, u, load in random_states():
        gauge_force = p.area_a * (p_a - 1e5) - p.area_b * (p_b - 1e5)
        expected = (gauge_force - 4.47 * v - dry_friction(v) - 120 * y - load) / p.mass
        assert rhs(y, v, p_a, p_b, u, load, ALPHA, BETA)[1] == pytest.approx(expected, rel=1e-9, abs=1e-9)
    # An open cylinder in the atmosphere does not push its rod.
    assert servo_derivatives(P)(0.0, 0.0, 1e5, 1e5, 0.0, 0.0, ALPHA, BETA)[1] == pytest.approx(0, abs=1e-12)


def test_equation_2_and_3_a_closed_chamber_is_polytropic():
    rhs = servo_derivatives(FREE)
    path = solve_ivp(
        lambda t, x: rhs(*x, 0.0, 0.0, ALPHA, BETA), (0, 0.2), [0.0, 0.3, 3e5, 3e5], "LSODA", rtol=1e-10, atol=1e-11
    )
    for chamber, index in ((2, 0), (3, 1)):
        volume = volumes(P, path.y[0])[index]
        constant = path.y[chamber] * volume**ALPHA
        assert np.ptp(volume) > 0.02 * volume[0]
        assert constant == pytest.approx(constant[0], rel=1e-7)


def test_equation_4_pressure_grows_with_the_flow_through_the_opening():
    """And with what leaks past the piston, at the temperature that the chamber has."""
    rhs = servo_derivatives(replace(PAPER, laminar_ratio=1.0, leakage_area=2e-9))
    for y, _, p_a, p_b, u, load in random_states():
        _, _, dp_a, dp_b = rhs(y, 0.0, p_a, p_b, u, load, ALPHA, BETA)
        outer = (5e5, 1e5) if u > 0 else (1e5, 5e5)
        speed = math.sqrt(287.06 * 293.15)
        scale, leaking = BETA * speed * 2.815e-5 * abs(u), ALPHA * speed * 2e-9 * port_flow(p_a, p_b)
        v_a, v_b = volumes(P, y)
        assert dp_a == pytest.approx((scale * port_flow(outer[0], p_a) - leaking) / v_a, rel=1e-6)
        assert dp_b == pytest.approx((scale * port_flow(outer[1], p_b) + leaking) / v_b, rel=1e-6)


def test_equation_5_the_sign_of_the_flow_follows_the_pressures_not_the_valve():
    rhs = servo_derivatives(FIXED)

    def signs(p_a, p_b, u):
        return tuple(np.sign(rhs(0.0, 0.0, p_a, p_b, u, 0.0, ALPHA, BETA)[2:]).astype(int))

    assert signs(3e5, 3e5, 0.1) == (1, -1)
    assert signs(3e5, 3e5, -0.1) == (-1, 1)
    assert signs(6e5, 0.8e5, 0.1) == (-1, 1)  # back into the supply, in from the atmosphere
    assert signs(0.8e5, 6e5, -0.1) == (1, -1)
    assert signs(5e5, 1e5, 0.1) == (0, 0)
    assert signs(3e5, 3e5, 0.0) == (0, 0)


def test_equation_6_beta_joins_heat_discharge_and_temperature():
    assert beta_coefficient(1.2, 0.25, 1.44) == pytest.approx(0.36)
    assert beta_coefficient([1.0, 1.2], 0.3) == pytest.approx([0.3, 0.36])
    # The servo's own default is the equation at the nominal temperature.
    x, u = np.array([0.0, 0.1, 3e5, 2e5]), np.array([0.3, 0.0])
    default, explicit = pneumatic_servo(alpha=1.1), pneumatic_servo(alpha=1.1, beta=1.1 * 0.25)
    assert default.dynamics(0, x, u) == pytest.approx(explicit.dynamics(0, x, u), rel=1e-14)


def test_equation_7_is_the_dynamics_of_the_python_control_system():
    servo = pneumatic_servo(alpha=lambda t: 1.1 + 0.1 * t, beta=lambda t: 0.2 + 0.1 * t)
    assert isinstance(servo, control.NonlinearIOSystem)
    assert servo.state_labels == servo.output_labels == ["position", "velocity", "P_a", "P_b"]
    assert servo.input_labels == ["valve", "load"] and servo.dt == 0
    rhs = servo_derivatives(P)
    for *x, u, load in random_states(10):
        got = servo.dynamics(1.0, np.array(x), np.array([u, load]))
        assert got == pytest.approx(rhs(*x, u, load, 1.2, 0.3), rel=1e-14)
        assert got[0] == x[1]
        assert servo.output(1.0, np.array(x), np.array([u, load])) == pytest.approx(x)
    chosen = pneumatic_servo(outputs=["P_b", "position"])
    assert chosen.output(0, np.array([1.0, 2.0, 3.0, 4.0]), np.zeros(2)).tolist() == [4.0, 1.0]


def test_default_leakage_areas_and_friction_are_those_of_cylinders_on_sale():
    assert pytest.approx([2.850e-4, 2.534e-4], abs=5e-8) == [P.area_a, P.area_b]
    # Free air: 20 degrees Celsius, 1 bar. From a chamber at 7.3 bar to the atmosphere.
    mass_flow = P.leakage_area * port_flow(7.3e5, 1e5) * -1 / math.sqrt(P.gas_constant * P.temperature)
    free_air = abs(mass_flow) * P.gas_constant * P.temperature / 1e5
    assert free_air * 3600e3 == pytest.approx(0.8, rel=0.2)
    force = P.area_a * (P.supply_pressure - P.atmospheric_pressure)
    assert 0.03 < P.coulomb_friction / force < P.static_friction / force < 0.10


def test_opening_beyond_the_dead_band_grows_to_full():
    assert valve_opening([-1.0, -0.03, -0.02, 0.0, 0.02, 0.51, 1.0, 7.0], 0.02) == pytest.approx(
        [-1.0, -0.01 / 0.98, 0.0, 0.0, 0.0, 0.5, 1.0, 1.0]
    )
    wide, none = servo_derivatives(replace(FIXED, dead_band=0.3)), servo_derivatives(FIXED)
    for y, v, p_a, p_b, u, load in random_states():
        expected = none(y, v, p_a, p_b, valve_opening(u, 0.3), load, ALPHA, BETA)
        assert wide(y, v, p_a, p_b, u, load, ALPHA, BETA) == pytest.approx(expected, rel=1e-12)


def test_a_push_of_less_than_static_friction_hardly_moves_the_piston():
    point = operating_point(velocity=0.0)
    held = simulate_actuator(np.zeros(50), 0.01, initial=[0, 0, point.P_a + 0.9 * 7.4 / P.area_a, point.P_b])
    # Slower than v_0.
    assert np.abs(held.velocity).max() < 2e-3


# --- motion -------------------------------------------------------------------------------------------------------


def test_end_stops_hold_the_piston():
    end = P.stroke / 2
    for sign, area in ((1.0, P.area_a), (-1.0, P.area_b)):
        recording = simulate_actuator(np.full(200, sign), 0.005)
        assert (sign * recording.position).max() < end + P.dead_length
        assert sign * recording.position[-1] == pytest.approx(end + area * 4e5 / P.stop_stiffness, abs=2e-6)
        assert abs(recording.velocity[-1]) < 1e-6


def test_end_stops_never_pull_and_never_return_more_than_they_took():
    rhs = servo_derivatives(replace(FREE, stop_damping=10.0))
    y, balanced = P.stroke / 2 + 1e-4, 1e5
    accelerations = [rhs(y, v, balanced, balanced, 0.0, 0.0, ALPHA, BETA)[1] for v in (-5.0, -0.05, 0.0, 0.05)]
    assert accelerations[0] == pytest.approx(0, abs=1e-9)
    assert 0 > accelerations[1] > accelerations[2] > accelerations[3]
