"""Sensors that share a cause: one outlier, one verdict, each with a noise of its own."""

import warnings

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from fusion.worlds import fed
from numpy.testing import assert_allclose

from robust_filterpy.fusion import Contaminated, Fusion, FusionWarning, Reacquisition, Sensor, constant_velocity
from robust_filterpy.influence import Huber, Linear

WAYS = {"learnt": {}, "given": {"noise": Contaminated(0.1, 10.0)}, "huber": {"influence": Huber()}}


def pair(group="receiver", **more):
    return {"gps": Sensor([1.0, 0.0], R=4.0, group=group), "doppler": Sensor([0.0, 1.0], R=0.09, group=group), **more}


def together(seed, length=400):
    """A point on a line; one cause makes both readings of a stamp ten times as noisy, one time in ten."""
    rng, x, readings, truth = np.random.default_rng(seed), np.array([0.0, 1.0]), [], []
    F, Q, _ = constant_velocity(1, 0.1).matrices(0.5)
    for k in range(length):
        x = F @ x + np.linalg.cholesky(Q) @ rng.normal(size=2)
        wide = 10.0 if rng.random() < 0.1 else 1.0
        readings.append(("gps", 0.5 * k, x[0] + 2.0 * wide * rng.normal()))
        readings.append(("doppler", 0.5 * k, x[1] + 0.3 * wide * rng.normal()))
        truth.append(x)
    return dict(zip(("sensor", "time", "value"), zip(*readings, strict=True), strict=True)), np.array(truth)


def fused(sensors, **more):
    return Fusion(constant_velocity(1, 0.1), sensors, 5.0, P0=100.0 * np.eye(2), **more)


@pytest.mark.filterwarnings("ignore:smooth. Q and R do not fit")
def test_a_recording_is_smoothed_by_the_influence_of_the_fusion():
    table, _ = together(0, 60)
    motion = constant_velocity(1, 0.1)
    found = Fusion(motion, pair(None), 5.0, P0=100.0 * np.eye(2), influence=Linear()).run(table, smoothed=True)
    kf = KalmanFilter(2, 2)
    kf.P, kf.H, kf.R = 100.0 * np.eye(2), np.eye(2), np.diag([4.0, 0.09])
    kf.F, kf.Q, _ = motion.matrices(0.5)
    # The first stamp is the start's.
    Fs, Qs = [np.eye(2)] + [kf.F] * 59, [np.zeros((2, 2))] + [kf.Q] * 59
    zs = np.reshape(table["value"], (-1, 2, 1))
    means, covariances, _, _ = kf.batch_filter(list(zs), Fs=Fs, Qs=Qs)
    x, P, _, _ = kf.rts_smoother(means, covariances, Fs=Fs, Qs=Qs)
    assert_allclose(found.x, x[..., 0], atol=1e-6)
    assert_allclose(found.P, P, atol=1e-6)


@pytest.mark.parametrize("way", WAYS)
def test_a_far_position_costs_the_speed_of_the_same_stamp_its_weight(way):
    table, _ = together(0, 101)
    values = np.array(table["value"])
    values[200] += 100.0
    weights = [fused(pair(group), **WAYS[way]).run({**table, "value": values}).weights[100] for group in (None, "rx")]
    assert weights[0][0] < 0.2 and weights[1][0] < 0.2
    assert weights[1][1] < 0.3
    assert weights[0][1] < 0.3 if way == "learnt" else weights[0][1] > 0.3


def test_each_sensor_of_a_group_has_a_noise_of_its_own_size():
    table, _ = together(1, 800)
    values = np.array(table["value"])
    rng = np.random.default_rng(0)
    values[::2] += np.sqrt(3.0) * 2.0 * rng.normal(size=800)
    fusion = fused(pair())
    for name, t, z in zip(table["sensor"], table["time"], values, strict=True):
        fusion.observe(name, t, z)
    noise = fusion.noise()
    assert 3.0 < noise["gps"].deviation[0] < 6.0
    assert 0.2 < noise["doppler"].deviation[0] < 0.45


@pytest.mark.parametrize("way", WAYS)
def test_a_recording_with_a_group_is_its_steps_and_a_state_goes_on(way):
    table, _ = together(4, 80)
    whole, stepwise = fused(pair(), **WAYS[way]).run(table), fused(pair(), **WAYS[way])
    rows = list(zip(table["sensor"], table["time"], table["value"], strict=True))
    fed(stepwise, rows[:100])
    other = fused(pair(), **WAYS[way])
    other.restore(stepwise.state())
    fed(other, rows[100:])
    assert_allclose(other.estimate().x, whole.x[-1], rtol=1e-9)


