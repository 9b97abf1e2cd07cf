"""The observer of the servo example: what it makes of sensors that err, in the loop of a piston."""

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from robust_filterpy import Contaminated, RobustKalmanFilter
from robust_filterpy.plants.servo import PneumaticParameters, simulate_servo
from robust_filterpy.plants.servo.equations import servo_derivatives

P = PneumaticParameters()
DT, STD = 0.01, np.array([5e-5, 500.0, 500.0])


@pytest.fixture
def servo(monkeypatch):
    """Import a module of the folder."""
    monkeypatch.syspath_prepend(str(Path(__file__).parents[2] / "examples"))
    return lambda name: importlib.import_module(f"servo.{name}")


@pytest.fixture
def ServoObserver(servo):
    return servo("observer").ServoObserver


def reference(n):
    return 0.02 * np.where(np.random.default_rng(0).random(n // 20 + 1) < 0.5, -1.0, 1.0).repeat(20)[:n]


def sensor_noise(n, contamination, seed, factor=40.0):
    rng = np.random.default_rng(seed)
    return np.column_stack([Contaminated(contamination, factor, s).rvs(size=n, random_state=rng) for s in STD])


def test_observer_without_noise_in_its_model_s_own_plant_follows_the_motion(ServoObserver):
    # The observer's own alpha and beta, and no dry friction: what is left is its linearization and its start.
    p = replace(P, coulomb_friction=0.0, static_friction=0.0)
    observer = ServoObserver(KalmanFilter(6, 3, 6), DT, STD, p)
    n = 300
    recording = simulate_servo(reference(n), DT, p, noise=np.zeros((n, 3)), observer=observer)
    assert np.abs(recording.position_estimate - recording.position).max() < 5e-5
    held = zip(recording.position, recording.velocity, recording.P_a, recording.P_b, strict=True)
    acceleration = np.array([servo_derivatives(p)(*x, 0.0, 0.0, 1.2, 0.3)[1] for x in held])
    assert np.std(recording.acceleration_estimate - acceleration) < 0.05 * np.std(acceleration)
    assert observer.beta == pytest.approx(0.3, rel=0.1)


def test_outliers_move_the_piston_less_when_the_robust_filter_runs_the_loop(ServoObserver):
    def drive(noise, filter):
        observer = ServoObserver(filter(6, 3, 6), DT, STD)
        return simulate_servo(reference(len(noise)), DT, noise=noise, observer=observer)

    deviations, travels = np.empty((2, 3, 2))
    for i, seed in enumerate((11, 12, 13)):
        noise = sensor_noise(1000, 0.1, seed)
        without = drive(np.where(np.abs(noise) > 5 * STD, noise / 40, noise), KalmanFilter)
        for j, filter in enumerate((KalmanFilter, RobustKalmanFilter)):
            recording = drive(noise, filter)
            deviations[i, j] = np.sqrt(np.mean((recording.position - without.position) ** 2))
            travels[i, j] = np.abs(np.diff(recording.valve)).sum() - np.abs(np.diff(without.valve)).sum()
    assert np.all(deviations[:, 1] < 0.7 * deviations[:, 0]) and np.all(travels[:, 1] < 0.4 * travels[:, 0])
