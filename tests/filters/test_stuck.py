"""That a sensor is stuck is said once, at the user's line, and of no sensor that is not."""

import warnings

import numpy as np
import pandas as pd
import pytest
from filterpy.kalman import MerweScaledSigmaPoints

from robust_filterpy import (
    AdaptiveKalmanFilter,
    RobustExtendedKalmanFilter,
    RobustKalmanFilter,
    RobustUnscentedKalmanFilter,
    filter_series,
)
from robust_filterpy.filters import StuckSensorWarning
from robust_filterpy.fleet import FilterModel, step
from robust_filterpy.influence import TukeyBiweight


def recording(rng, m=1):
    """Return readings of a level, the last sensor's stuck far off from 140 to 160."""
    zs = rng.normal(size=(200, m))
    zs[140:160, -1] = 50.0
    return zs


def level(m=1):
    kf = AdaptiveKalmanFilter(1, m)
    kf.H, kf.Q, kf.R = np.ones((m, 1)), 1e-4 * np.eye(1), np.eye(m)
    return kf


def online(zs):
    kf = level(zs.shape[1])
    for z in zs:
        kf.predict()
        kf.update(z)


def in_series(zs):
    m = zs.shape[1]
    filter_series(
        np.stack([zs[:100], zs[100:]]), [[1.0]], np.ones((m, 1)), [[1e-4]], np.eye(m), [0.0], [[1.0]],
        noise="learnt", process="scales", learnt=learnt_of(zs),
    )  # fmt: skip


def learnt_of(zs):
    """Return what is learnt of the readings that are in order."""
    kf = level(zs.shape[1])
    kf.batch_filter(zs[:100])
    return kf.learnt


WAYS = {"online": online, "recording": lambda zs: level(zs.shape[1]).batch_filter(zs), "series": in_series}


@pytest.mark.parametrize("m", [1, 3])
@pytest.mark.parametrize("way", WAYS.values(), ids=WAYS)
def test_a_stuck_sensor_is_named_once_at_the_users_line(way, m):
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        way(recording(np.random.default_rng(1), m))
    (one,) = [w for w in found if w.category is StuckSensorWarning]
    assert f"sensor {m - 1} is stuck" in str(one.message) and one.filename == __file__
    assert ("step 141" in str(one.message)) == (way is WAYS["recording"])
    assert ("series 1" in str(one.message)) == (way is WAYS["series"])


def extended():
    kf = RobustExtendedKalmanFilter(1, 1, noise="learnt")
    return kf, lambda z: kf.update(z, lambda x: np.exp(x).reshape(1, 1), np.exp)


def unscented():
    points = MerweScaledSigmaPoints(1, 0.5, 2.0, 2.0)
    kf = RobustUnscentedKalmanFilter(1, 1, 1.0, np.exp, lambda x, dt: x, points, noise="learnt")
    return kf, kf.update


def test_a_stuck_sensor_among_those_that_are_named_to_fail_together_is_seen():
    zs, kf = recording(np.random.default_rng(1), 3), AdaptiveKalmanFilter(1, 3, grouping=((0, 1, 2),))
    kf.H, kf.Q, kf.R = np.ones((3, 1)), 1e-4 * np.eye(1), np.eye(3)
    with pytest.warns(StuckSensorWarning, match="sensor 2 is stuck"):
        assert abs(kf.batch_filter(zs)[0][159]).item() < 0.5


@pytest.mark.parametrize("build", [extended, unscented])
def test_a_stuck_sensor_of_a_nonlinear_filter_is_named_and_says_nothing(build):
    kf, update = build()
    kf.x, kf.P, kf.Q, kf.R = np.array([1.0]), 0.1 * np.eye(1), 1e-5 * np.eye(1), 0.01 * np.eye(1)
    zs = np.exp(1.0) + 0.1 * np.random.default_rng(3).normal(size=200)
    zs[140:160] = 9.0
    weights = []
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        for z in zs:
            kf.predict()
            update(np.array([z]))
            weights.append(kf.weights[0])
    (one,) = [w for w in found if w.category is StuckSensorWarning]
    assert "sensor 0 is stuck" in str(one.message)
    assert (np.flatnonzero(np.array(weights) == 0.0) == np.arange(141, 160)).all()
    assert abs(kf.x[0] - 1.0) < 0.05


