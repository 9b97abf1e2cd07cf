"""The servo in its position loop, its operating points and its linearization, against scipy and python-control."""

from __future__ import annotations

import math
from dataclasses import replace

import control
import numpy as np
import pytest
import scipy.stats

from robust_filterpy.plants.servo import (
    PneumaticParameters,
    pneumatic_servo,
    position_loop,
    random_coefficient,
    simulate_servo,
)
from robust_filterpy.plants.servo.equations import servo_derivatives
from robust_filterpy.plants.servo.linearization import (
    UnstableLoopError,
    linearize_servo,
    operating_point,
    position_gains,
)
from robust_filterpy.plants.servo.position_loop import simulate_actuator

P = PneumaticParameters()


def binary_reference(n, hold, amplitude=0.02, seed=0):
    signs = np.where(np.random.default_rng(seed).random(n // hold + 1) < 0.5, -1.0, 1.0)
    return amplitude * signs.repeat(hold)[:n]


# --- the recording ------------------------------------------------------------------------------------------------


def test_fast_path_agrees_with_python_control():
    dt, n = 0.01, 40
    valve = 0.03 * np.sign(np.sin(0.5 * np.arange(n) + 0.1))
    got = simulate_actuator(valve, dt, load=1.0, alpha=1.1, beta=0.3, supply=4.5e5)
    servo, x = pneumatic_servo(alpha=1.1, beta=0.3, supply=4.5e5), np.array([0, 0, got.P_a[0], got.P_b[0]])
    for k in range(n):
        assert np.array(got[3:7])[:, k] == pytest.approx(x, rel=1e-5, abs=1e-5)
        inputs = np.array([[valve[k]] * 2, [1.0] * 2])
        x = control.input_output_response(
            servo, [0, dt], inputs, x, solve_ivp_method="LSODA", solve_ivp_kwargs={"rtol": 1e-8, "atol": 1e-8}
        ).states[:, -1]
    assert np.ptp(got.position) > 5e-3


def test_recording_names_every_signal():
    r = binary_reference(50, 10)
    recording = simulate_servo(r, 0.02, alpha=lambda t: 1.1 + 0.1 * t, beta=lambda t: 0.2 + 0.2 * t, load=3.0)
    assert recording._fields == (
        "t", "reference", "valve", "position", "velocity", "P_a", "P_b", "alpha", "beta", "load", "supply",
        "position_measured", "P_a_measured", "P_b_measured", "position_estimate", "acceleration_estimate",
    )  # fmt: skip
    assert all(signal.shape == (50,) for signal in recording)
    assert recording.t[1] == 0.02
    assert recording.reference == pytest.approx(r)
    assert recording.alpha == pytest.approx(1.1 + 0.1 * recording.t)
    assert recording.beta == pytest.approx(0.2 + 0.2 * recording.t)
    assert np.all(recording.load == 3.0) and np.all(recording.supply == 5e5)
    # Without sensors in the way, what is measured and what the controller takes for the motion is the motion.
    assert np.array_equal(recording.position_measured, recording.position)
    assert np.array_equal(recording.P_b_measured, recording.P_b)
    assert np.array_equal(recording.position_estimate, recording.position)
    assert np.all(np.isnan(simulate_actuator([0.0, 0.1], 0.01).reference))


def test_beta_follows_alpha_where_it_is_not_given():
    recording = simulate_servo(np.zeros(20), 0.01, alpha=np.linspace(1.0, 1.3, 20))
    assert recording.beta == pytest.approx(0.25 * recording.alpha)


@pytest.mark.parametrize("dt", [0.005, 0.01, 0.02])
@pytest.mark.parametrize("beta", [0.1, 0.3, 0.5])
def test_loop_settles_at_the_reference_over_the_range_it_is_made_for(dt, beta):
    recording = simulate_servo(np.full(round(4 / dt), 0.015), dt, beta=beta)
    assert recording.position[-1] == pytest.approx(0.015, abs=1e-3)
    assert np.abs(recording.velocity[-20:]).max() < 2e-3


def test_a_load_pushes_the_piston_off_its_reference_against_the_load():
    recording = simulate_servo(np.zeros(300), 0.01, load=np.repeat([0.0, 20.0], 150))
    assert abs(recording.position[149]) < 1e-4
    assert recording.position[150:].min() < -5e-4


# --- random coefficients ------------------------------------------------------------------------------------------


def test_random_paths_stay_in_their_bounds_and_move_as_slowly_as_told():
    t = 0.01 * np.arange(200_000)
    path = random_coefficient("beta", t, low=0.2, high=0.4, spread=0.1, rng=3)
    assert path.min() >= 0.2 and path.max() <= 0.4 and path[0] == pytest.approx(0.3)
    # Reflections, at most one step in hundreds, shorten a few increments.
    assert np.diff(path).std() == pytest.approx(0.1 * 0.2 * 0.1, rel=0.01)


def test_random_paths_visit_the_whole_range_evenly():
    # Far apart in time, samples of a reflected walk are independent and uniform.
    path = random_coefficient("alpha", 1000.0 * np.arange(2000), spread=0.2, rng=4)
    assert scipy.stats.kstest(path[1:], "uniform", args=(1.0, 0.3997)).pvalue > 1e-6


def test_random_paths_repeat_with_a_seed_and_leave_the_global_state_alone():
    t = np.arange(0, 5, 0.01)
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    first, second = random_coefficient("alpha", t, rng=5), random_coefficient("alpha", t, rng=np.random.default_rng(5))
    assert np.array_equal(first, second) and not np.array_equal(first, random_coefficient("alpha", t, rng=6))
    assert np.array_equal(before, np.random.get_state()[1])  # noqa: NPY002
    assert random_coefficient("alpha", t, start=1.05, rng=5)[0] == pytest.approx(1.05)
    assert np.all(random_coefficient("alpha", t, spread=0.0) == 1.19985)


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
    assert still.valve == P.dead_band
    assert still[2:4] == pytest.approx(creeping[2:4], rel=1e-6)


def test_linearization_is_the_jacobian_of_the_equations():
    model = linearize_servo(position=0.01, dt=0.01, velocity=0.08, load=5.0, alpha=1.1, beta=0.4)
    rhs, point = servo_derivatives(P), np.array(model.point)
    steps = np.array([1e-6, 1e-6, 10.0, 10.0, 1e-6, 1e-3])
    for j, step in enumerate(steps):
        ahead, behind = point.copy(), point.copy()
        ahead[j] += step
        behind[j] -= step
        column = (np.array(rhs(*ahead, 1.1, 0.4)) - rhs(*behind, 1.1, 0.4)) / (2 * step)
        got = model.continuous.A[:, j] if j < 4 else model.continuous.B[:, j - 4]
        scale = np.abs(column).max()
        assert got == pytest.approx(column, abs=1e-4 * scale + 1e-3)


def test_transfer_functions_are_those_of_the_state_space_models():
    model = linearize_servo(dt=0.02, velocity=0.1)
    z = np.exp(1j * np.array([0.02, 0.2, 0.7, 1.5, 3.0]))
    expected = np.array([model.discrete(point)[0, 0] for point in z])
    assert model.valve_to_position(z) == pytest.approx(expected, rel=1e-6)
    assert np.abs(model.valve_to_position.poles() - 1).min() < 1e-6
    # The loop closed by hand; python-control's acceleration is a row of A.
    acceleration = np.array([model.continuous.A[1] @ np.linalg.solve(
        point * np.eye(4) - model.discrete.A, model.discrete.B[:, 0]) for point in z])  # fmt: skip
    gain, damping = position_gains()
    # The controller commands an opening: it steps over the dead band.
    opening = 1 - P.dead_band
    loop = gain * opening * expected / (1 + opening * (gain * expected + damping * acceleration))
    assert model.reference_to_position(z) == pytest.approx(loop, rel=1e-6)
    assert model.reference_to_position(1) == pytest.approx(1, rel=1e-6)
    # The difference of successive positions over dt.
    assert model.valve_to_velocity(z) == pytest.approx(expected * (1 - 1 / z) / 0.02, rel=1e-5)
    assert model.valve_to_velocity(1).real == pytest.approx(0.1 / (model.point.valve - P.dead_band), rel=2e-3)


def test_linear_loop_predicts_small_perturbations_of_the_nonlinear_loop():
    dt, n = 0.01, 40
    model = linearize_servo(dt=dt, velocity=0.05)
    point = model.point
    start = (-0.01, *point[1:4])
    opening = (point.valve - P.dead_band) / (1 - P.dead_band)
    ramp = start[0] + opening / position_gains().gain + 0.05 * dt * np.arange(n)
    nudge = 1e-4 * np.sign(np.random.default_rng(3).standard_normal(n))
    options = dict(initial=start, rtol=1e-9, compensation=1.0)
    difference = simulate_servo(ramp + nudge, dt, **options).position - simulate_servo(ramp, dt, **options).position
    predicted = control.forced_response(model.reference_to_position, None, nudge).outputs
    assert np.linalg.norm(difference - predicted) < 0.05 * np.linalg.norm(difference)


def test_dry_friction_freezes_the_linear_model_at_standstill_unless_it_is_left_out():
    stuck, viscous = (linearize_servo(dt=0.01, velocity=0.0, friction=kind) for kind in ("full", "viscous"))
    assert stuck.continuous.A[1, 1] == pytest.approx(-(7.4 / 1e-3 + 4.47), rel=1e-3)
    assert viscous.continuous.A[1, 1] == pytest.approx(-4.47, rel=1e-6)
    sliding = linearize_servo(dt=0.01, velocity=0.1)
    assert sliding.continuous.A[1, 1] == pytest.approx(-4.47, rel=1e-3)


def radius(p, beta, dt, **loop):
    """Largest pole of python-control's model of the loop, over the stroke and in both directions."""
    cases = [dict(position=y, velocity=v) for y in (-0.03, 0.0, 0.03) for v in (-0.05, 0.05)]
    models = (linearize_servo(p, beta=beta, dt=dt, friction="viscous", **loop, **case) for case in cases)
    return max(np.abs(model.reference_to_position.poles()).max() for model in models)


@pytest.mark.parametrize("mass", [0.3, 1.0, 5.0, 50.0])
def test_the_default_loop_is_stable_where_its_docstring_says_so(mass):
    p = replace(P, mass=mass)
    for dt in (0.005, 0.01, 0.02) if mass >= 1 else (0.005, 0.01):
        assert max(radius(p, beta, dt) for beta in (0.1, 0.3, 0.5)) < 1
        simulate_servo(np.zeros(3), dt, p, beta=[0.1, 0.5, 0.3])


def test_an_unstable_loop_is_refused_by_name_where_its_poles_are_outside():
    for options in (dict(mass=5.0, gain=1.5, damping=5e-4), dict(mass=1.0, damping=0.0), dict(mass=1.0, gain=8.0)):
        p, gains = replace(P, mass=options["mass"]), {k: v for k, v in options.items() if k != "mass"}
        assert radius(p, 0.3, 0.01, **gains) > 1
        with pytest.raises(UnstableLoopError, match=r"position loop: .* pole of size 1\.\d+ for gain=.* with mass="):
            simulate_servo(np.zeros(3), 0.01, p, **gains)
    assert issubclass(UnstableLoopError, ValueError)


def test_a_heavy_load_is_held_by_the_gains_that_its_mass_asks_for():
    recording = simulate_servo(np.full(600, 0.015), 0.01, replace(P, mass=5.0))
    assert recording.position[-1] == pytest.approx(0.015, abs=2e-3)
    assert np.abs(recording.velocity[-20:]).max() < 2e-3


# --- bad input ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("change", "message"), [
    ({"reference": []}, "reference: expected a non-empty"),
    ({"reference": [[0.0]]}, "reference"),
    ({"reference": [0.0, math.nan]}, "reference: expected finite positions, got nan at 1"),
    ({"reference": [0.0, 0.2]}, "reference: expected positions within the stroke"),
    ({"dt": 0.0}, "dt: expected a finite number > 0, got 0.0"),
    ({"rtol": -1.0}, "rtol"),
    ({"gain": -1.0}, "gain: expected a finite number >= 0"),
    ({"damping": math.inf}, "damping"),
    ({"alpha": 1.5}, "alpha: expected values in"),
    ({"alpha": [1.1, 1.2]}, "alpha: expected one value for each of the 5 samples"),
    ({"beta": lambda t: 0.3 - 10 * t}, r"beta\(0.03\): expected values in"),
    ({"compensation": 1.1}, r"compensation: expected a share of the dead band in \[0, 1\], got 1.1"),
    ({"supply": 0.5e5}, "supply: expected values in"),
    ({"supply": [5e5, 5e5]}, "supply: expected one value for each of the 5 samples"),
    ({"noise": np.zeros(5)}, r"noise: expected finite numbers of shape \(5, 3\), .* got shape \(5,\)"),
    ({"noise": np.full((5, 3), math.nan)}, "noise: expected finite numbers"),
    ({"observer": lambda z, u: (math.nan, 0.0)}, "observer: expected a finite position .* at sample 0"),
    ({"load": math.nan}, "load"),
    ({"load": math.inf}, "load: expected finite values"),
    ({"load": 1e4}, "load: expected forces that the piston can overcome"),
    ({"initial": [0.0, 0.0]}, "initial: expected 4 finite numbers"),
    ({"initial": [0.0, 0.0, 0.0, 3e5]}, "initial: expected positive absolute pressures"),
    ({"initial": [1.0, 0.0, 3e5, 3e5]}, "initial: expected a position within"),
])  # fmt: skip
def test_impossible_experiments_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        simulate_servo(**{"reference": np.zeros(5), "dt": 0.01, **change})


