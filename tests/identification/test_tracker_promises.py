"""What a user relies on of every tracker: memory, arrays, signs, order, delay, gaps, intervals, bounds."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from support import told_tracker

from robust_filterpy import StudentT, TukeyBiweight
from robust_filterpy.identification import ARX, FIR
from robust_filterpy.influence import Linear
from robust_filterpy.testing import assert_recovers_parameters, assert_tracks, draw, run_tracker
from robust_filterpy.testing.assertions.consistency import assert_interval_coverage
from robust_filterpy.testing.scenarios.plants import Plant

TRACKERS = {
    "Huber": told_tracker,
    "Linear": partial(told_tracker, influence=Linear()),
    "Student": partial(told_tracker, influence=StudentT(4.0)),
    "Tukey": partial(told_tracker, influence=TukeyBiweight()),
    "pseudolinear": partial(told_tracker, gradient="pseudolinear"),
}
EVERY = pytest.mark.parametrize("make", TRACKERS.values(), ids=TRACKERS)
ROBUST = pytest.mark.parametrize("make", [make for name, make in TRACKERS.items() if name != "Linear"])


def through(tracker, scenario, first=0, stop=None):
    """Update sample by sample."""
    for y, u in zip(scenario.y[first:stop], scenario.u[first:stop], strict=True):
        tracker.update(float(y), u)
    return tracker


def made(make, scenario):
    return scenario.load(make(scenario.structure))


def after(make, scenario):
    return through(made(make, scenario), scenario)


def clean(plant, samples=200):
    scenario = draw(plant, samples, rng=3)
    return replace(scenario, y=scenario.y_clean)


def runs(make, plant, count, samples, **options):
    scenarios = [draw(plant, samples, rng=seed, **options) for seed in range(count)]
    return [run_tracker(made(make, one), one) for one in scenarios]


@EVERY
@pytest.mark.parametrize(
    "plant",
    [
        Plant(ARX(1, 1), np.array([-0.8, 1.0])), Plant(FIR(3), np.array([1.0, 2.0, 3.0])),
        Plant(ARX(1, 2), np.array([-0.5, 1.0, 2.0])), Plant(FIR(1, 3), np.array([2.0])), "fir", "arx",
    ],
    ids=str,
)  # fmt: skip
def test_without_noise_parameters_have_sign_order_and_delay_of_the_plant(make, plant):
    scenario = clean(plant)
    np.testing.assert_allclose(after(make, scenario).theta, scenario.theta[-1], rtol=0.0, atol=0.02)


@EVERY
def test_a_missing_output_is_no_information_and_adds_Q_at_any_age(make):
    scenario = draw("fir", 1201, rng=5)
    scenario = replace(scenario, Q=1e-4 * np.eye(4))
    tracker = made(make, scenario)
    for first, age in ((0, 20), (20, 1200)):
        through(tracker, scenario, first, age)
        theta, P = tracker.theta.copy(), tracker.P.copy()
        tracker.update(np.nan, scenario.u[age])
        np.testing.assert_allclose(tracker.theta, theta, rtol=1e-9)
        np.testing.assert_allclose(tracker.P - P, scenario.Q, rtol=0.0, atol=1e-10)
    scenario = clean("arx", 120)
    gap = replace(scenario, y=np.where(np.arange(120) // 5 == 12, np.nan, scenario.y))
    np.testing.assert_allclose(after(make, gap).theta, scenario.theta[-1], rtol=0.0, atol=0.02)


@ROBUST
@pytest.mark.parametrize("size", [1e2, -1e6, 1e12])
def test_one_output_moves_parameters_by_a_bounded_amount(make, size):
    scenario = draw("fir", 30, rng=6)
    tracker = through(made(make, scenario), scenario, 0, 29)
    theta, std = tracker.theta.copy(), tracker.std.copy()
    tracker.update(float(scenario.y_clean[29] + size * np.sqrt(scenario.R)), scenario.u[29])
    assert np.linalg.norm((tracker.theta - theta) / std) <= 10.0


def test_intervals_hold_the_truth_and_moving_parameters_are_followed():
    linear = TRACKERS["Linear"]
    assert_interval_coverage(runs(linear, "fir", 80, 30), level=0.9)
    assert_interval_coverage(runs(told_tracker, "fir", 80, 30), level=0.9, tolerance=0.05)
    assert_tracks(runs(told_tracker, "fir", 30, 80, drift=0.05), at_least=0.5, skip=20)
    wild = {"mixture": {"scale_ratio": 30.0}}
    assert_tracks(runs(told_tracker, "fir", 40, 120, contamination=wild), at_least=0.4, skip=40)


@pytest.mark.parametrize(("plant", "limits"), [("output error", {0: 0.2}), ("armax", {0: 0.1, 4: 0.4})])
def test_noise_with_a_colour_gives_no_bias(plant, limits):
    found = runs(told_tracker, plant, 9, 400, sigma=1.0)
    median, truth = np.median([run.theta[-1] for run in found], axis=0), found[0].known.theta[-1]
    assert all(abs(median[i] - truth[i]) <= limit for i, limit in limits.items())


@pytest.mark.parametrize("contamination", ["mixture", "bursts", "student", ("mixture", "missing")], ids=str)
@pytest.mark.parametrize("plant", ["arx", "fir"])
def test_parameters_are_recovered_through_every_kind_of_outlier(plant, contamination):
    assert_recovers_parameters(runs(told_tracker, plant, 4, 300, contamination=contamination), factor=4.0)
