"""The pneumatic servo: the paper's eqs (1)-(7), its position loop, operating points and linearization."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import control
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from robust_filterpy import Contaminated
from robust_filterpy.plants.servo import PneumaticParameters, pneumatic_servo, position_loop, simulate_servo
from robust_filterpy.plants.servo.equations import reduced_flow, servo_derivatives
from robust_filterpy.plants.servo.linearization import (
    UnstableLoopError,
    operating_point,
    position_gains,
    state_matrices,
    without_dry_friction,
)

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
    assert [p.area_a, p.area_b] == pytest.approx([2.850e-4, 2.534e-4], abs=5e-8)
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


def test_equations_4_and_5_pressure_grows_with_the_flow_through_the_opening_whatever_its_direction():
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


def test_equation_6_beta_joins_heat_and_discharge():
    # The servo's own default is the equation at the nominal temperature.
    x, u = np.array([0.0, 0.1, 3e5, 2e5]), np.array([0.3, 0.0])
    default, explicit = pneumatic_servo(alpha=1.1), pneumatic_servo(alpha=1.1, beta=1.1 * 0.25)
    assert default.dynamics(0, x, u) == pytest.approx(explicit.dynamics(0, x, u), rel=1e-14)
    # At every moment, where alpha is a function of it.
    moving = pneumatic_servo(alpha=lambda t: 1.3 - 0.2 * t)
    assert moving.dynamics(1.0, x, u) == pytest.approx(default.dynamics(0, x, u), rel=1e-14)


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


def test_opening_beyond_the_dead_band_grows_to_full():
    wide, none = servo_derivatives(replace(FIXED, dead_band=0.3)), servo_derivatives(FIXED)
    for y, v, p_a, p_b, u, load in random_states():
        u *= 1.5
        opening = np.interp(u, [-1.0, -0.3, 0.3, 1.0], [-1.0, 0.0, 0.0, 1.0])
        # Within the dead band the side that a closed valve would open to is that of the command.
        expected = none(y, v, p_a, p_b, opening or 0.0, load, ALPHA, BETA)
        assert wide(y, v, p_a, p_b, u, load, ALPHA, BETA) == pytest.approx(expected, rel=1e-12)


# --- motion -------------------------------------------------------------------------------------------------------


def test_end_stops_hold_the_piston():
    end, t, point = P.stroke / 2, np.linspace(0.0, 1.0, 200), operating_point(velocity=0.0)
    start = [0.0, 0.0, point.P_a, point.P_b]
    for sign, area in ((1.0, P.area_a), (-1.0, P.area_b)):
        inputs = np.array([np.full(t.size, sign), np.zeros(t.size)])
        moved = control.input_output_response(pneumatic_servo(), t, inputs, start, solve_ivp_method="LSODA")
        position, velocity = moved.states[:2]
        assert (sign * position).max() < end + P.dead_length
        assert sign * position[-1] == pytest.approx(end + area * 4e5 / P.stop_stiffness, abs=2e-6)
        assert abs(velocity[-1]) < 1e-6


def test_end_stops_never_pull_and_never_return_more_than_they_took():
    rhs = servo_derivatives(replace(FREE, stop_damping=10.0))
    y, balanced = P.stroke / 2 + 1e-4, 1e5
    accelerations = [rhs(y, v, balanced, balanced, 0.0, 0.0, ALPHA, BETA)[1] for v in (-5.0, -0.05, 0.0, 0.05)]
    assert accelerations[0] == pytest.approx(0, abs=1e-9)
    assert 0 > accelerations[1] > accelerations[2] > accelerations[3]


# The servo in its position loop, its operating points and its linearization, against scipy and python-control.


DT, STD = 0.01, np.array([5e-5, 500.0, 500.0])


def reference(n, seed=0):
    return 0.02 * np.where(np.random.default_rng(seed).random(n // 20 + 1) < 0.5, -1.0, 1.0).repeat(20)[:n]


# --- the recording ------------------------------------------------------------------------------------------------


def test_fast_path_agrees_with_python_control():
    dt, n = 0.01, 40
    reference = 0.02 * np.sign(np.sin(0.2 * np.arange(n) + 0.1))
    got = simulate_servo(reference, dt, load=1.0, alpha=1.1, beta=0.3, supply=4.5e5)
    servo, x = pneumatic_servo(alpha=1.1, beta=0.3, supply=4.5e5), np.array([0, 0, got.P_a[0], got.P_b[0]])
    for k in range(n):
        assert np.array(got[3:7])[:, k] == pytest.approx(x, rel=1e-5, abs=1e-5)
        inputs = np.array([[got.valve[k]] * 2, [1.0] * 2])
        x = control.input_output_response(
            servo, [0, dt], inputs, x, solve_ivp_method="LSODA", solve_ivp_kwargs={"rtol": 1e-8, "atol": 1e-8}
        ).states[:, -1]
    assert np.ptp(got.position) > 5e-3


def test_recording_names_every_signal():
    r = reference(50)
    recording = simulate_servo(r, 0.02, alpha=lambda t: 1.1 + 0.1 * t, beta=lambda t: 0.2 + 0.2 * t, load=3.0)
    assert all(signal.shape == (50,) for signal in recording) and len(recording) == 16
    assert recording.t[1] == 0.02 and recording.reference == pytest.approx(r)
    assert recording.alpha == pytest.approx(1.1 + 0.1 * recording.t)
    assert recording.beta == pytest.approx(0.2 + 0.2 * recording.t)
    assert np.all(recording.load == 3.0) and np.all(recording.supply == 5e5)
    # Without sensors in the way, what is measured and what the controller takes for the motion is the motion.
    assert np.array_equal(recording.position_measured, recording.position)
    assert np.array_equal(recording.P_b_measured, recording.P_b)
    assert np.array_equal(recording.position_estimate, recording.position)
    # Where beta is not given it follows alpha.
    recording = simulate_servo(np.zeros(20), 0.01, alpha=np.linspace(1.0, 1.3, 20))
    assert recording.beta == pytest.approx(0.25 * recording.alpha)


@pytest.mark.parametrize("dt", [0.005, 0.01, 0.02])
@pytest.mark.parametrize("beta", [0.1, 0.3, 0.5])
def test_loop_settles_at_the_reference_over_the_range_it_is_made_for(dt, beta):
    recording = simulate_servo(np.full(round(4 / dt), 0.015), dt, beta=beta)
    assert recording.position[-1] == pytest.approx(0.015, abs=1e-3)
    assert np.abs(recording.velocity[-20:]).max() < 2e-3


# --- operating points and linear models ---------------------------------------------------------------------------


@pytest.mark.parametrize("velocity", [-0.3, -0.01, 0.05, 0.5])
@pytest.mark.parametrize(("position", "load"), [(0.0, 0.0), (0.03, 10.0), (-0.03, -40.0)])
def test_operating_point_is_a_steady_motion(velocity, position, load):
    point = operating_point(position=position, velocity=velocity, load=load, alpha=1.3, beta=0.25)
    rates = servo_derivatives(P)(*point, 1.3, 0.25)
    assert rates[0] == velocity
    assert rates[1:] == pytest.approx((0, 0, 0), abs=1e-3)
    assert abs(point.valve) > P.dead_band
    # A load that pulls along may hold the vented chamber above the supply; nothing else leaves the range.
    assert 1e5 < min(point.P_a, point.P_b) and (point.P_a if velocity > 0 else point.P_b) < 5e5
    assert max(point.P_a, point.P_b) < 5e5 or load * velocity < 0
    assert np.sign(point.valve) == np.sign(velocity)


def test_zero_velocity_is_the_limit_of_creeping():
    tight = replace(P, leakage_area=0.0, coulomb_friction=0.0, static_friction=0.0)
    creeping, still = operating_point(tight, velocity=1e-9), operating_point(velocity=0.0)
    assert still.valve == P.dead_band and still[2:4] == pytest.approx(creeping[2:4], rel=1e-6)


def test_linearization_is_the_jacobian_of_the_equations():
    steady = operating_point(position=0.01, velocity=0.08, load=5.0, alpha=1.1, beta=0.4)
    rhs, point, found = servo_derivatives(P), np.array(steady), np.hstack(state_matrices(P, steady, 1.1, 0.4))
    for got, step in zip(found.T, np.diag([1e-6, 1e-6, 10.0, 10.0, 1e-6, 1e-3]), strict=True):
        column = (np.array(rhs(*point + step, 1.1, 0.4)) - rhs(*point - step, 1.1, 0.4)) / (2 * step.sum())
        assert got == pytest.approx(column, abs=1e-4 * np.abs(column).max() + 1e-3)


def test_dry_friction_freezes_the_linear_model_at_standstill_unless_it_is_left_out():
    for velocity, p, slope in ((0.0, P, 7.4 / 1e-3 + 4.47), (0.0, without_dry_friction(P), 4.47), (0.1, P, 4.47)):
        A, _ = state_matrices(p, operating_point(p, velocity=velocity), ALPHA, 0.3)
        assert A[1, 1] == pytest.approx(-slope, rel=1e-3)


def radius(p, beta, dt, **loop):
    """Largest pole of python-control's model of the loop, over the stroke and in both directions."""
    gain, damping = (loop.get(name, chosen) for name, chosen in position_gains(p)._asdict().items())
    largest, p = 0.0, without_dry_friction(p)
    for y, v in product((-0.03, 0.0, 0.03), (-0.05, 0.05)):
        A, B = state_matrices(p, operating_point(p, y, velocity=v, beta=beta), 1.2, beta)
        # Position and acceleration from the opening: the controller steps over the dead band.
        seen = np.vstack((np.eye(1, 4), A[1]))
        plant = control.c2d(control.ss(A, B[:, :1] * (1 - p.dead_band), seen, np.zeros((2, 1))), dt)
        closed = control.feedback(plant, control.ss([], [], [], [[gain, damping]], dt))
        largest = max(largest, np.abs(closed.poles()).max())
    return largest