def test_a_name_that_nobody_shares_joins_the_components_of_one_sensor():
    rng = np.random.default_rng(0)
    found = []
    for group in (None, "antenna"):
        fusion = Fusion(constant_velocity(2, 0.1), {"gps": Sensor(np.eye(4)[[0, 2]], R=1.0, group=group)}, 1.0)
        z = rng.normal(size=(60, 2)) * 0.5
        z[59] = 60.0, 2.0
        table = {"time": np.arange(60.0), "sensor": ["gps"] * 60, "east": z[:, 0], "north": z[:, 1]}
        found.append(fusion.run(table, value=["east", "north"]).weights[59])
    assert found[0][1] > 0.5 > 0.1 > found[1][1]


@pytest.mark.nightly
def test_a_verdict_is_of_the_whole_group_and_says_with_whom():
    rng = np.random.default_rng(0)
    others = {name: Sensor([1.0, 0.0], R=1.0) for name in ("left", "right")}
    fusion = Fusion(constant_velocity(1, 0.1), pair(**others), 1.0, P0=100.0 * np.eye(2), watch=True)
    for k in range(320):
        t = 0.1 * k
        for name, sensor in fusion._setup.layout.sensors.items():
            z = float(sensor.H[0] @ [2.0 * t, 2.0]) + np.sqrt(sensor.R[0, 0]) * rng.normal()
            fusion.observe(name, t, z + (12.0 if name == "gps" and t > 25.0 else 0.0))
    found = fusion.verdicts()
    assert found["gps"].fault == found["doppler"].fault == "biased"
    assert found["left"].fault == found["right"].fault == "healthy"
    assert "judged as one with doppler" in found["gps"].remedy
    again = Fusion(constant_velocity(1, 0.1), pair(**others), 1.0, P0=100.0 * np.eye(2), watch=True)
    again.restore(fusion.state())
    assert again.report() == fusion.report()


def test_in_doubt_the_speed_of_a_receiver_whose_position_is_false_is_believed():
    rng = np.random.default_rng(1)
    fusion = Fusion(
        constant_velocity(1, 0.02), pair(wheel=Sensor([0.0, 1.0], R=0.01)), 2.0, P0=100.0 * np.eye(2),
        reacquire=Reacquisition(length=200.0, jump=0.01),
    )  # fmt: skip
    for t in range(120):
        fusion.observe("wheel", t, 5.0 + 0.1 * rng.normal())
        fusion.observe("doppler", t, 5.0 + 0.3 * rng.normal())
        fusion.observe("gps", t, 5.0 * t + 2.0 * rng.normal() + (500.0 if t > 90 else 0.0))
    found = fusion.verdicts()
    assert found["gps"].fault in ("false", "undecided")
    assert found["doppler"].fault == found["wheel"].fault == "healthy"
    assert abs(fusion.estimate().x[0] - 5.0 * 119) < 20.0


@pytest.mark.parametrize(("sensors", "error", "words"), [
    (lambda: {"gps": Sensor([1.0, 0.0], R=1.0, group="rx")}, ValueError, "another sensor of the group 'rx'"),
    (lambda: {"gps": Sensor([1.0, 0.0], R=1.0, group="")}, TypeError, "group: expected the name"),
    (lambda: {"gps": Sensor([1.0, 0.0], R=1.0, group=3)}, TypeError, "group: expected the name"),
])  # fmt: skip
def test_a_group_that_makes_no_sense_is_refused(sensors, error, words):
    with pytest.raises(error, match=words):
        fused(sensors())
    with pytest.raises(ValueError, match="without group"):
        fused(pair()).run(together(0, 20)[0], smoothed=True)


def test_sensors_of_a_group_that_never_share_a_stamp_are_warned_of():
    table, _ = together(0, 80)
    shifted = {**table, "time": np.array(table["time"]) + 1e-3 * (np.arange(160) % 2)}
    with pytest.warns(FusionWarning, match="expected readings with the same stamp"):
        fused(pair()).run(shifted)
    fusion = fused(pair())
    with pytest.warns(FusionWarning, match="expected readings with the same stamp"):
        for name, t, z in zip(*(shifted[key] for key in ("sensor", "time", "value")), strict=True):
            fusion.observe(name, t, z)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        fused(pair()).run(table)
