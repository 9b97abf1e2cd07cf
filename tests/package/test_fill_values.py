"""Fill values: what repeats exactly and lies far outside is missing; nothing else is."""

import numpy as np
import pandas as pd
import pytest
from recordings import silence
from scipy.signal import lfilter

from robust_filterpy import RobustKalmanFilter
from robust_filterpy._fill_values import fill_values, without_fill_values
from robust_filterpy.fleet import FilterModel, filter_table
from robust_filterpy.fusion import Fusion, Sensor, constant_velocity
from robust_filterpy.noise import estimate_noise
from robust_filterpy.smoothing import smooth


def recording(seed, length=2000):
    rng = np.random.default_rng([27, seed])
    u = rng.choice([-1.0, 1.0], length)
    wild = np.where(rng.random(length) < 0.1, 10.0, 1.0)
    return rng, 20.0 + lfilter([0.0, 1.0, 0.5], [1.0, -1.5, 0.7], u) + 0.3 * wild * rng.normal(size=length)


@pytest.mark.parametrize("fills", [[9999.0], [1e7], [-1e8], [9.969209968386869e36], [9999.0, -9999.0]], ids=str)
@pytest.mark.parametrize("digits", [1, 6])
def test_fill_values_are_recognised_and_named(fills, digits):
    for seed in range(5):
        rng, y = recording(seed)
        y, places = y.round(digits), rng.random(y.size) < rng.choice([0.01, 0.1, 0.3])
        filled = np.where(places, rng.choice(fills, y.size), y)
        found = fill_values(filled)
        assert set(found.values) == set(fills)
        np.testing.assert_array_equal(found.signal, np.where(places, np.nan, y))
        assert all(f"{value:.6g}" in found.said for value in fills)


def variants(rng, y):
    yield y
    yield from (y.round(1), y.round(0), np.clip(y, -np.inf, y.mean() + y.std()))
    yield np.where(np.arange(y.size) < 500, y[500], y)
    yield np.where(rng.random(y.size) < 0.3, 20.0, y)
    yield np.where(y > 20.0, 100.0, 0.0)
    yield 100.0 * (y > 20.0) + rng.normal(size=y.size).round(1)
    yield rng.standard_t(2, y.size)
    yield np.cumsum(rng.choice([-1.0, 0.0, 1.0], y.size))
    yield np.where(rng.random(y.size) < 0.01, 1e7 * rng.normal(size=y.size), y)
    yield np.full(y.size, 3.0)
    yield y[:3]
    yield np.full(5, np.nan)


def test_nothing_else_is_a_fill_value():
    for seed in range(10):
        for i, signal in enumerate(variants(*recording(seed))):
            assert fill_values(signal).signal is signal, i


def test_measurements_of_every_form_lose_their_fill_values():
    _, y = recording(1)
    y[::50] = 9999.0
    pairs = np.column_stack((y, -y))
    gaps = [None if k % 7 == 0 else [[a], [b]] for k, (a, b) in enumerate(pairs)]
    with pytest.warns(UserWarning, match=r"zs: component 0: 9999 \(34 samples\).*component 1: -9999 \(34"):
        found, filled = without_fill_values("zs", gaps)
    assert found.shape == (2000, 2, 1)
    np.testing.assert_array_equal(np.isnan(found[:, 0, 0]), (np.arange(2000) % 7 == 0) | (y == 9999.0))
    np.testing.assert_array_equal(filled[:, 1], (np.arange(2000) % 7 != 0) & (y == 9999.0))
    odd = [1.0, "two", None]
    assert without_fill_values("zs", odd)[0] is odd


def walking():
    kf = RobustKalmanFilter(1, 1)
    kf.H, kf.R, kf.Q = np.eye(1), 4.0 * np.eye(1), 0.25 * np.eye(1)
    return kf


def of_a_fleet(zs):
    """Estimates of a table of three devices, with the reasons for what is none."""
    table = pd.DataFrame({"device": np.tile(list("abc"), len(zs))[: len(zs)], "t": np.arange(len(zs)) * 1.0, "z": zs})
    found = filter_table(FilterModel(walking(), time="t", measurements=["z"]), table)
    return found.drop(columns="device").astype(float)


def of_a_fusion(zs):
    fusion = Fusion(constant_velocity(1), {"a": Sensor([1.0, 0.0], R=1.0)}, 5.0)
    return fusion.run({"time": np.arange(len(zs)) * 1.0, "sensor": ["a"] * len(zs), "value": zs}).x


#: What takes a recording whole: what it makes of one, and whose values it names.
ENTRIES = {
    "smoother": (lambda zs: smooth(walking(), zs).x, "zs: "),
    "its weights": (lambda zs: np.nan_to_num(smooth(walking(), zs).weights), "zs: "),
    "noise": (lambda zs: estimate_noise(walking(), zs).R, "zs: "),
    "fleet": (of_a_fleet, "devices' measurements: "),
    "fusion": (of_a_fusion, "sensor 'a': "),
}


@pytest.mark.parametrize("fill, word", [(9.97e36, r"9.97e\+36"), (-9999.0, "-9999")])
@pytest.mark.parametrize("entry", ENTRIES)
def test_a_recording_with_fill_values_is_one_with_gaps_and_says_so_once(entry, fill, word):
    rng, (call, whose) = np.random.default_rng(1), ENTRIES[entry]
    zs = np.cumsum(0.5 * rng.normal(size=300)) + 2.0 * rng.normal(size=300)
    gone = np.arange(300) % 10 == 0
    with pytest.warns(UserWarning, match=f"{whose}{word} .*repeated exactly and far outside") as said:
        found = call(np.where(gone, fill, zs))
    assert len(said) == 1
    np.testing.assert_array_equal(found, call(np.where(gone, np.nan, zs)))
    with silence():
        # One that is wild and does not repeat, and a rounded signal, are what they were.
        call(np.where(np.arange(300) == 7, fill, zs.round(1)))


@pytest.mark.parametrize("digits", [None, 2, 1])
@pytest.mark.parametrize("pole", [0.5, 0.9, 0.99])
def test_the_rest_before_a_step_is_no_fill_value(pole, digits):
    u = np.zeros(800)
    u[50:] = 1.0
    y = lfilter([0.0, 1.0 - pole], [1.0, -pole], u)
    y = y if digits is None else y.round(digits)
    assert fill_values(y).signal is y