@pytest.mark.parametrize("mass", [0.3, 1.0, 5.0, 50.0])
def test_the_default_loop_is_stable_where_its_docstring_says_so(mass):
    p = replace(P, mass=mass)
    for dt in (0.005, 0.01, 0.02)[: 3 if mass >= 1 else 2]:
        assert max(radius(p, beta, dt) for beta in (0.1, 0.3, 0.5)) < 1
        simulate_servo(np.zeros(3), dt, p, beta=[0.1, 0.5, 0.3])


def test_an_unstable_loop_is_refused_by_name_where_its_poles_are_outside():
    for options in (dict(mass=5.0, gain=1.5, damping=5e-4), dict(mass=1.0, damping=0.0), dict(mass=1.0, gain=8.0)):
        p, gains = replace(P, mass=options["mass"]), {k: v for k, v in options.items() if k != "mass"}
        assert radius(p, 0.3, 0.01, **gains) > 1
        with pytest.raises(UnstableLoopError, match=r"position loop: .* pole of size 1\.\d+ for gain=.* with mass="):
            simulate_servo(np.zeros(3), 0.01, p, **gains)
    assert issubclass(UnstableLoopError, ValueError)


def test_a_failing_solver_is_not_passed_over(monkeypatch):
    real = position_loop.odeint
    monkeypatch.setattr(position_loop, "odeint", lambda *args, **kwargs: real(*args, **{**kwargs, "mxstep": 1}))
    with pytest.warns(), pytest.raises(RuntimeError, match=r"the ODE solver failed between 0 and 0.01 s"):
        simulate_servo(np.full(5, 0.01), 0.01)


