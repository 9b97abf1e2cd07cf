"""The servo's loop on sensors that err: the observer, what outliers do to the piston, and the files of a recording."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pandas
import pytest
from filterpy.kalman import KalmanFilter

from robust_filterpy import Contaminated, RobustKalmanFilter
from robust_filterpy.plants.servo import PneumaticParameters, ServoObserver, simulate_servo
from robust_filterpy.plants.servo.equations import servo_derivatives
from robust_filterpy.plants.servo.linearization import operating_point
from robust_filterpy.plants.servo.position_loop import simulate_actuator

DT, STD = 0.01, np.array([5e-5, 500.0, 500.0])
P = PneumaticParameters()


def sensor_noise(n, contamination, seed, factor=40.0):
    rng = np.random.default_rng(seed)
    return np.column_stack([Contaminated(contamination, factor, s).rvs(size=n, random_state=rng) for s in STD])


def reference(n, seed=0):
    return 0.02 * np.where(np.random.default_rng(seed).random(n // 20 + 1) < 0.5, -1.0, 1.0).repeat(20)[:n]


def drive(noise, filter=None, **options):
    observer = None if filter is None else ServoObserver(filter(6, 3, 6), DT, STD)
    return simulate_servo(reference(len(noise)), DT, noise=noise, observer=observer, **options)


def test_readings_are_the_truth_with_the_noise_that_was_given():
    noise = sensor_noise(40, 0.2, 1)
    for recording in (drive(noise), simulate_actuator(np.full(40, 0.02), DT, noise=noise)):
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


def test_observer_without_noise_in_its_model_s_own_plant_follows_the_motion():
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


def test_observer_learns_the_flow_through_the_valve():
    n = 600
    for beta in (0.2, 0.45):
        observer = ServoObserver(KalmanFilter(6, 3, 6), DT, STD)
        noise = sensor_noise(n, 0.0, 3)
        simulate_servo(reference(n), DT, noise=noise, observer=observer, beta=beta)
        assert observer.beta == pytest.approx(beta, rel=0.15)


def test_outliers_move_the_piston_less_when_the_robust_filter_runs_the_loop():
    n, deviations, travels = 1000, [], []
    for seed in (11, 12, 13):
        noise = sensor_noise(n, 0.1, seed)
        is_outlier = np.abs(noise) > 5 * STD
        without = drive(np.where(is_outlier, noise / 40, noise), KalmanFilter)
        for filter in (KalmanFilter, RobustKalmanFilter):
            recording = drive(noise, filter)
            deviations.append(np.sqrt(np.mean((recording.position - without.position) ** 2)))
            travels.append(np.abs(np.diff(recording.valve)).sum() - np.abs(np.diff(without.valve)).sum())
    kalman, robust = np.reshape(deviations, (3, 2)).T
    assert np.all(robust < 0.7 * kalman)
    kalman, robust = np.reshape(travels, (3, 2)).T
    assert np.all(robust < 0.4 * kalman)


def test_an_outlier_cannot_throw_the_estimate_off_the_stroke():
    observer = ServoObserver(KalmanFilter(6, 3, 6), DT, STD)
    point = operating_point(velocity=0.0)
    for k in range(200):
        z = np.array([0.0, point.P_a, point.P_b]) + (k % 7 == 3) * np.array([0.3, -5e5, 5e5])
        estimate = observer(z, 0.0)
        assert abs(estimate.position) <= P.stroke / 2 and math.isfinite(estimate.acceleration)
    assert 0.075 <= observer.beta <= 1.3297


@pytest.mark.parametrize(("arguments", "message"), [
    ((KalmanFilter(5, 3, 6), DT, STD), r"filter: expected dim_x, dim_z, dim_u = \(6, 3, 6\), got \(5, 3, 6\)"),
    ((KalmanFilter(6, 3, 6), 0.0, STD), "dt: expected a finite number > 0"),
    ((KalmanFilter(6, 3, 6), DT, [1.0, 1.0]), "std: expected 3 numbers > 0"),
    ((KalmanFilter(6, 3, 6), DT, [1.0, 0.0, 1.0]), "std: expected 3 numbers > 0"),
])  # fmt: skip
def test_impossible_observers_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ServoObserver(*arguments)


def test_files_hold_every_signal_with_its_unit(tmp_path):
    recording = drive(sensor_noise(30, 0.1, 5), load=2.0)
    recording.to_csv(tmp_path / "servo.csv")
    table = pandas.read_csv(tmp_path / "servo.csv")
    names, units = zip(*(column[:-1].split(" [") for column in table.columns), strict=True)
    assert names == recording._fields
    assert dict(zip(names, units, strict=True))["P_a"] == "Pa" and units[0] == "s" and units[2] == "1"
    for name, column in zip(names, table.columns, strict=True):
        # To the last digit, so that another tool identifies the same data.
        assert np.array_equal(table[column], getattr(recording, name), equal_nan=True)


def test_a_recording_without_a_loop_is_written_with_nan(tmp_path):
    simulate_actuator([0.0, 0.1], DT).to_csv(tmp_path / "x.csv")
    table = pandas.read_csv(tmp_path / "x.csv")
    assert table["reference [m]"].isna().all() and table["position_estimate [m]"].isna().all()
    assert table["position [m]"].notna().all()
