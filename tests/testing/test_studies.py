"""What the studies claim: each a fact about the filters that would fail if they were worse."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from robust_filterpy import RobustKalmanFilter, TukeyBiweight

EXAMPLES = Path(__file__).parents[2] / "examples"


def load(name):
    """Import an example by its file."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    # dataclasses look their module up by name.
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


# -- the water flow


@pytest.fixture(scope="module")
def water():
    return load("water_flow")


@pytest.fixture(scope="module")
def scores(water, tmp_path_factory):
    return water.main(["--out", str(tmp_path_factory.mktemp("water"))])


STOPS = ("stop 1", "stop 2", "stop 3")


def test_recording_is_what_the_example_says(water):
    flow = water.load()
    assert np.isfinite(flow).sum() == 1268
    for name in STOPS:
        first, after = water.DISTURBANCES[name]
        assert np.nanmin(flow[first:after]) < 24.3
        assert np.nanmin(np.r_[flow[first - 6 : first], flow[after : after + 6]]) > 99
    first, after = water.DISTURBANCES["spike"]
    assert np.nanmax(flow) == np.nanmax(flow[first:after]) > 109


@pytest.mark.parametrize("name", ["Robust, Huber", "Robust, Tukey"])
def test_robust_deviates_less_than_kalman_in_every_disturbance(scores, name):
    kalman, robust = scores["KalmanFilter"].worst, scores[name].worst
    for disturbance in STOPS:
        assert robust[disturbance] < 0.25 * kalman[disturbance]
    assert robust["spike"] < 0.5 * kalman["spike"]
    assert scores[name].quiet < scores["KalmanFilter"].quiet


def test_huber_believes_a_stop_that_lasts_and_tukey_never(scores):
    for stop in STOPS:
        assert scores["Robust, Tukey"].worst[stop] < 3.5 < 9 < scores["Robust, Huber"].worst[stop]
    assert scores["KalmanFilter"].accepts < scores["Robust, Huber"].accepts < 72
    assert scores["Robust, Huber, expected"].accepts > 2 * scores["Robust, Huber"].accepts
    assert scores["Robust, Tukey"].accepts is None
    # Redescending with expected information locks out.
    assert scores["Robust, Tukey, expected"].back["stop 2"] is None
    assert all(hours is not None for hours in scores["Robust, Tukey"].back.values())


@pytest.mark.parametrize("sigma", [0.1, 0.3, 1.0])
def test_the_order_of_the_filters_does_not_hang_on_the_choice_of_R(water, sigma):
    flow = water.load()
    reference = water.undisturbed(flow, sigma**2)
    first, after = water.DISTURBANCES["stop 3"]
    kalman, huber, tukey = (
        np.abs(water.track(water.build(cls, flow, sigma**2, **choices), flow) - reference)[first:after].max()
        for cls, choices in (
            (KalmanFilter, {}),
            (RobustKalmanFilter, water.GIVEN),
            (RobustKalmanFilter, water.GIVEN | {"influence": TukeyBiweight()}),
        )
    )
    assert tukey < 0.5 * huber < 0.25 * kalman


# -- README's first figure


def test_first_figure_shows_a_typical_gain(tmp_path, capsys):
    first_screen = load("first_screen")
    errors = first_screen.main(["--out", str(tmp_path), "--seeds", "1"])
    shown = errors["KalmanFilter"] / errors["RobustKalmanFilter"]
    ratios = []
    for seed in range(1000, 1040):
        position, readings, _ = first_screen.simulate(seed)
        kalman, robust = (
            first_screen.rms(first_screen.track(cls, readings) - position) for cls in (KalmanFilter, RobustKalmanFilter)
        )
        ratios.append(kalman / robust)
    assert min(ratios) > 1
    assert 3 < shown < np.median(ratios) * 1.25