# The servo's loop on sensors that err.


def sensor_noise(n, contamination, seed, factor=40.0):
    rng = np.random.default_rng(seed)
    return np.column_stack([Contaminated(contamination, factor, s).rvs(size=n, random_state=rng) for s in STD])


def drive(noise, **options):
    return simulate_servo(reference(len(noise)), DT, noise=noise, **options)


def test_readings_are_the_truth_with_the_noise_that_was_given():
    noise = sensor_noise(40, 0.2, 1)
    recording = drive(noise)
    assert recording.position_measured == pytest.approx(recording.position + noise[:, 0], abs=1e-15)
    assert recording.P_a_measured == pytest.approx(recording.P_a + noise[:, 1])
    assert recording.P_b_measured == pytest.approx(recording.P_b + noise[:, 2])
    # Without an observer the sensors are not in the loop.
    assert np.array_equal(drive(noise).position, drive(np.zeros((40, 3))).position)


def test_the_loop_runs_on_what_the_observer_says():
    heard = []

    def observer(readings, valve):
        heard.append((readings.copy(), valve))
        return 0.5 * readings[0], 3.0

    noise = sensor_noise(60, 0.1, 2)
    recording = simulate_servo(np.full(60, 0.01), DT, noise=noise, observer=observer, gain=1.2, damping=5e-4)
    readings, commands = (np.array(column) for column in zip(*heard, strict=True))
    assert readings[:, 0] == pytest.approx(recording.position_measured)
    assert readings[:, 2] == pytest.approx(recording.P_b_measured)
    assert commands[0] == 0 and commands[1:] == pytest.approx(recording.valve[:-1])
    assert recording.position_estimate == pytest.approx(0.5 * recording.position_measured)
    assert np.all(recording.acceleration_estimate == 3.0)
    opening = 1.2 * (0.01 - 0.5 * recording.position_measured) - 5e-4 * 3.0
    assert recording.valve == pytest.approx(np.sign(opening) * (0.009 + 0.991 * np.abs(opening)))