def test_impossible_openings_are_refused():
    for valve in ([0.0, 1.1], [math.nan], [], 0.1):
        with pytest.raises(ValueError, match="valve: expected"):
            simulate_actuator(valve, 0.01)


def test_a_failing_solver_is_not_passed_over(monkeypatch):
    real = position_loop.odeint
    monkeypatch.setattr(position_loop, "odeint", lambda *args, **kwargs: real(*args, **{**kwargs, "mxstep": 1}))
    with pytest.warns(), pytest.raises(RuntimeError, match=r"the ODE solver failed between 0 and 0.01 s"):
        simulate_servo(np.full(5, 0.01), 0.01)


@pytest.mark.parametrize(("change", "message"), [
    ({"velocity": 10.0}, "velocity: expected what the valve can feed"),
    ({"velocity": 1e-6}, "velocity: expected faster than the leakage moves air"),
    ({"velocity": math.nan}, "velocity: expected a finite number"),
    ({"position": 0.05}, "position: expected within"),
    ({"load": 500.0}, "load: expected forces"),
    ({"load": -500.0, "velocity": -0.05}, "load: expected forces"),
    ({"alpha": 2.0}, "alpha"),
    ({"beta": 0.0}, "beta"),
    ({"dt": 0.0}, "dt: expected a finite number > 0"),
    ({"friction": "none"}, "friction: expected one of 'full', 'viscous', got 'none'"),
])  # fmt: skip
def test_impossible_operating_points_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        linearize_servo(**{"dt": 0.01, **change})


@pytest.mark.parametrize(("change", "message"), [
    ({"name": "gamma"}, "name: expected"),
    ({"low": 0.9}, "bounds of alpha: expected values in"),
    ({"low": 1.3, "high": 1.2}, "expected low < high"),
    ({"start": 1.0, "low": 1.1}, "start of alpha"),
    ({"spread": -0.1}, "spread: expected a number >= 0"),
    ({"t": [0.0, 0.0]}, "t: expected finite, strictly increasing"),
    ({"t": []}, "t: expected a non-empty"),
])  # fmt: skip
def test_impossible_random_paths_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        random_coefficient(**{"name": "alpha", "t": [0.0, 1.0], **change})