@pytest.mark.filterwarnings("error::robust_filterpy.filters.StuckSensorWarning")
def test_nothing_is_said_of_sensors_in_coarse_steps_counters_held_samples_and_simulations():
    rng = np.random.default_rng(2)
    v, walk = rng.normal(size=1000), np.cumsum(0.3 * rng.normal(size=1000))
    jumps = np.repeat(rng.normal(size=10) * 40.0, 100)
    quiet = {
        "white": v, "walk": walk + v, "jumps": jumps + v, "coarse": np.round(walk + v),
        "coarse jumps": np.round(jumps + v), "fine steps": np.round(walk + v, 1),
        "twice": np.repeat((walk + v)[::2], 2), "counter": np.cumsum(rng.poisson(2.0, 1000)), "no noise": jumps,
        "sine": np.sin(np.arange(1000) / 50.0), "outliers": walk + np.where(rng.random(1000) < 0.1, 10.0, 1.0) * v,
    }  # fmt: skip
    for zs in quiet.values():
        online(zs[:, None])


class Comparable(AdaptiveKalmanFilter):
    """A filter that two of can be compared, and that is not hashable therefore."""

    def __eq__(self, other):
        return bool((self.x == other.x).all())


def test_a_filter_of_a_class_that_is_not_hashable_is_looked_at_too():
    zs = recording(np.random.default_rng(1))
    kf = Comparable(1, 1)
    kf.H, kf.Q = np.ones((1, 1)), 1e-4 * np.eye(1)
    with pytest.warns(StuckSensorWarning, match="sensor 0 is stuck"):
        for z in zs:
            kf.predict()
            kf.update(z)


def test_series_and_keys_say_it_once_with_how_many_there_are():
    rng = np.random.default_rng(4)
    zs = rng.normal(size=(5, 60, 1))
    zs[2:4, 40:44] = -9999.0
    model = [*[np.eye(1)] * 4, np.zeros(1), np.eye(1)]
    with pytest.warns(StuckSensorWarning, match="filter_series: series 2 and 1 more of 5: sensor 0"):
        filter_series(zs, *model)
    with pytest.warns(StuckSensorWarning, match="filter_series: series 2 and 1 more of 5"):
        filter_series(zs, *model, noise="learnt")
    with warnings.catch_warnings():
        warnings.simplefilter("error", StuckSensorWarning)
        filter_series(zs[:2], *model)
        # What psi refuses is not stuck.
        filter_series(zs, *model, influence=TukeyBiweight(), scaling="innovation")


@pytest.mark.parametrize("noise", [None, "learnt"])
def test_a_stream_says_it_once_for_each_key(noise):
    kf = RobustKalmanFilter(1, 1, noise=noise)
    kf.F, kf.H, kf.Q = np.eye(1), np.eye(1), 0.01 * np.eye(1)
    model, states, said = FilterModel(kf), None, []
    zs = np.random.default_rng(5).normal(size=(3, 60))
    zs[0, 30:33] = zs[0, 50:53] = zs[2, 45:48] = -9999.0
    for k in range(0, 60, 5):
        table = pd.DataFrame({"device": np.repeat(["a", "b", "c"], 5), "z0": zs[:, k : k + 5].ravel()})
        with warnings.catch_warnings(record=True) as found:
            warnings.simplefilter("always", StuckSensorWarning)
            states, _ = step(model, states, table, key="device")
        said += [(k, str(w.message)[:18]) for w in found]
    # What is learned of noise forgets that it has been said.
    again = [(50, "step: key 'a' of 3")] if noise else []
    assert said == [(30, "step: key 'a' of 3"), (45, "step: key 'c' of 3"), *again]
